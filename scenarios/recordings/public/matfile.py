"""MATLAB files as plain arrays of a known shape."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError


def read_mat(path: Path, **shapes: tuple[int, ...]) -> dict[str, NDArray[np.float64]]:
    """The numeric arrays named in `shapes` of the MATLAB file at `path`.

    Raises:
        DataCorruptError: an unreadable file, a missing array, or one of another shape or kind.
    """
    import scipy.io

    try:
        content = scipy.io.loadmat(str(path), variable_names=list(shapes))
    except FileNotFoundError:
        raise
    # scipy's parser of damaged files fails in whatever way the damage leads to.
    except Exception as error:
        raise DataCorruptError(f"{path} is not a readable MATLAB file: fetch it again.") from error
    arrays = {}
    for name, shape in shapes.items():
        array = content.get(name)
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
            raise DataCorruptError(f"{path} holds no array {name!r}: fetch it again.")
        if array.shape != shape:
            raise DataCorruptError(
                f"Array {name!r} of {path} has shape {array.shape} where {shape} is expected: "
                "fetch it again."
            )
        arrays[name] = array.astype(np.float64)
    return arrays
