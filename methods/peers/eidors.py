"""EIDORS' NOSER, GREIT and TV-PDIPM, run by EIDORS in GNU Octave (see `eidors_bridge.m`)."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
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

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem
    from eitbench.scenarios.sensors.sensor import Sensor


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
        try:
            content = scipy.io.loadmat(str(answer), variable_names=["points", "values"])
            points, values = (np.asarray(content[k], np.float64) for k in ("points", "values"))
        except (KeyError, OSError, TypeError, ValueError) as error:
            raise EitbenchError(
                f"EIDORS' answer does not hold points and values: {type(error).__name__}."
            ) from error
    n = np.shape(request["frames"])[1]
    expected = ((len(points), 2), (len(points), n))
    finite = np.isfinite(points).all() and np.isfinite(values).all()
    if (points.shape, values.shape) != expected or not finite:
        raise EitbenchError(
            f"EIDORS answered points {points.shape} and values {values.shape}, not finite ones of "
            f"shapes (P, 2) and (P, {n})."
        )
    return points, values


# EIDORS' solvers treat every element as an unknown, in dense matrices: a mesh for them is coarse.
MESH_ACROSS = 24
GREIT_PIXELS = 32
TARGETS_ACROSS = 32
TARGET_RADIUS = 0.05  # of the sensor's longer side
DIFFERS = "run by EIDORS in Octave on a coarser mesh of linear triangles"


def eidors_mesh(sensor: Sensor) -> Mesh:
    """Triangles about 1/24 of the sensor's longer side long, with nodes at electrode ends."""
    height, width = sensor.image_shape
    scale = MESH_ACROSS / max(height, width)
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
    source: ClassVar[str] = "Adler and Lionheart (EIDORS), Physiol. Meas. 27(5), 2006"
    differs = DIFFERS

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return missing()

    def prepare(self, problem: Problem) -> None:
        """Describe the sensor to EIDORS."""
        sensor = problem.sensor
        mesh = eidors_mesh(sensor)
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

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Return the parameters of this algorithm for `eidors_bridge.m`."""

    def ask(self, difference: Array) -> Array:
        """Contrast (n, P) of pixels from signed differences (n, M), by EIDORS."""
        points, values = ask_eidors(
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
        "weight": (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0),
        "radius": (0.1, 0.15, 0.2, 0.25),
    }
    radius: float = 0.2
    weight: float = 0.3

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

    Octave is started for every batch of frames, which their times hold.

    Attributes:
        hyperparameter: EIDORS' weight of the total variation.
        iterations: of the primal-dual interior point method.
    """

    algorithm: ClassVar[str] = "tv-pdipm"
    search: ClassVar = {"hyperparameter": (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)}
    hyperparameter: float = 1e-4
    iterations: int = 10

    def parameters(self) -> dict[str, Any]:
        """See `Eidors`."""
        return {"hyperparameter": self.hyperparameter, "iterations": float(self.iterations)}

    def contrast(self, difference: Array, reference: Array) -> Array:
        """See `Peer`."""
        return self.ask(difference)
