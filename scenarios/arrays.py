"""Array types of annotations; docstrings give the shapes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]
"""Images (n, H, W) in the precision in which they are stored."""
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def unit_frames(frames: ArrayLike) -> Array:
    """Differences (n, M) in any unit divided by their rms; a frame of zeros stays as it is."""
    values = np.asarray(frames, dtype=np.float64)
    rms = np.sqrt(np.mean(values**2, axis=1, keepdims=True))
    return np.asarray(values / np.where(rms > 0, rms, 1.0))
