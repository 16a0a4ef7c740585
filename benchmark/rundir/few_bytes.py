"""Numbers and images of records in few bytes: with no more digits than anybody reads."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array

DIGITS = 17
"""Binary digits that are kept of numbers, which are then known to eight millionths."""
FRAME_DIGITS = 16
"""Hexadecimal digits that are kept of the hash of a frame, by which it is known."""
NOTHING = -(2**15)
"""In place of a pixel without a value."""


def with_short_hashes(samples: pd.DataFrame) -> pd.DataFrame:
    """Rows of samples with the `FRAME_DIGITS` of `input_hash` that records and runs have."""
    return samples.assign(input_hash=samples["input_hash"].str[:FRAME_DIGITS])


def rounded(values: ArrayLike) -> Array:
    """Round numbers (...) to `DIGITS` binary digits each; their other bits are 0."""
    mantissa, exponent = np.frexp(np.asarray(values, dtype=np.float64))
    return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, DIGITS)), exponent - DIGITS))


def packed(images: ArrayLike, step: float) -> NDArray[np.uint16]:
    """Round images (n, H, W) to whole steps, in a form (n, H, W) that compresses well.

    A `step` is in the unit of the images.

    A pixel is predicted from those to its left, above and between (as of a plane), and the error,
    which is mostly near to 0, is stored with its sign in the last bit.
    """
    steps = np.round(np.asarray(images, dtype=np.float64) / step)
    near = np.clip(np.nan_to_num(steps), NOTHING + 1, -NOTHING - 1)
    whole = np.where(np.isnan(steps), NOTHING, near).astype(np.int16)
    # Integers of 16 bits wrap around, here as there.
    errors = np.diff(np.diff(whole, axis=1, prepend=np.int16(0)), axis=2, prepend=np.int16(0))
    return ((errors << 1) ^ (errors >> 15)).view(np.uint16)


def unpacked(stored: NDArray[np.uint16], step: float) -> Array:
    """Return images (n, H, W), in the unit of the `step`, from what `packed` made of them.

    NaN stands where there is no value.
    """
    errors = ((stored >> 1) ^ -(stored & 1)).view(np.int16)
    whole = errors.cumsum(axis=2, dtype=np.int16).cumsum(axis=1, dtype=np.int16)
    return np.where(whole == NOTHING, np.nan, whole * step)
