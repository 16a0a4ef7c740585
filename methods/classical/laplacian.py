"""One Gauss-Newton step with a Laplacian prior: the smoothest contrast that explains the data."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from eitbench.methods.classical.linearisation import ONE_STEP
from eitbench.methods.classical.one_step import OneStep, regularised_inverse
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array

# The Laplacian of a sensor has the constants as its kernel; this share of the identity, about
# (pixels across)^-2, bounds them without changing the smoothness on shorter lengths.
IDENTITY_SHARE = 1e-3


def graph_laplacian(mask: NDArray[np.bool_]) -> sparse.csc_array:
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


@register("laplacian")
@dataclass
class Laplacian(OneStep):
    """One Gauss-Newton step with a first-order smoothness prior."""

    source: ClassVar[str] = "Polydorides and Lionheart, Meas. Sci. Technol. 13(12), 2002"
    search: ClassVar = ONE_STEP

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """C J^T (J C J^T + w I)^-1 with C^-1 the Laplacian plus a little identity."""
        precision = graph_laplacian(problem.mask)
        precision = precision + IDENTITY_SHARE * sparse.eye_array(precision.shape[0])
        smoothed = splu(sparse.csc_matrix(precision)).solve(np.ascontiguousarray(jacobian.T))
        return regularised_inverse(jacobian, smoothed, self.weight)
