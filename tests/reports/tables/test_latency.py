"""The table of latencies: medians and percentiles where some touches are never detected."""

import numpy as np
import pandas as pd
import pytest

from eitbench.reports.tables.latency import latency_rows, latency_table, quantile


def touches(method: str, frames: list[float], ideal: bool = True) -> pd.DataFrame:
    """Touches that were detected after so many frames."""
    detected = np.array(frames)
    noticed = np.where(np.isinf(detected), np.nan, 1.0)
    return pd.DataFrame({
        "method": method, "pressure_kpa": 10.0, "ideal": ideal, "touch": range(len(frames)),
        "detected_frames": detected, "detected_ms": 100 * detected, "gone_frames": 2 * noticed,
        "gone_ms": 150 * noticed, "ghost": noticed, "ghost_strength": 0.03 * noticed,
        "untouched": 10, "false_contacts": [1] + [0] * (len(frames) - 1), "dropped": 0.0,
        "failed": 0.0,
    })  # fmt: skip


def test_a_quantile_is_a_value_that_was_measured() -> None:
    values = pd.Series([1.0, 2.0, 2.0, np.inf, np.nan])
    assert quantile(values, 0.5) == 2
    assert quantile(values, 0.75) == 2
    assert quantile(values, 0.95) == np.inf
    assert np.isnan(quantile(values[4:], 0.5))


def test_touches_that_are_missed_count_as_never() -> None:
    found = pd.concat([touches("b", [1, 2, np.inf, np.inf, np.inf]), touches("a", [1, 1, 2, 2, 2])])
    table = latency_table(found, {"b": 3.0, "a": 1.0})
    assert list(table["method"]) == ["b", "a"]
    assert list(table["missed"]) == [0.6, 0]
    assert list(table["detected_frames"]) == [np.inf, 2]
    assert list(table["false_contacts"]) == pytest.approx([0.02, 0.02])
    _, first, second = latency_rows(table)
    assert first[5:8] == ["60%", "never", "never"]
    assert first[9:] == ["2 (2)", "150 (150)", "100%", "3.0% (3.0%)"]
    assert second[5:8] == ["0%", "2 (2)", "200 (200)"]


def test_without_detected_touches_there_is_nothing_to_go() -> None:
    _, row = latency_rows(latency_table(touches("a", [np.inf, np.inf]), {"a": 1.0}))
    assert row[5:] == ["100%", "never", "never", "5.0%", "–", "–", "–", "–"]
