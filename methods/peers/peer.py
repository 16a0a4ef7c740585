"""Base of the peers: differences in, a scale that is fitted once, absolute images out."""

from abc import abstractmethod
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import Delaunay, cKDTree

from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.outlines import Outline
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.symmetry import motions

# The scale is found on discs of this radius (of the sensor's longer side), on a square lattice of
# this many across, each with this multiple of the background's conductivity.
DISC_RADIUS = 0.1
DISCS_ACROSS = 6
DISC_FACTOR = 0.5


class Peer(Method):
    """Base of the methods that run other software.

    Such software returns a contrast in a scale of its own. `fit` finds the one factor that fits it
    best, in least squares, to discs that our forward model simulates on the nominal sensor, the
    model that all methods are given; no data are used. Images are kept within the sensor's range
    of conductivity, as those of all methods are.
    """

    def fit(self, problem: Problem) -> None:
        """Prepare the other software and find its scale.

        Raises:
            InputError: it is not installed, or cannot treat this sensor.
        """
        if why := self.unusable(problem.sensor):
            raise InputError(why)
        self._problem = problem
        self._signs = reference_signs(problem)
        self._scale = 1.0
        self.prepare(problem)
        self._scale = self._calibrated()

    @abstractmethod
    def prepare(self, problem: Problem) -> None:
        """Set the other software up for one problem."""

    @abstractmethod
    def contrast(self, difference: Array, reference: Array) -> Array:
        """Contrast (n, P) of the P pixels inside, in any scale, from differences (n, M).

        They are signed, as is the `reference` frame (M,), and belong to a sensor whose background
        is 1 S/m [V/A].
        """

    def unit_frames(self, frames: Array) -> Array:
        """Model frames (..., M) [V/A], signed, of a sensor whose background is 1 S/m."""
        return np.asarray(self._signs * frames * self._problem.background)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        problem = self._problem
        difference = self.unit_frames(problem.difference(voltages))
        reference = self.unit_frames(problem.unit_reference)
        relative = 1 + self._scale * self.contrast(difference, reference)
        images = np.full((len(relative), *problem.mask.shape), problem.background)
        images[:, problem.mask] *= relative.clip(*problem.sensor.conductivity_range)
        return images

    def _calibrated(self) -> float:
        """The least-squares factor from what the software returns for discs to the discs."""
        problem = self._problem
        discs, alike = calibration_discs(problem)
        model = problem.model
        frames = model.voltages(problem.background * np.where(discs, DISC_FACTOR, 1.0))
        untouched = problem.background_voltages
        found = self.contrast(self.unit_frames(frames - untouched), self.unit_frames(untouched))
        true = np.where(discs[:, problem.mask], DISC_FACTOR - 1, 0.0)
        energy = float(alike @ np.sum(found**2, axis=1))
        scale = float(alike @ np.sum(true * found, axis=1)) / energy if energy > 0 else 0.0
        if not scale > 0:
            raise InputError(
                "The images that the other software makes of simulated contacts on sensor "
                f"{problem.sensor.name!r} do not show them: it cannot be used for this sensor."
            )
        return scale


def reference_signs(problem: Problem) -> Array:
    """(M,) the factors that turn frames into signed ones: 1 unless magnitudes are measured.

    |V| falls where a negative V rises; the sign of V on the untouched sensor is the model's.
    """
    sensor = problem.sensor
    if not sensor.pattern.magnitudes:
        return np.ones(sensor.n_measurements)
    signed = forward_model(replace(sensor, pattern=DrivePattern(sensor.pattern.table)))
    return np.sign(signed.voltages(signed.background))


def calibration_discs(problem: Problem) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """The pixels (k, H, W) of each disc whose centre lies inside the sensor, and counts (k,).

    Of discs that a symmetry of the sensor moves onto one another there is one, and their count:
    what is returned for them differs as little as the other software's mesh is asymmetric.
    """
    sensor = problem.sensor
    cx, cy, side = lattice(sensor.outline, DISCS_ACROSS)
    x, y = sensor.pixel_centres
    apart = np.hypot(x - cx[:, None, None], y - cy[:, None, None])
    discs = (apart < DISC_RADIUS * side) & sensor.mask
    moved = [motion.images(discs) for motion in motions(sensor, problem.jacobian)]
    orbits = zip(discs, *moved, strict=True)
    names = [min(image.tobytes() for image in orbit) for orbit in orbits]
    _, first, counts = np.unique(names, return_index=True, return_counts=True)
    return discs[first], counts


def lattice(outline: Outline, across: int) -> tuple[Array, Array, float]:
    """x and y (k,) [m] of `across` x `across` points, where inside, and the longer side [m]."""
    x0, y0, x1, y1 = outline.bounds
    steps = (np.arange(across) + 0.5) / across
    x, y = (c.ravel() for c in np.meshgrid(x0 + steps * (x1 - x0), y0 + steps * (y1 - y0)))
    inside = outline.contains(x, y)
    return x[inside], y[inside], outline.longer_side


def pixels_inside(problem: Problem) -> Array:
    """(P, 2) [m] the centres of the pixels inside the sensor."""
    return np.column_stack([c[problem.mask] for c in problem.sensor.pixel_centres])


def interpolation(points: Array, targets: Array) -> sparse.csr_array:
    """(T, P) sparse: linear interpolation from `points` (P, 2) to `targets` (T, 2).

    Outside of the points' convex hull the nearest point's value is taken.
    """
    mesh = Delaunay(points)
    simplex = mesh.find_simplex(targets)
    inside = simplex >= 0
    affine = mesh.transform[simplex[inside]]
    first_two = np.einsum("tij,tj->ti", affine[:, :2], targets[inside] - affine[:, 2])
    weights = np.zeros((len(targets), 3))
    weights[inside] = np.column_stack([first_two, 1 - first_two.sum(axis=1)])
    corners = np.zeros((len(targets), 3), dtype=np.int64)
    corners[inside] = mesh.simplices[simplex[inside]]
    corners[~inside] = np.asarray(cKDTree(points).query(targets[~inside])[1])[:, None]
    weights[~inside, 0] = 1.0
    rows = np.repeat(np.arange(len(targets)), 3)
    shape = (len(targets), len(points))
    return sparse.csr_array(
        sparse.coo_array((weights.ravel(), (rows, corners.ravel())), shape=shape)
    )
