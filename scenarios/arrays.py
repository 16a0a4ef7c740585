"""Array types of annotations; docstrings give the shapes. Pixels of one grid on another."""

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]
"""Images (n, H, W) in the precision in which they are stored."""
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)


def unit_frames(frames: ArrayLike) -> Array:
    """Differences (n, M) in any unit divided by their rms; a frame of zeros stays as it is."""
    values = np.asarray(frames, dtype=np.float64)
    rms = np.sqrt(np.mean(values**2, axis=1, keepdims=True))
    return np.asarray(values / np.where(rms > 0, rms, 1.0))


def nearest_pixels(images: NDArray[Scalar], shape: tuple[int, int]) -> NDArray[Scalar]:
    """The nearest pixel of images (..., h, w) for each of a grid (H, W) on the same ground."""
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(int)
        for n, size in zip(shape, images.shape[-2:], strict=True)
    )
    return images[..., rows[:, None], columns]
