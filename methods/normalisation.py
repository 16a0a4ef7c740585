"""Differences as the nominal sensor would have measured them: gains taken out, faults filled in.

Boards and skins are not what their model is: channels differ, common-mode voltage leaks into
differences, the gel is uneven. To first order each measurement is then the modelled one times a
gain h_m of its own, dv = h J x + noise, and the reference frame shows it, h_m = |v_ref,m| / |V_m|.
What the nominal sensor would have measured, J x, is estimated with a prior covariance C of x, here
that of the smoothest contrasts (the inverse of a Laplacian):

    J x = G h (h G h + w I)^-1 dv,    G = J C J^T,

which trusts every volt alike, so that weak measurements count little. Divided by its gain alone, a
weak measurement would be mostly noise. A value that a dead electrode or saturation spoils is left
out of dv and comes back from the others.

Source: Barber and Seagar, Clin. Phys. Physiol. Meas. 8 (1987) suppl. A, 47, for normalised
differences; the estimate is the posterior mean of Gaussian noise and prior.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from eitbench.scenarios.arrays import Array

LARGEST_GAIN = 10.0
"""A gain that is larger, or smaller than its inverse, is taken for a measurement near zero."""
WEIGHT = 0.3
"""w over the mean diagonal of h G h. Of 0.03 to 3, it suits the validation presses of both `ohmc16`
and `superpose500`."""
FAULT_WEIGHT = 1e-3
"""The same where only faults are filled in, from values that are as good as the model. Of 1e-4 to
0.1, it suits simulated units with other dead electrodes than those of the suite `sim2real`."""


def gains_of_reference(reference: Array, modelled: Array, kept: NDArray[np.bool_]) -> Array:
    """Gains (M,) of measurements over the median of those `kept`, within `LARGEST_GAIN` of it."""
    expected = np.abs(modelled)
    floor = 1e-6 * expected.max()
    measured = np.abs(reference) / np.median(np.abs(reference[kept]))
    expected = np.maximum(expected, floor) / np.median(expected[kept])
    gains = np.maximum(measured, expected.min()) / expected
    return np.asarray(np.clip(gains / np.median(gains[kept]), 1 / LARGEST_GAIN, LARGEST_GAIN))


def estimate_of_nominal(gram: Array, gains: Array, kept: NDArray[np.bool_], weight: float) -> Array:
    """G h (h G h + w I)^-1 (M, M): values of the nominal sensor from those `kept` (M,)."""
    shown = gram[:, kept] * gains[kept]
    seen = gains[kept, None] * shown[kept]
    damped = seen + weight * np.trace(seen) / len(seen) * np.eye(len(seen))
    estimate = np.zeros(gram.shape)
    estimate[:, kept] = linalg.solve(damped, shown.T, assume_a="pos").T
    return estimate
