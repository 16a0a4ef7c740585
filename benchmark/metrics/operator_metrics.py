"""How far an operator's voltages and gradients are from a model's; the cards say what they mean."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Standard:
    """What voltages are standardised with: z = (v - mean) / std.

    Attributes:
        mean, std: (M,) [V/A].
    """

    mean: Array
    std: Array

    @classmethod
    def of(cls, voltages: Array) -> "Standard":
        """Mean and standard deviation of every measurement of `voltages` (n, M).

        Raises:
            InputError: a measurement is the same in all samples.
        """
        std = voltages.std(axis=0)
        if not (std > 0).all():
            raise InputError(
                f"Measurement {int(np.argmin(std))} is the same in all {len(voltages)} validation "
                "samples, so that it cannot be standardised: declare more of them."
            )
        return cls(voltages.mean(axis=0), std)

    def __call__(self, voltages: Array) -> Array:
        """`voltages` (..., M) standardised."""
        return np.asarray((voltages - self.mean) / self.std)


def mse(truth: Array, estimate: Array, standard: Standard) -> Array:
    """Mean squared error (n,) of standardised voltages; `truth` and `estimate` (n, M) [V/A]."""
    return np.asarray(np.mean(((estimate - truth) / standard.std) ** 2, axis=1))


def correlation(truth: Array, estimate: Array, standard: Standard) -> float:
    """Pearson correlation of standardised voltages (n, M) over all values; NaN if undefined."""
    z, y = (standard(voltages).ravel() for voltages in (truth, estimate))
    if not len(z):
        return float("nan")
    z, y = z - z.mean(), y - y.mean()
    size = float(np.linalg.norm(z) * np.linalg.norm(y))
    return float(z @ y) / size if size > 0 else float("nan")


def relative_error(truth: Array, estimate: Array) -> Array:
    """||estimate - truth|| / ||truth|| (n,) of voltages (n, M)."""
    error = np.linalg.norm(estimate - truth, axis=1)
    return np.asarray(error / np.linalg.norm(truth, axis=1))


def cosine(first: Array, second: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Cosine (n,) of the angle between rows (n, k); 0 where one is zero, and where that is."""
    sizes = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    undefined = sizes == 0
    along = np.einsum("nk,nk->n", first, second)
    return np.divide(along, sizes, out=np.zeros(len(sizes)), where=~undefined), undefined


def coarse_gradient(gradient: Array, image_shape: tuple[int, int]) -> Array:
    """A gradient (n, rH, rW) on r times finer pixels, with respect to pixels (n, H, W).

    Each pixel is one variable of the r x r finer ones inside it, so that by the chain rule its
    derivative is the sum of theirs.
    """
    height, width = image_shape
    n, fine_height, fine_width = gradient.shape
    blocks = gradient.reshape(n, height, fine_height // height, width, fine_width // width)
    return np.asarray(blocks.sum(axis=(2, 4)))
