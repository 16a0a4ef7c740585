"""Reconstruction as the posterior mean of the shapes that a network was trained on.

The network says what an image looks like; the families of its training data say what an image can
be: a few regions of one conductivity each. So the image of `dnn` is where fits of every family
begin, the frame itself, through the exact model, is what they are fitted to, and the image that is
returned is the mean over all shapes that explain the frame, each as well as its probability
(`posterior`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import special

from eitbench.methods.classical.linearisation import GAINS
from eitbench.methods.learned.image_networks import Dnn, UsesNetwork
from eitbench.methods.method import DRAWS
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.methods.shapes.fit import Fit, FrameModel, fit_frame, fit_image
from eitbench.methods.shapes.parameters import Parameters
from eitbench.methods.shapes.posterior import ROUNDING, FamilyPosterior, Sampler
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.phantoms.phantom import draw
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import scenarios

FEWEST = 50
"""Particles below which they say nothing of a covariance."""
LIBRARY = 600
"""Random phantoms of each family that an image is compared with, to find where fits begin."""
STARTS, BEST = 8, 2
"""The most similar ones, which are fitted to it, and the best of these fits, which are finished."""
BLOCK = 4
"""Side [pixels] of the blocks whose means are compared."""
ROUGH_STEPS, IMAGE_STEPS, FIRST_STEPS, FRAME_STEPS = 5, 20, 3, 12
"""Steps of the fits: of all starts to the image, of the best ones, of every family to the frame,
and of those that are left."""
UNLIKE = 10.0
"""A family whose fit to the image leaves so many times the least error is given up."""
ROUGHLY = 30.0
"""A family whose first fit to the frame leaves so many times the least error is given up."""
PIXELS = 0.02
"""Error of soft edges in place of sharp ones, relative to a frame's differences, that no family is
given up for."""
EXPLAINED = 2.0
"""A frame is explained by a shape that leaves no more than so many times its noise."""
WIDE = 3.0
"""How much wider than the Laplace approximation particles begin, for the posterior is bent."""
ATTEMPTS, AGAIN = 3, 2
"""At a frame that no particle explains, each twice as wide for the same error of the likeliest
family's fit, and with how many of the likeliest families: where there is next to no noise, a wrong
shape may be the best of all that are near to it."""
UNLIKELY = 1e-6
"""A family that is less likely by this factor than the best fit is given up."""


@register("shape-posterior")
@dataclass
class ShapePosterior(UsesNetwork):
    """The mean of all shapes of the training's families that explain the frame, begun at `dnn`.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
        particles: shapes of each family that the posterior is sampled with.
        steps: of the sampling, at most.
    """

    source: ClassVar[str] = (
        "Kolehmainen et al., Inverse Problems 15(5), 1999 (shapes); Del Moral et al., J. R. Stat. "
        "Soc. B 68(3), 2006 (sampling)"
    )
    uses: ClassVar = Dnn
    differs = "told how phantoms of its training are drawn: shapes, ranges and pixels"
    search: ClassVar = GAINS

    gain_power: float = 0.0
    particles: int = 200
    steps: int = 60

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`; also where `dnn` was trained on phantoms that have no parameters."""
        if why := super().unusable(sensor):
            return why
        try:
            _families(Dnn.files.load(sensor).metadata, sensor)
        except InputError as error:
            return str(error)
        except DataCorruptError:
            return ""  # `fit` says so, and its row fails alone
        return ""

    def fit(self, problem: Problem) -> None:
        """Load `dnn`, and draw phantoms of the families that it was trained on.

        Raises:
            InputError: no weights of `dnn` for the sensor, or such as were trained on a scenario
                that is not packaged, or on presses; parameters out of range.
        """
        whole = isinstance(self.particles, int) and isinstance(self.steps, int)
        if not (whole and self.particles >= FEWEST and self.steps >= 1):
            raise InputError(
                f"'shape-posterior' needs at least {FEWEST} particles and 1 step, in whole "
                f"numbers, got particles={self.particles!r} and steps={self.steps!r}."
            )
        self._problem = problem
        self._dnn = self.fitted_network(problem, self.gain_power)
        self._model = FrameModel(problem)
        self._kept: tuple[Array, Array] | None = None
        self._families = [_Family(p) for p in _families(self.trained_on, problem.sensor)]

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        means, draws = self._found(voltages)
        self._kept = voltages.copy(), draws
        return means

    def uncertainty(self, voltages: Array) -> Array:
        """Shapes (n, K, H, W) [S/m] of the posterior of frames (n, M).

        Of a frame that is not of the families, all are the image of `dnn`.
        """
        kept, self._kept = self._kept, None
        if kept is not None and np.array_equal(kept[0], voltages):
            return kept[1]
        return self._found(voltages)[1]

    def _found(self, voltages: Array) -> tuple[Array, Array]:
        """Mean images and draws."""
        difference = self._problem.difference(voltages, self._dnn.effective_gain_power)
        low, high = self._problem.sensor.conductivity_range
        shape, background = self._problem.mask.shape, self._problem.background
        means = np.empty((len(difference), *shape))
        draws = np.empty((len(difference), DRAWS, *shape), np.float32)
        for n, frame in enumerate(difference):
            # One by one: in batches the network rounds otherwise, and fits may end elsewhere.
            guess = self._dnn.relative(frame[None])[0].astype(np.float64).clip(low, high)
            mean, drawn = self._of_one(guess, frame)
            means[n] = mean.clip(low, high) * background
            draws[n] = drawn.clip(low, high) * background
        return means, draws

    def _of_one(self, guess: Array, frame: Array) -> tuple[Array, Array]:
        """The mean image (H, W), relative to the background, of a frame's differences (M,).

        And draws (K, H, W). Where no shape explains the frame better than the `guess` (H, W) of the
        network, that is returned: the frame is not of the families.
        """
        nothing = guess, np.repeat(guess[None], DRAWS, axis=0)
        data = self._model.data(frame)
        energy = float(data @ data)
        if not energy:
            return nothing
        fits = self._fits(guess, data)
        missing = data - self._model.differences(guess)
        if fits[0].error > missing @ missing:
            return nothing
        sampler = Sampler(self._model, data, self.particles, self.steps)
        explained = EXPLAINED * self._model.noise(frame) + ROUNDING**2 * energy
        # Every frame has the same random numbers: it does not matter which others come with it.
        rng = np.random.default_rng(0)
        found: list[FamilyPosterior] = []
        for attempt in range(ATTEMPTS if self._model.repeated else 1):
            width = WIDE**2 * 4**attempt * max(fits[0].error, PIXELS**2 * energy)
            latest = [sampler.posterior(fit, width, rng) for fit in fits]
            found += latest
            if min(one.error for one in found) <= explained:
                break
            likely = np.argsort([-one.log_evidence for one in latest])[:AGAIN]
            fits = [fits[k] for k in likely]
        # Several attempts at a family are estimates of one evidence.
        families = [one.parameters for one in found]
        evidence = np.array([
            one.log_evidence - math.log(families.count(one.parameters)) for one in found
        ])  # fmt: skip
        if not np.isfinite(evidence).any():
            return nothing
        likely = special.softmax(evidence)
        means = np.array([one.images.mean(axis=0) for one in found])
        weights = np.concatenate([
            np.full(len(one.images), p / len(one.images))
            for one, p in zip(found, likely, strict=True)
        ])  # fmt: skip
        images = np.concatenate([one.images for one in found])
        chosen = rng.choice(len(weights), DRAWS, p=weights / weights.sum())
        return np.tensordot(likely, means, axes=1), images[chosen]

    def _fits(self, guess: Array, data: Array) -> list[Fit]:
        """Fits to a frame of the families that are not given up, the best one first."""
        floor = PIXELS**2 * float(data @ data)
        starts = [family.start(guess) for family in self._families]
        least = UNLIKE * min(map(_error, starts))
        fits = [
            fit_frame(start.parameters, start.vector, self._model, data, FIRST_STEPS)
            for start in starts
            if start.error <= least
        ]
        least = ROUGHLY * (min(map(_error, fits)) + floor)
        fits = [
            fit_frame(fit.parameters, fit.vector, self._model, data, FRAME_STEPS)
            for fit in fits
            if fit.error <= least
        ]
        fits.sort(key=_error)
        least = UNLIKELY ** (-2 / self._model.count) * (fits[0].error + floor)
        return [fit for fit in fits if fit.error <= least]


