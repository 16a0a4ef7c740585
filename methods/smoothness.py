"""The prior of smooth contrasts: a Laplacian over the pixels of the sensor."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from eitbench.scenarios.arrays import Array

# The Laplacian of a sensor has the constants as its kernel; this share of the identity, about
# (pixels across)^-2, bounds them without changing the smoothness on shorter lengths.
_IDENTITY_SHARE = 1e-3


def _graph_laplacian(mask: NDArray[np.bool_]) -> sparse.csc_array:
    """(P, P) Laplacian of the neighbourhood of the masked pixels (zero flux across the rim)."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    pairs = []
    for first, second in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:])):
        both = (first >= 0) & (second >= 0)
        pairs.append(np.stack([first[both], second[both]]))
    i, j = np.concatenate(pairs, axis=1)
    size = int(mask.sum())
    links = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(size, size)).tocsr()
    links = links + links.T
    return sparse.csc_array(sparse.diags_array(links.sum(axis=1)) - links)


def smoothed(jacobian: Array, mask: NDArray[np.bool_]) -> Array:
    """C J^T (P, M) of rows (M, P), with C^-1 the Laplacian plus a little identity."""
    precision = _graph_laplacian(mask)
    precision = precision + _IDENTITY_SHARE * sparse.eye_array(precision.shape[0])
    return np.asarray(splu(sparse.csc_matrix(precision)).solve(np.ascontiguousarray(jacobian.T)))
