"""EIDORS' NOSER, GREIT and TV-PDIPM, run by EIDORS in GNU Octave (see `eidors_bridge.m`)."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.io
from numpy.typing import NDArray

from eitbench.methods.peers.peer import Peer, interpolation, lattice, pixels_inside
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.physics.mesh import Mesh, triangle_mesh
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem
    from eitbench.scenarios.sensors.sensor import Sensor


FOLDER = "EITBENCH_EIDORS"
"""The environment variable that names EIDORS' folder, the one that holds `startup.m`."""

LIMIT_S = 600.0
BRIDGE = "eidors_bridge.m"
_LONGEST_REASON = 300


def missing() -> str:
    """Return what is missing to run EIDORS, and how to get it, as a sentence; "" if nothing is."""
    if shutil.which("octave") is None:
        return (
            "EIDORS is run in GNU Octave, and there is no program `octave` on the path: install "
            "the packages octave and octave-dev."
        )
    name = os.environ.get(FOLDER, "")
    folder = Path(name).resolve()
    if not name or not (folder / "startup.m").is_file():
        return (
            f"EIDORS is run from the folder that the environment variable {FOLDER} names, and "
            f"{'that folder holds no startup.m' if name else 'it is not set'}: get EIDORS with "
            "`git clone https://github.com/eidors3d/eidors-readonly`, and name its folder eidors."
        )
    # Not left to the first question: in a run Octave can write to a temporary folder alone.
    if any((folder / "arch").rglob("eidors_var_id.mex")):
        return ""
    first = "EIDORS compiles a function into its folder when it is started first, and"
    if shutil.which("mkoctfile") is None:
        return f"{first} there is no program `mkoctfile` on the path: install octave-dev."
    if not os.access(folder / "arch", os.W_OK):
        return f"{first} {folder} cannot be written to: name a copy of yours in {FOLDER}."
    return f"{first} it never was: start it with octave --eval \"run('{folder / 'startup.m'}')\"."


