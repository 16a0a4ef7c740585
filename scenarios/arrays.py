"""Array types of annotations; docstrings give the shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]
"""Images (n, H, W) in the precision in which they are stored."""
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
