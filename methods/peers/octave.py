"""Runs EIDORS in GNU Octave, one process a question: MATLAB files in, a MATLAB file out."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from eitbench.scenarios.errors import EitbenchError

Array = NDArray[np.float64]

FOLDER = "EITBENCH_EIDORS"
"""The environment variable that names EIDORS' folder, the one that holds `startup.m`."""

LIMIT_S = 600.0
_LONGEST_REASON = 300


def missing() -> str:
    """Return what is missing to run EIDORS, as a sentence; "" where nothing is."""
    if shutil.which("octave") is None:
        return "EIDORS is run in GNU Octave, and there is no program `octave` on the path."
    folder = os.environ.get(FOLDER, "")
    if not folder or not (Path(folder) / "startup.m").is_file():
        return (
            f"EIDORS is run from the folder that the environment variable {FOLDER} names, and "
            f"{'that folder holds no startup.m' if folder else 'it is not set'}."
        )
    return ""


def ask_eidors(request: Mapping[str, Any], limit_s: float = LIMIT_S) -> tuple[Array, Array]:
    """The points (P, 2) [m] and contrasts (P, n) that EIDORS answers to `request`.

    What a request holds is said in `eidors_bridge.m`, which answers it.

    Raises:
        EitbenchError: Octave or EIDORS is missing, fails, takes longer than `limit_s`, or answers
            something else.
    """
    if why := missing():
        raise EitbenchError(why)
    with (
        tempfile.TemporaryDirectory() as name,
        as_file(files("eitbench.methods.peers") / "eidors_bridge.m") as script,
    ):
        question, answer = Path(name) / "request.mat", Path(name) / "answer.mat"
        scipy.io.savemat(question, dict(request), oned_as="column")
        command = [
            "octave", "--no-gui", "--quiet", "--norc", str(script), os.environ[FOLDER],
            str(question), str(answer),
        ]  # fmt: skip
        try:
            done = subprocess.run(
                command,
                cwd=name,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=limit_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise EitbenchError(f"EIDORS took more than {limit_s:g} s.") from error
        if done.returncode != 0 or not answer.is_file():
            reason = " ".join(done.stderr.split())[-_LONGEST_REASON:] or "it says no more"
            raise EitbenchError(f"Octave ended with code {done.returncode}: {reason}")
        n = np.shape(request["frames"])[1]
        return _read(answer, n)


def _read(path: Path, n: int) -> tuple[Array, Array]:
    try:
        content = scipy.io.loadmat(str(path), variable_names=["points", "values"])
        points = np.asarray(content["points"], dtype=np.float64)
        values = np.asarray(content["values"], dtype=np.float64)
    except (KeyError, OSError, TypeError, ValueError) as error:
        raise EitbenchError(
            f"EIDORS' answer does not hold points and values: {type(error).__name__}."
        ) from error
    if points.ndim != 2 or points.shape[1] != 2 or values.shape != (len(points), n):
        raise EitbenchError(
            f"EIDORS answered points {points.shape} and values {values.shape}, not (P, 2) and "
            f"(P, {n})."
        )
    if not (np.isfinite(points).all() and np.isfinite(values).all()):
        raise EitbenchError("EIDORS answered values that are not finite.")
    return points, values