class Octave:
    """GNU Octave with EIDORS, which answers the questions that `eidors_bridge.m` describes.

    The first question starts it. It ends with `close`, a failure, or this object.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def ask(self, request: Mapping[str, Any], limit_s: float = LIMIT_S) -> tuple[Array, Array]:
        """The points (P, 2) [m] and contrasts (P, n) that EIDORS answers to `request`.

        Raises:
            EitbenchError: Octave or EIDORS is missing, fails, takes longer than `limit_s`, or
                answers something else. Where it has ended, the next question starts it anew.
        """
        if self._process is None:
            self._start(limit_s)
        assert self._process is not None
        assert self._process.stdin is not None
        folder = Path(self._folder.name)
        scipy.io.savemat(folder / "request.mat", dict(request), oned_as="column")
        with suppress(BrokenPipeError):  # it has ended: `_wait` says why
            self._process.stdin.write("?")
            self._process.stdin.flush()
        self._wait("answered", limit_s)
        return _read_answer(folder / "answer.mat", np.shape(request["frames"])[1])

    def close(self) -> None:
        """End Octave."""
        if self._process is not None:
            _end(self._process)
            self._process = None

    def _start(self, limit_s: float) -> None:
        """Start Octave and EIDORS, and wait until they are ready."""
        if why := missing():
            raise EitbenchError(why)
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        (folder / BRIDGE).write_bytes((files("eitbench.methods.peers") / BRIDGE).read_bytes())
        eidors = Path(os.environ[FOLDER]).resolve()
        command = ["octave", "--no-gui", "--quiet", "--norc", BRIDGE, str(eidors)]
        with (folder / "errors.txt").open("w") as errors:
            self._process = subprocess.Popen(
                command,
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                errors="replace",
            )
        weakref.finalize(self, _end, self._process)
        self._wait("ready", limit_s)

    def _wait(self, word: str, limit_s: float) -> None:
        """Wait until the bridge says that it is `word`."""
        process = self._process
        assert process is not None
        assert process.stdout is not None
        latest = time.monotonic() + limit_s
        timer = threading.Timer(limit_s, process.kill)
        timer.start()
        try:
            if any(line.endswith(f"eitbench: {word}\n") for line in process.stdout):
                return
        finally:
            timer.cancel()
        late = time.monotonic() >= latest
        self.close()
        if late:
            raise EitbenchError(f"EIDORS took more than {limit_s:g} s.")
        said = (Path(self._folder.name) / "errors.txt").read_text(errors="replace")
        reason = " ".join(said.split())[-_LONGEST_REASON:] or "it gave no reason"
        raise EitbenchError(f"Octave ended with code {process.returncode}: {reason}")


def _end(process: subprocess.Popen[str]) -> None:
    """End a process, and wait until it has ended."""
    process.kill()
    process.communicate()


def _read_answer(path: Path, n: int) -> tuple[Array, Array]:
    """Return the points (P, 2) and values (P, n) of an answer.

    Raises:
        EitbenchError: it holds something else.
    """
    try:
        content = scipy.io.loadmat(str(path), variable_names=["points", "values"])
        points, values = (np.asarray(content[k], np.float64) for k in ("points", "values"))
    except (KeyError, OSError, TypeError, ValueError) as error:
        raise EitbenchError(
            f"EIDORS' answer does not hold points and values: {type(error).__name__}."
        ) from error
    expected = ((len(points), 2), (len(points), n))
    finite = np.isfinite(points).all() and np.isfinite(values).all()
    if (points.shape, values.shape) != expected or not finite:
        raise EitbenchError(
            f"EIDORS answered points {points.shape} and values {values.shape}, not finite ones of "
            f"shapes (P, 2) and (P, {n})."
        )
    return points, values


# EIDORS' solvers treat every element as an unknown, in dense matrices: a mesh for them is coarse.
GREIT_PIXELS = 32
TARGETS_ACROSS = 32
TARGET_RADIUS = 0.05  # of the sensor's longer side
OCTAVE = {"no_programs": "EIDORS runs in GNU Octave"}
DIFFERS = "run by EIDORS in Octave on a coarser mesh of linear triangles"


def eidors_mesh(sensor: Sensor, across: int) -> Mesh:
    """Triangles about 1/`across` of the sensor's longer side, with nodes at electrode ends."""
    height, width = sensor.image_shape
    scale = across / max(height, width)
    shape = max(2, round(height * scale)), max(2, round(width * scale))
    return triangle_mesh(replace(sensor, image_shape=shape))


def electrode_nodes(sensor: Sensor, mesh: Mesh) -> NDArray[np.int64]:
    """(E, m) the nodes of each electrode's rim edges, counted from 1 and filled up with 0."""
    perimeter = sensor.outline.perimeter
    middle = mesh.rim_arcs.mean(axis=1)
    found = []
    for electrode in sensor.electrodes:
        offset = (middle - electrode.centre + perimeter / 2) % perimeter - perimeter / 2
        found.append(np.unique(mesh.rim_edges[np.abs(offset) < electrode.width / 2]) + 1)
    padded = np.zeros((len(found), max(map(len, found))), dtype=np.int64)
    for k, nodes in enumerate(found):
        padded[k, : len(nodes)] = nodes
    return padded


