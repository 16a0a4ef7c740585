"""Figures of whole cells: hand-worked, beside SciPy, and in draws as if rows were repeated."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from eitbench.benchmark.metrics.aggregation import (
    aggregate,
    figure_of,
    repeatability_db,
    strength_spearman,
)
from eitbench.benchmark.metrics.specs import METRICS

SPECS = tuple(METRICS.values())


def once(statistic, cell: pd.DataFrame) -> float:  # type: ignore[no-untyped-def]
    return float(statistic(cell, np.ones((1, len(cell))))[0])


def cell(n: int = 40) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    rows = pd.DataFrame({name: rng.normal(size=n) for name in METRICS})
    rows = rows.drop(columns=["strength_spearman", "repeatability_db"])
    rows.loc[::3, "localisation_mm"] = np.nan
    rows["iou_resistive"] = np.nan
    rows["strength"] = rng.integers(5, size=n).astype(float)
    rows["depth_mm"] = rng.integers(4, size=n).astype(float)
    rows["response"] = rng.exponential(size=n)
    rows["touched"] = rng.integers(2, size=n).astype(bool)
    return rows


def test_a_draw_is_as_if_rows_were_repeated() -> None:
    rows = cell()
    counts = np.random.default_rng(1).integers(4, size=(7, len(rows))).astype(float)
    found = aggregate(rows, SPECS, counts)
    for drawn, figures in zip(counts, found, strict=True):
        repeated = rows.loc[np.repeat(rows.index, drawn.astype(int))].reset_index(drop=True)
        again = aggregate(repeated, SPECS, np.ones((1, len(repeated))))[0]
        np.testing.assert_allclose(figures, again, rtol=1e-12)


def test_means_and_medians_are_those_of_numpy() -> None:
    rows = cell()
    figures = dict(zip(METRICS, aggregate(rows, SPECS, np.ones((1, len(rows))))[0], strict=True))
    assert figures["ssim"] == pytest.approx(rows["ssim"].mean())
    assert figure_of(rows, METRICS["ssim"]) == pytest.approx(figures["ssim"])
    assert figures["localisation_mm"] == pytest.approx(rows["localisation_mm"].median())
    assert np.isnan(figures["iou_resistive"])
    spearman = stats.spearmanr(rows["strength"], rows["depth_mm"]).statistic
    assert figures["strength_spearman"] == pytest.approx(spearman)


def test_a_correlation_of_ties_and_constants() -> None:
    def correlation(strength: list[float], depth: list[float]) -> float:
        return once(strength_spearman, pd.DataFrame({"strength": strength, "depth_mm": depth}))

    # Hand-worked with ties: ranks 1, 2, 3, 4 against 1.5, 1.5, 3.5, 3.5.
    assert correlation([1, 2, 3, 4], [5, 5, 6, 6]) == pytest.approx(4 / np.sqrt(20))
    assert correlation([3, 2, 1], [10, 15, 20]) == pytest.approx(-1)
    assert correlation([2, 2, 2], [1, 2, 3]) == 0
    assert np.isnan(correlation([1, 2, 3], [7, 7, 7]))
    assert np.isnan(correlation([1, 2], [1, 2]))


def test_strength_follows_depth_or_pressure() -> None:
    rows = pd.DataFrame({"strength": [1.0, 2.0, 3.0, 9.0], "depth_mm": [10, 15, 20, np.nan]})
    assert once(strength_spearman, rows) == pytest.approx(1)
    rows["pressure_pa"] = [3e3, 2e3, 1e3, np.nan]
    assert once(strength_spearman, rows) == pytest.approx(-1)
    assert np.isnan(once(strength_spearman, rows[["strength"]]))


def test_response_of_touched_over_untouched_frames() -> None:
    rows = pd.DataFrame(
        {"response": [0.001, 0.001, 0.01, 0.02], "touched": [False, False, True, True]}
    )
    ratio = np.sqrt((0.01**2 + 0.02**2) / 2) / 0.001
    assert once(repeatability_db, rows) == pytest.approx(20 * np.log10(ratio))
    assert np.isnan(once(repeatability_db, rows.assign(response=0.0)))
    assert np.isnan(once(repeatability_db, rows.assign(touched=True)))
    silent = rows.assign(response=[0.0, 0.0, 0.01, 0.02])
    assert once(repeatability_db, silent) == pytest.approx(138.5, abs=0.1)
