"""What one frame says of an image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eitbench.scenarios.arrays import Array


class Errors(NamedTuple):
    """Errors of predictions, as noise.

    Attributes:
        variances: (E,) over that of the measurements' noise.
        directions: (E, K) of length 1, at right angles to each other.
        even: variance that all directions have besides.
    """

    variances: Array
    directions: Array
    even: float

    def part(self, share: float) -> Errors:
        """Errors of this share of the variance."""
        return Errors(share * self.variances, self.directions, share * self.even)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame v (M,) with white noise of known signal-to-noise ratio R.

    With the exact voltages F of an image,

        log p(v | F) = -M log s - |v - F|^2 / (2 s^2),    s^2 = 10^(-R / 10) |F|^2 / M,

    which is how simulated frames get their noise (`scenarios.imperfections.noise`).

    Attributes:
        data: (K,) the independent combinations of v that have the noise of one measurement [V/A].
        rest: sum of squares [(V/A)^2] of what is left: reciprocity forbids it, it is noise.
        measurements: M.
        snr_db: R.
    """

    data: Array
    rest: float
    measurements: int
    snr_db: float

    def deviation(self, predicted: Array) -> Array:
        """Standard deviation s (n,) [V/A] of the noise at predicted combinations (n, K)."""
        power = (predicted**2).sum(axis=1) / self.measurements
        return np.asarray(np.sqrt(10 ** (-self.snr_db / 10) * power))

    def log_likelihood(
        self, predicted: Array, sharpness: float = 1.0, errors: Errors | None = None
    ) -> Array:
        """log p(v | F) (n,), but for a constant, of predicted combinations (n, K) [V/A].

        Args:
            predicted: the combinations.
            sharpness: b > 0; without errors, the power of the likelihood whose logarithm is
                returned. Errors are not made smaller or larger by it.
            errors: of the predictions, if any, which are added to the noise.
        """
        deviation, missing = self.deviation(predicted), self.data - predicted
        squares = (missing**2).sum(axis=1)
        if errors is not None:
            sharpness = sharpness / (1 + sharpness * errors.even)
            lost = sharpness * errors.variances / (1 + sharpness * errors.variances)
            squares = squares - (missing @ errors.directions.T) ** 2 @ lost
        return np.asarray(
            -sharpness
            * (self.measurements * np.log(deviation) + (self.rest + squares) / (2 * deviation**2))
        )
