"""Force or pressure from the strength of images, calibrated by presses whose load is known."""

import json
import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.recordings.descriptors import LOADS

_FEWEST = 3


@dataclass(frozen=True)
class LoadCalibration:
    """Line from the strength of an image [S/m * m^2] to what presses.

    Attributes:
        quantity: column of the load, "force_N" [N] or "pressure_pa" [Pa].
        offset, slope: load = offset + slope * strength; the slope is not negative.
        full_scale: largest load of the presses it was fitted to.
    """

    quantity: str
    offset: float
    slope: float
    full_scale: float

    def error(self, strength: ArrayLike, samples: pd.DataFrame) -> Array:
        """|load of images - load of samples| (n,); NaN where that is not known."""
        known = samples[self.quantity].to_numpy(dtype=np.float64, na_value=np.nan)
        return np.asarray(np.abs(self.offset + self.slope * np.asarray(strength, float) - known))

    def to_json(self) -> str:
        """Return JSON that `from_json` reads without loss."""
        return json.dumps([self.quantity, self.offset, self.slope, self.full_scale])

    @classmethod
    def from_json(cls, text: str) -> "LoadCalibration":
        """Read what `to_json` wrote.

        Raises:
            ValueError, TypeError: it is no calibration.
        """
        try:
            quantity, *numbers = json.loads(text)
            offset, slope, full_scale = map(float, numbers)
        except (OverflowError, RecursionError) as error:
            raise ValueError("it is no calibration") from error
        if not (quantity in LOADS and all(map(math.isfinite, (offset, slope)))):
            raise ValueError("it is no calibration")
        if not (slope >= 0 and 0 < full_scale < math.inf):
            raise ValueError("it is no calibration")
        return cls(quantity, offset, slope, full_scale)


def fit_load(samples: pd.DataFrame, strength: ArrayLike) -> LoadCalibration | None:
    """Fit the line with the least squares from `strength` (n,) to the load of `samples`.

    A slope below 0, or images of one strength, say nothing of the load: the line is then its mean.
    None where fewer than three loads above 0 are known.
    """
    for quantity in LOADS:
        if quantity not in samples:
            continue
        load = samples[quantity].to_numpy(dtype=np.float64, na_value=np.nan)
        known = np.isfinite(load) & (load > 0)
        if known.sum() < _FEWEST:
            continue
        x, y = np.asarray(strength, float)[known], load[known]
        spread = float(np.sum((x - x.mean()) ** 2))
        slope = max(float((x - x.mean()) @ y) / spread, 0.0) if spread > 0 else 0.0
        return LoadCalibration(quantity, float(y.mean() - slope * x.mean()), slope, float(y.max()))
    return None
