"""The table and the figure of the study of real presses: errors by the number learned from."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark.metrics.statistics import bootstrap, medians
from eitbench.reports.figures.style import NOTE, label_axes, new_figure, save
from eitbench.reports.tables.formats import markdown_table

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


ErrorRow = dict[str, Any]
"""Errors [mm] of an estimator that learned from so many real presses, over `n` others."""


def summary(errors: pd.DataFrame) -> list[ErrorRow]:
    """Median error [mm] with its 95 % interval, and 90th percentile, by estimator and count."""
    rows = []
    for (name, _), group in errors.groupby(["estimator", "presses"], sort=False):
        error = group["error_mm"].to_numpy()
        middle = bootstrap(error[:, None], group["press"], medians)[0]
        rows.append(
            {
                "estimator": str(name),
                "presses": int(group["presses"].iloc[0]),
                "median_mm": middle.value,
                "low_mm": middle.low,
                "high_mm": middle.high,
                "p90_mm": float(np.quantile(error, 0.9)),
                "n": len(error),
            }
        )
    return rows


def write_real_trained(errors: pd.DataFrame, recording: str, folder: Path) -> list[Path]:
    """Write `errors.parquet`, `real-trained.{json,md,png,pdf}` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = summary(errors)
    errors.to_parquet(folder / "errors.parquet")
    stem = folder / "real-trained"
    about = {"recording": recording, "rows": rows}
    stem.with_suffix(".json").write_text(json.dumps(about, indent=1) + "\n")
    stem.with_suffix(".md").write_text(to_markdown(rows))
    tables = [folder / "errors.parquet", stem.with_suffix(".json"), stem.with_suffix(".md")]
    return [*tables, *save(_drawn(rows, recording), stem)]


def to_markdown(rows: list[ErrorRow]) -> str:
    """One row per estimator, one column per count: the median error [mm]."""
    counts = sorted({row["presses"] for row in rows})
    median = {(row["estimator"], row["presses"]): f"{row['median_mm']:.1f}" for row in rows}
    body = [
        [name, *(median.get((name, count), "–") for count in counts)]
        for name in dict.fromkeys(row["estimator"] for row in rows)
    ]
    return "\n".join(markdown_table(["real presses", *map(str, counts)], body)) + "\n"


def _drawn(rows: list[ErrorRow], recording: str) -> Figure:
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    counts = sorted({row["presses"] for row in rows})
    for name, of in pd.DataFrame(rows).groupby("estimator", sort=False):
        place, middle = np.searchsorted(counts, of["presses"]), of["median_mm"].to_numpy()
        ends = np.abs(of[["low_mm", "high_mm"]].to_numpy().T - middle)
        axes.errorbar(place, middle, ends, fmt="o-", ms=4, capsize=3, label=str(name))
    axes.set_xticks(range(len(counts)), list(map(str, counts)))
    axes.set_yscale("log")
    ticks = [1, 2, 5, 10, 20, 50]
    axes.set_yticks(ticks, list(map(str, ticks)))
    axes.minorticks_off()
    label_axes(
        axes,
        f"Where was {recording} pressed?",
        "real presses that were learned from",
        "median error [mm], with 95 % interval",
    )
    axes.legend(fontsize=NOTE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    return figure
