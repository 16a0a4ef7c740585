"""Array types of annotations; docstrings give the shapes. Pixels of one grid on another."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]
"""Images (n, H, W) in the precision in which they are stored."""
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)


def nearest_pixels(images: NDArray[Scalar], shape: tuple[int, int]) -> NDArray[Scalar]:
    """The nearest pixel of images (..., h, w) for each of a grid (H, W) on the same ground."""
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(int)
        for n, size in zip(shape, images.shape[-2:], strict=True)
    )
    return images[..., rows[:, None], columns]
