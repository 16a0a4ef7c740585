"""Metrics of forward operators: errors of their voltages and gradients against a model's."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.benchmark.metrics.metric_spec import SMALL, TIME, MetricSpec
from eitbench.benchmark.metrics.statistics import Interval, bootstrap
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError


@dataclass(frozen=True, eq=False)
class Standard:
    """Mean and spread by which voltages are standardised: z = (v - mean) / std.

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
                "samples, so that it cannot be standardised: declare more validation samples."
            )
        return cls(voltages.mean(axis=0), std)


def mse(truth: Array, estimate: Array, standard: Standard) -> Array:
    """Mean squared error (n,) of standardised voltages; `truth` and `estimate` (n, M) [V/A]."""
    return np.asarray(np.mean(((estimate - truth) / standard.std) ** 2, axis=1))


def correlation(
    truth: Array, estimate: Array, reference: Array, clusters: ArrayLike | None = None
) -> Interval:
    """Pearson correlation of responses v - reference (n, M) over all values; NaN if undefined.

    Its interval is that over `clusters` (n,) of samples, see `bootstrap`; by default each sample
    is one. Without two of them it is NaN.
    """
    z, y = truth - reference, estimate - reference
    sums = np.stack([a.sum(axis=1) for a in (np.ones_like(z), z, y, z * z, y * y, z * y)], axis=1)
    of = np.arange(len(sums)) if clusters is None else np.asarray(clusters)
    if len(np.unique(of)) < 2:
        value = float(_correlations(np.ones((1, len(sums))), sums)[0, 0])
        return Interval(value, np.nan, np.nan)
    (found,) = bootstrap(sums, of, _correlations)
    return found


def _correlations(counts: Array, sums: Array) -> Array:
    """Correlations (b, 1) of draws from the sums of each sample (n, 6): 1, z, y, zz, yy, zy."""
    count, z, y, zz, yy, zy = (counts @ sums).T
    with np.errstate(divide="ignore", invalid="ignore"):
        spread_z, spread_y = zz - z * z / count, yy - y * y / count
        # What is left by rounding is no spread.
        spread_y = np.where(spread_y > 1e-12 * yy, spread_y, np.nan)
        return np.asarray((zy - z * y / count) / np.sqrt(spread_z * spread_y))[:, None]


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
    """Return a gradient (n, rH, rW) on r times finer pixels with respect to pixels (n, H, W).

    Each pixel is one variable of the r x r finer ones inside it, so that by the chain rule its
    derivative is the sum of theirs.
    """
    height, width = image_shape
    n, fine_height, fine_width = gradient.shape
    blocks = gradient.reshape(n, height, fine_height // height, width, fine_width // width)
    return np.asarray(blocks.sum(axis=(2, 4)))


_metric = partial(MetricSpec, domain="forward operators on simulated scenarios")
_cost = partial(_metric, best="min", mask="does not apply", aggregate=None)
_ALL_VOLTAGES = "all measurements"

_SPECS = (
    _metric(
        "mse",
        "MSE",
        formula="mean (y - z)^2; standardised: every measurement minus its mean, over its "
        "standard deviation, both over the clean voltages of the scenario's whole "
        "validation split",
        best="min",
        mask=_ALL_VOLTAGES,
        form=SMALL,
        traps="1 is the error of always answering the mean. Standardising weighs every "
        "measurement alike, so the small ones, far from the drive, count as much as the "
        "large ones. It depends on the phantoms of the validation split: figures for "
        "other phantoms, published ones included, do not compare to the digit. On data of"
        " the operator's own mesh it says nothing of the discretisation.",
    ),
    _metric(
        "r",
        "R",
        formula="Pearson correlation of w - v0 and v - v0 in V/A, v0 of the untouched sensor, over "
        "all samples and measurements at once",
        best="max",
        mask=_ALL_VOLTAGES,
        aggregate=None,
        form=".5f",
        traps="Blind to a common scale and offset. Close to 1 it hardly moves: 0.97 and 0.995 "
        "are an error six times as large in MSE. The large responses next to the drive decide it. "
        "Not defined where all answers are alike.",
    ),
    _metric(
        "rel_error",
        "Relative error",
        formula="||w - v|| / ||v||, in V/A, not standardised",
        best="min",
        mask=_ALL_VOLTAGES,
        form=SMALL,
        traps="Relative to the whole voltage, of which a touch changes a small part: always "
        "answering the untouched sensor's voltages scores well. The large voltages beside"
        " the drive decide it.",
    ),
    _metric(
        "grad_cosine",
        "Gradient cosine",
        formula="cosine of the angle between J(t)^T g of the operator and of the model the data "
        "come from, g = v - v of the untouched sensor; where the data's mesh is finer, "
        "its gradient with respect to a pixel is the sum over the finer pixels in it "
        "(chain rule)",
        best="max",
        form=".4f",
        traps="Direction only: a gradient of the wrong length scores 1. One cotangent a sample,"
        " the same for all operators, along which a reconstruction would first move; "
        "other directions are not looked at. Pixels at the rim, where gradients are "
        "largest, decide it. A gradient of zero has no direction; it counts as 0 and its "
        "row is flagged `grad_undefined`.",
    ),
)
_COSTS = (
    _cost(
        "forward_ms",
        "Forward",
        formula="time of `voltages` for a batch of 64 samples over 64, in the operator's "
        "precision (float32 for the surrogate, else float64); median over warm batches, "
        "one thread",
        unit="ms",
        form=TIME,
        traps="A batch is what training needs; one sample alone takes longer than this. Smaller"
        " runs have smaller batches, and cells that run side by side disturb each other.",
    ),
    _cost(
        "grad_ms",
        "Gradient",
        formula="time of one `vjp`, its forward pass included, measured like the forward time",
        unit="ms",
        form=TIME,
        traps="Not the extra time of the gradient: subtract the forward time for that.",
    ),
    _cost(
        "setup_s",
        "Set-up",
        formula="time to make the operator for the sensor",
        unit="s",
        form=TIME,
        traps="Loading libraries is left out, and so is what the operator postpones to its "
        "first answer, such as compiling: that is in `first_frame_ms`.",
    ),
    _cost(
        "memory_mb",
        "Memory",
        formula="peak resident memory of the operator's process",
        unit="MiB",
        form=".0f",
        traps="Libraries are in it, some 250 MiB, and a batch of images and gradients.",
    ),
    _cost(
        "train_s",
        "Training",
        formula="time its weights took to train, as their file says; 0 where nothing is trained",
        unit="s",
        form=TIME,
        traps="On the device named in `trained_on`, not on this machine, and without the "
        "simulation of its training data or the search for its settings.",
    ),
)

OPERATOR_METRICS = {spec.name: spec for spec in _SPECS}
OPERATOR_COSTS = {spec.name: spec for spec in _COSTS}
