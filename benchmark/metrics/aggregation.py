"""The figures of a cell from those of its samples, in any bootstrap draw of them.

`counts` (b, n) say how often each sample of a cell occurs in each of b draws; ones stand for the
samples as they are. See `eitbench.benchmark.metrics.statistics`.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from eitbench.benchmark.metrics.image_metrics import PSNR_CEILING_DB
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.statistics import means, medians, once, spearman
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.recordings.descriptors import LOADS

LOAD_COLUMNS = (*LOADS, "depth_mm")
"""Columns of the load of a press; the first that holds a number counts."""
_FEWEST_LOADS = 3


def aggregate(cell: pd.DataFrame, specs: Sequence[MetricSpec], counts: Array) -> Array:
    """Figures (b, k) of a cell of n samples in each draw; NaN where they are not defined."""
    figures = np.full((len(counts), len(specs)), np.nan)
    for aggregate, statistic in (("mean", means), ("median", medians)):
        which = [k for k, s in enumerate(specs) if s.aggregate == aggregate and s.name in cell]
        if which:
            values = np.stack([numbers(cell, specs[k].name) for k in which], axis=1)
            figures[:, which] = statistic(counts, values)
    for k, spec in enumerate(specs):
        if callable(spec.aggregate):
            figures[:, k] = spec.aggregate(cell, counts)
    return figures


def figure_of(cell: pd.DataFrame, spec: MetricSpec) -> float:
    """Figure of the samples of a cell as they are; NaN where it is not defined."""
    return float(once(lambda counts: aggregate(cell, [spec], counts), len(cell))[0])


def numbers(cell: pd.DataFrame, name: str) -> Array:
    """Column of a cell as float64, NaN where there is no number."""
    column = cell[name]
    if column.dtype == np.float64:  # as almost all are; the other way takes 20 times as long
        return column.to_numpy(copy=True)
    return column.to_numpy(dtype=np.float64, na_value=np.nan)


def strength_spearman(cell: pd.DataFrame, counts: Array) -> Array:
    """Rank correlation of contact strength with force, pressure or press depth (b,)."""
    for name in LOAD_COLUMNS:
        if "strength" in cell and name in cell and cell[name].notna().any():
            known = (cell[name].notna() & cell["strength"].notna()).to_numpy()
            if known.sum() < _FEWEST_LOADS:
                break
            strength, load = (numbers(cell, n)[known] for n in ("strength", name))
            return spearman(counts[:, known], strength, load)
    return np.full(len(counts), np.nan)


def repeatability_db(cell: pd.DataFrame, counts: Array) -> Array:
    """20 log10 of the rms response to touched frames over that to the others (b,)."""
    has = "touched" in cell and "response" in cell
    if not has or not cell["response"].notna().any():
        return np.full(len(counts), np.nan)
    known = (cell["touched"].notna() & cell["response"].notna()).to_numpy()
    touched = cell["touched"].to_numpy()[known].astype(bool)
    power = np.square(numbers(cell, "response")[known])[:, None]
    signal, noise = (means(counts[:, known] * of, power)[:, 0] for of in (touched, ~touched))
    # Responses are differences of float32 images, so silence below their rounding means nothing.
    with np.errstate(divide="ignore"):
        ratio = 10 * np.log10(signal / np.maximum(noise, 1e-60))
    return np.where(signal > 0, np.minimum(ratio, PSNR_CEILING_DB), np.nan)
