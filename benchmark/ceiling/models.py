"""Voltages of phantoms: the exact model of the data, and a stand-in for it that is quicker.

The exact model has the mesh, the pixels and the electrodes that frames come from. The quick model
has the same electrodes and `QUICK_SHAPE` pixels, on which shapes have soft edges; `StandIn` brings
it near to the exact one. What is left at the end is which of the fine pixels lie in a shape, which
no smooth function of its parameters tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eitbench.benchmark.ceiling.frames import Errors, Frame
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.methods.shapes.fit import EDGE
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.phantoms.phantom import Phantom
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.sensors.patterns import equal_noise
from eitbench.scenarios.sensors.sensor import Sensor

QUICK_SHAPE = (40, 40)
RIDGE = 1e-3
"""Least standard deviation that slopes are fitted along, relative to the greatest."""
EVEN = 0.3
"""Part of the errors' variance that is taken to be alike in all directions: a few errors do not
tell their covariance."""
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class StandIn:
    """The quick model after an affine map, which a few exact solutions have been fitted to.

    What it still errs by is taken for noise of the covariance that it has there (approximation
    error: Kaipio and Somersalo, Statistical and Computational Inverse Problems, 2005, 5.8).

    Attributes:
        before, after: (K,) a prediction of the quick model, and what it becomes.
        slopes: (K, K) of what is added.
        errors: (n, K) whose products sum to the covariance of the errors [V/A].
    """

    before: Array
    after: Array
    slopes: Array
    errors: Array

    @classmethod
    def fitted(cls, quick: Array, exact: Array) -> StandIn:
        """The map that takes quick predictions (n, K) to the exact ones (n, K), nearly."""
        before, after = quick.mean(axis=0), exact.mean(axis=0)
        left, deviations, right = np.linalg.svd(quick - before, full_matrices=False)
        kept = deviations**2 / (deviations**2 + RIDGE**2 * deviations[0] ** 2 + TINY)
        missing = exact - after - (quick - before)
        slopes = (right.T * (kept / np.maximum(deviations, TINY))) @ (left.T @ missing)
        # Of each what a fit to the others would leave.
        leverage = 1 / len(quick) + (left**2) @ kept
        errors = (missing - (quick - before) @ slopes) / (1 - leverage).clip(min=1e-3)[:, None]
        return cls(before, after, slopes, errors / np.sqrt(len(quick)))

    def __call__(self, quick: Array) -> Array:
        """Predictions (n, K) [V/A]."""
        away = quick - self.before
        return np.asarray(self.after + away + away @ self.slopes)

    def errors_in(self, frame: Frame) -> Errors:
        """The errors as noise of a frame."""
        _, deviations, directions = np.linalg.svd(self.errors, full_matrices=False)
        variances = (deviations / frame.deviation(self.after[None])) ** 2
        even = EVEN * variances.sum() / len(self.after)
        return Errors((1 - EVEN) * variances, directions, float(even))


class PhantomModels:
    """Models of the phantoms of several families, as combinations (n, K) of equal noise [V/A].

    A phantom is the number of its family and a vector of parameters, filled up to the longest.

    Attributes:
        priors: of the families.
    """

    def __init__(self, priors: tuple[FamilyPrior, ...], exact: ForwardModel) -> None:
        self.priors = priors
        nominal = priors[0].parameters.sensor
        built = replace(nominal, image_shape=QUICK_SHAPE, electrodes=exact.sensor.electrodes)
        self._exact, self._quick = exact, ForwardModel(built)
        pattern = nominal.pattern
        self._combine, _ = equal_noise(pattern)
        self._fine = self._painted(exact.sensor)
        self._coarse = self._painted(self._quick.sensor)

    def _painted(self, sensor: Sensor) -> list[Parameters]:
        return [Parameters(prior.parameters.family, sensor) for prior in self.priors]

    def of_phantom(self, phantom: Phantom) -> tuple[Index, Array]:
        """The number (1,) of the family of a phantom that `priors` draw, and its vector (1, P)."""
        number = next(
            number
            for number, prior in enumerate(self.priors)
            if prior.parameters.family.name == phantom.family
            and phantom.shape in (prior.shape, phantom.family)  # the one of a family of one shape
        )
        width = max(len(prior.parameters.low) for prior in self.priors)
        vector = self.priors[number].parameters.of_phantom(phantom)
        return np.array([number]), np.pad(vector, (0, width - len(vector)))[None]

    def frame(self, voltages: Array, snr_db: float) -> Frame:
        """The frame `voltages` (M,) [V/A]."""
        data = voltages @ self._combine
        rest = max(float(voltages @ voltages - data @ data), 0.0)
        return Frame(data, rest, len(voltages), snr_db)

    def untouched(self) -> StandIn:
        """The stand-in that is right for the untouched sensor."""
        before, after = (
            model.voltages(model.background) @ self._combine for model in (self._quick, self._exact)
        )
        size = len(before)
        return StandIn(before, after, np.zeros((size, size)), np.zeros((1, size)))

    def quick(self, families: Index, vectors: Array) -> Array:
        """Predictions by the quick model."""
        return self._solved(self._quick, images(self._coarse, families, vectors, EDGE))

    def exact(self, families: Index, vectors: Array) -> Array:
        """Predictions by the exact model."""
        return self._solved(self._exact, images(self._fine, families, vectors))

    def _solved(self, model: ForwardModel, relative: Array) -> Array:
        return np.asarray(model.voltages(relative * model.sensor.background) @ self._combine)


def images(
    parameters: list[Parameters], families: Index, vectors: Array, edge: float = 0.0
) -> Array:
    """Conductivity over the background (n, H, W) of phantoms; `edge` in pixels."""
    found = np.empty((len(families), *parameters[0].sensor.image_shape))
    for family in np.unique(families).tolist():
        of, some = parameters[family], families == family
        found[some] = of.images(vectors[some, : len(of.low)], edge)
    return found