class _Family:
    """A family with random phantoms of it, where fits begin."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        rng = np.random.default_rng(0)
        drawn = [draw(parameters.family, parameters.sensor, rng) for _ in range(LIBRARY)]
        self._vectors = np.array([parameters.of_phantom(phantom) for phantom in drawn])
        centred = [_centred(parameters.image(vector)) for vector in self._vectors]
        self._places = np.array([place for _, place in centred])
        blocks = np.array([blocks for blocks, _ in centred])
        self._directions = blocks / np.linalg.norm(blocks, axis=1, keepdims=True)

    def start(self, image: Array) -> Fit:
        """The best fit to an image (H, W), of those that begin at phantoms like it."""
        blocks, place = _centred(image)
        nearest = np.argsort(-self._directions @ blocks)[:STARTS]
        shifts = place - self._places[nearest]
        starts = [
            self.parameters.shifted(vector, *shift)
            for vector, shift in zip(self._vectors[nearest], shifts.tolist(), strict=True)
        ]
        fits = [fit_image(self.parameters, start, image, ROUGH_STEPS) for start in starts]
        best = sorted(fits, key=_error)[:BEST]
        fits = [fit_image(self.parameters, fit.vector, image, IMAGE_STEPS) for fit in best]
        return min(fits, key=_error)


def _error(fit: Fit) -> float:
    return fit.error


def _centred(image: Array) -> tuple[Array, Array]:
    """Mean contrast of blocks of an image (H, W) that is moved to its middle, in a row.

    Also the place (column, row) [pixels] that was moved there: the centre of the |contrast|.
    """
    contrast = image - 1
    weight = np.abs(contrast) + 1e-12
    rows, columns = np.indices(image.shape)
    place = np.array([np.average(columns, weights=weight), np.average(rows, weights=weight)])
    height, width = (size // BLOCK for size in image.shape)
    shift = np.round([image.shape[0] / 2 - place[1], image.shape[1] / 2 - place[0]]).astype(int)
    moved = np.roll(contrast, shift.tolist(), axis=(0, 1))[: height * BLOCK, : width * BLOCK]
    return moved.reshape(height, BLOCK, width, BLOCK).mean(axis=(1, 3)).ravel(), place


def _families(trained_on: Mapping[str, str], sensor: Sensor) -> list[Parameters]:
    """Parameters of the families of a training.

    Raises:
        InputError: the scenario is not packaged, or its families have no parameters.
    """
    scenario = scenarios().get(trained_on["scenario"])
    if not isinstance(scenario, SimulatedScenario):
        raise InputError(
            f"'dnn' was trained on scenario {trained_on['scenario']!r}, whose families are not "
            "known here: 'shape-posterior' needs weights that were trained on a packaged scenario."
        )
    families = scenario.split_families("train")
    unknown = [f.name for f in families if len(f.shapes) > 1 or f.pressure is not None]
    if unknown:
        raise InputError(
            f"'shape-posterior' knows no parameters of the family {unknown[0]!r}, which 'dnn' was "
            "trained on: it knows families of one shape and of given conductivity."
        )
    return [Parameters(family, sensor) for family in families]
