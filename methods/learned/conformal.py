"""The images of `dnn` with the errors that it made on validation samples, as a distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage

from eitbench.methods.learned.image_networks import Dnn, UsesNetwork
from eitbench.methods.learned.novelty import FrameNovelty
from eitbench.methods.method import DRAWS, reconstructed
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array, Index

FRAMES, HELD_OUT = 200, 100
"""Validation samples whose errors are kept, and those by which these are widened."""
CONTRASTS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
RANGES = (0.01, 0.03, 0.1, 0.3)
"""Ends of groups of pixels: |contrast| of the image, and its range nearby, over the background."""
NEARBY = 5  # pixels
QUANTILES = 999
"""Errors that are kept of a group."""
FEWEST = 1000
"""Pixels of a group of its own; smaller ones have the errors of all pixels."""
LEVEL = 0.95
"""Share of truths that errors are widened for, on the average over frames."""
SPAN = 0.01
"""Pixels count where error and interval span more than this part of the data range."""
WIDEST = 4.0


@register("dnn-conformal")
@dataclass
class DnnConformal(UsesNetwork):
    """The image of `dnn`, with the distribution of its errors on validation samples.

    Pixels are grouped by what the image shows at them and nearby, and each group has the quantiles
    of its errors. Pixels of a frame err together, so that these are too narrow for other frames:
    they are widened by the factor, from 1 to 4, that makes 95 % right on validation samples held
    out. There is no guarantee, and frames have to be like those of validation. Pixels are drawn on
    their own, so that draws say little of places. On recorded skins, of which no true image is
    known, errors are those of simulated presses that `dnn` was trained on, which are too small.
    Its novelty is how far a frame is from those of validation, recorded ones, too.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
        amplification: of frames, see `TrainedMethod`.
    """

    source: ClassVar[str] = (
        "Vovk et al., Machine Learning 108(3), 2019 (conformal predictive distributions); Vovk, "
        "Gammerman and Shafer, Algorithmic Learning in a Random World (2005), sec. 4.5 (groups)"
    )
    uses: ClassVar = Dnn
    tuned_as: ClassVar = "dnn"

    gain_power: float = 0.0
    amplification: float = 1.0

    def fit(self, problem: Problem) -> None:
        """Load the weights, and measure the errors of validation samples.

        Raises:
            InputError: there are no weights for the sensor.
        """
        self._problem = problem
        self._network = self.fitted_network(problem, self.gain_power, self.amplification)
        first, data = problem.reference, problem.validation(FRAMES + HELD_OUT)
        try:
            images = reconstructed(self._network, problem, data)
            power = self._network.effective_gain_power
            self._novelty = FrameNovelty(problem, data, images, power)
            if data.conductivity is None:
                data = problem.training(FRAMES + HELD_OUT)
                images = reconstructed(self._network, problem, data)
        finally:
            problem.reference = first  # whatever is asked of the problem next
        assert data.conductivity is not None  # simulated
        mask = problem.mask
        whole, of_all = (data.conductivity - images)[:, mask], self._groups(images)[:, mask]
        kept = math.ceil(len(data) * FRAMES / (FRAMES + HELD_OUT))
        errors, groups = whole[:kept], of_all[:kept]
        levels = np.arange(1, QUANTILES + 1) / (QUANTILES + 1)
        quantiles = np.quantile(errors, levels)
        self._quantiles = np.tile(quantiles, ((len(CONTRASTS) + 1) * (len(RANGES) + 1), 1))
        for group, count in zip(*np.unique(groups, return_counts=True), strict=True):
            if count >= FEWEST:
                self._quantiles[group] = np.quantile(errors[groups == group], levels)
        self._drawn = np.random.default_rng(0).integers(QUANTILES, size=(DRAWS, *mask.shape))
        # As draws are judged: between the least and the largest of 39 lie 95 %.
        ends = []
        for of in of_all[kept:]:
            drawn = self._quantiles[of, self._drawn[:, mask]]
            ends.append((drawn.min(axis=0), drawn.max(axis=0)))
        low, high = np.moveaxis(np.array(ends), 1, 0)
        self._quantiles *= widening(whole[kept:], low, high, SPAN * problem.sensor.data_range)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        return self._network.reconstruct(voltages)

    def uncertainty(self, voltages: Array) -> Array:
        """Images (n, K, H, W) [S/m] with errors drawn for each pixel from those of its group."""
        images = self.reconstruct(voltages)
        # Not kept within the sensor's range: a truth at its end would be beyond all but few draws.
        return images[:, None] + self._quantiles[self._groups(images)[:, None], self._drawn]

    def novelty(self, voltages: Array) -> Array:
        """Distance (n,) of frames from those of validation, see `FrameNovelty`."""
        return self._novelty.of(voltages, self.reconstruct(voltages))

    def _groups(self, images: Array) -> Index:
        """Group (n, H, W) of every pixel of `images` [S/m]."""
        relative = images / self._problem.background
        nearby = (1, NEARBY, NEARBY)
        spread = ndimage.maximum_filter(relative, nearby) - ndimage.minimum_filter(relative, nearby)
        contrast = np.digitize(np.abs(relative - 1), CONTRASTS)
        return np.asarray(contrast * (len(RANGES) + 1) + np.digitize(spread, RANGES))


def widening(errors: Array, low: Array, high: Array, span: float) -> float:
    """The least factor of the ends `low` and `high` (n, P) with which they hold `errors` (n, P).

    `LEVEL` of them, on the average over frames, of pixels that span more than `span`; at most
    `WIDEST`, and at least 1.
    """
    # Counted before anything is widened: if wider intervals made more pixels count, the share held
    # could fall as they widen, and never reach the level.
    counted = np.maximum(high, errors) - np.minimum(low, errors) > span

    def held(factor: float) -> float:
        within = (factor * low <= errors) & (errors <= factor * high)
        shares = [within[n][counted[n]].mean() for n in range(len(errors)) if counted[n].any()]
        return float(np.mean(shares)) if shares else 1.0

    factors = np.arange(1.0, WIDEST, 0.05).tolist()
    return next((factor for factor in factors if held(factor) >= LEVEL), WIDEST)
