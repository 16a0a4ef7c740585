"""The images of `dnn` with the errors that it made on validation samples, as a distribution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage

from eitbench.methods.classical.linearisation import GAINS
from eitbench.methods.learned.image_networks import Dnn, UsesNetwork
from eitbench.methods.method import DRAWS, reconstructed
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array, Images, Index

FRAMES = 200
"""Validation samples: 1.3 million errors of pixels of 80 x 80 images."""
CONTRASTS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
RANGES = (0.01, 0.03, 0.1, 0.3)
"""Ends of groups of pixels: |contrast| of the image, and its range nearby, over the background."""
NEARBY = 5  # pixels
QUANTILES = 999
"""Errors that are kept of a group."""
FEWEST = 1000
"""Pixels of a group of its own; smaller ones have the errors of all pixels."""


@register("dnn-conformal")
@dataclass
class DnnConformal(UsesNetwork):
    """The image of `dnn`, with the distribution of its errors on validation samples.

    Pixels are grouped by what the image shows at them and nearby, and each group has the quantiles
    of its errors: as often as on validation samples, the truth lies between two of them. That holds
    for pixels of a group on the average, and only for frames like those of validation. Pixels are
    drawn on their own, so that draws say little of places. On recorded skins, of which no true
    image is known, errors are those of simulated presses.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
    """

    source: ClassVar[str] = (
        "Vovk et al., Machine Learning 108(3), 2019 (conformal predictive distributions); Vovk, "
        "Gammerman and Shafer, Algorithmic Learning in a Random World (2005), sec. 4.5 (groups)"
    )
    uses: ClassVar = Dnn
    search: ClassVar = GAINS

    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Load the weights, and measure the errors of validation samples.

        Raises:
            InputError: there are no weights for the sensor.
        """
        self._problem = problem
        self._network = self.fitted_network(problem, self.gain_power)
        first, data = problem.reference, problem.validation(FRAMES)
        if data.conductivity is None:
            data = problem.training(FRAMES)
        images = reconstructed(self._network, problem, data)
        problem.reference = first
        assert data.conductivity is not None  # simulated
        mask = problem.mask
        errors = (data.conductivity - images)[:, mask]
        groups = self._groups(images)[:, mask]
        levels = np.arange(1, QUANTILES + 1) / (QUANTILES + 1)
        quantiles = np.quantile(errors, levels)
        self._quantiles = np.tile(quantiles, ((len(CONTRASTS) + 1) * (len(RANGES) + 1), 1))
        for group, count in zip(*np.unique(groups, return_counts=True), strict=True):
            if count >= FEWEST:
                self._quantiles[group] = np.quantile(errors[groups == group], levels)
        self._drawn = np.random.default_rng(0).integers(QUANTILES, size=(DRAWS, *mask.shape))

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        return self._network.reconstruct(voltages)

    def uncertainty(self, voltages: Array) -> Array:
        """Images (n, K, H, W) [S/m] with errors drawn for each pixel from those of its group."""
        images = self.reconstruct(voltages)
        errors = self._quantiles[self._groups(images)[:, None], self._drawn]
        low, high = self._problem.sensor.conductivity_range
        background = self._problem.background
        return (images[:, None] + errors).clip(low * background, high * background)

    def _groups(self, images: Images) -> Index:
        """Group (n, H, W) of every pixel of `images` [S/m]."""
        relative = images / self._problem.background
        nearby = (1, NEARBY, NEARBY)
        spread = ndimage.maximum_filter(relative, nearby) - ndimage.minimum_filter(relative, nearby)
        contrast = np.digitize(np.abs(relative - 1), CONTRASTS)
        return np.asarray(contrast * (len(RANGES) + 1) + np.digitize(spread, RANGES))