class Eidors(Peer):
    """Base of EIDORS' methods; a subclass says which algorithm with which parameters."""

    algorithm: ClassVar[str]
    mesh_across: ClassVar[int] = 24
    source: ClassVar[str] = "Adler and Lionheart (EIDORS), Physiol. Meas. 27(5), 2006"
    expected_failures: ClassVar = OCTAVE
    differs = DIFFERS

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return missing()

    def prepare(self, problem: Problem) -> None:
        """Describe the sensor to EIDORS."""
        sensor = problem.sensor
        mesh = eidors_mesh(sensor, self.mesh_across)
        self.differs = f"{DIFFERS} ({len(mesh.elements)})"
        # A background of b S/m behaves as one of 1 S/m if contact impedances are b times as large.
        impedances = [e.contact_impedance * sensor.background for e in sensor.electrodes]
        self._sensor = {
            "nodes": mesh.nodes,
            "elements": mesh.elements + 1.0,
            "electrode_nodes": electrode_nodes(sensor, mesh).astype(np.float64),
            "contact_impedance": np.array(impedances),
            "pattern": sensor.pattern.table + 1.0,
            "reference": self.unit_frames(problem.background_voltages),
        }
        self._inside = pixels_inside(problem)
        self._octave = Octave()

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Return the parameters of this algorithm for `eidors_bridge.m`."""

    def ask(self, difference: Array) -> Array:
        """Contrast (n, P) of pixels from signed differences (n, M), by EIDORS."""
        points, values = self._octave.ask(
            {
                **self._sensor,
                "algorithm": self.algorithm,
                "parameters": self.parameters(),
                "frames": (self._sensor["reference"] + difference).T,
            }
        )
        return np.asarray((interpolation(points, self._inside) @ values).T)


class LinearEidors(Eidors):
    """Base of those whose images are linear in the data: EIDORS is asked once for each value."""

    def prepare(self, problem: Problem) -> None:
        """Ask EIDORS for the images of frames in which one value differs."""
        super().prepare(problem)
        self._matrix = self.ask(np.eye(problem.sensor.n_measurements))
        self._octave.close()

    def contrast(self, difference: Array, reference: Array) -> Array:
        """See `Peer`."""
        return difference @ self._matrix


@register("eidors-noser")
@dataclass
class EidorsNoser(LinearEidors):
    """EIDORS' NOSER: inv_solve_diff_GN_one_step with prior_noser.

    Attributes:
        hyperparameter: EIDORS' weight of the prior, which it squares.
        exponent: the prior is diag(J^T J)^exponent.
    """

    algorithm: ClassVar[str] = "noser"
    expected_failures: ClassVar = OCTAVE | asymmetry("EIDORS' triangles are not symmetric")
    search: ClassVar = {
        "hyperparameter": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
        "exponent": (0.2, 0.5, 0.8, 1.0),
    }
    hyperparameter: float = 0.1
    exponent: float = 0.5

    def parameters(self) -> dict[str, Any]:
        """See `Eidors`."""
        return {"hyperparameter": self.hyperparameter, "exponent": self.exponent}


@register("eidors-greit")
@dataclass
class EidorsGreit(LinearEidors):
    """EIDORS' GREIT: calc_GREIT_RM, trained on small targets of its own simulation.

    Attributes:
        radius: of the desired image of a point, as a fraction of the sensor's longer half side.
        weight: of the noise against the signal.
    """

    algorithm: ClassVar[str] = "greit"
    search: ClassVar = {
        "weight": (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0),
        "radius": (0.03, 0.05, 0.1, 0.15, 0.2, 0.25),
    }
    radius: float = 0.1
    weight: float = 30.0

    def prepare(self, problem: Problem) -> None:
        """Choose the targets."""
        x, y, side = lattice(problem.sensor.outline, TARGETS_ACROSS)
        self._targets = np.stack([x, y, np.full(len(x), TARGET_RADIUS * side)])
        super().prepare(problem)

    def parameters(self) -> dict[str, Any]:
        """See `Eidors`."""
        return {
            "radius": self.radius,
            "weight": self.weight,
            "imgsz": np.array([[GREIT_PIXELS, GREIT_PIXELS]], dtype=np.float64),
            "targets": self._targets,
        }


@register("eidors-tv-pdipm")
@dataclass
class EidorsTvPdipm(Eidors):
    """EIDORS' total variation: inv_solve_TV_pdipm with prior_TV.

    Octave is started in set-up, and asked for every batch of frames.

    Attributes:
        hyperparameter: EIDORS' weight of the total variation.
        iterations: of the primal-dual interior point method.
    """

    algorithm: ClassVar[str] = "tv-pdipm"
    mesh_across: ClassVar[int] = 12  # a frame of 24 takes five times as long, or more
    search: ClassVar = {"hyperparameter": (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)}
    hyperparameter: float = 1e-3
    iterations: int = 10

    def parameters(self) -> dict[str, Any]:
        """See `Eidors`."""
        return {"hyperparameter": self.hyperparameter, "iterations": float(self.iterations)}

    def contrast(self, difference: Array, reference: Array) -> Array:
        """See `Peer`."""
        return self.ask(difference)
