"""What real presses are worth: a table and a figure of the errors of `benchmark.real_trained`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from eitbench.benchmark.metrics.statistics import bootstrap_medians
from eitbench.reports.figures.image_grid import HEADING, NOTE, TITLE

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

Row = dict[str, Any]


def summary(errors: pd.DataFrame) -> list[Row]:
    """Median error [mm] with its 95 % interval, and 90th percentile, by estimator and count."""
    rows = []
    for (name, _), group in errors.groupby(["estimator", "presses"], sort=False):
        error = group["error_mm"].to_numpy()
        middle = bootstrap_medians(error[:, None])[0]
        rows.append(
            {
                "estimator": name,
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
    figure = _drawn(rows, recording)
    figure.savefig(stem.with_suffix(".png"), dpi=180)
    figure.savefig(stem.with_suffix(".pdf"), metadata={"CreationDate": None})
    return [folder / "errors.parquet"] + [
        stem.with_suffix(suffix) for suffix in (".json", ".md", ".png", ".pdf")
    ]


def to_markdown(rows: list[Row]) -> str:
    """One row per estimator, one column per count: the median error [mm]."""
    counts = sorted({row["presses"] for row in rows})
    found = {(row["estimator"], row["presses"]): row["median_mm"] for row in rows}
    lines = ["| real presses | " + " | ".join(map(str, counts)) + " |"]
    lines.append("|---|" + "---:|" * len(counts))
    for name in dict.fromkeys(row["estimator"] for row in rows):
        cells = [found.get((name, count)) for count in counts]
        lines.append(f"| {name} | " + " | ".join("–" if c is None else f"{c:.1f}" for c in cells))
        lines[-1] += " |"
    return "\n".join(lines) + "\n"


def _drawn(rows: list[Row], recording: str) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.8), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    counts = sorted({row["presses"] for row in rows})
    for name in dict.fromkeys(row["estimator"] for row in rows):
        of = [row for row in rows if row["estimator"] == name]
        place = [counts.index(row["presses"]) for row in of]
        middle = np.array([row["median_mm"] for row in of])
        ends = np.array([[row["low_mm"], row["high_mm"]] for row in of]).T
        axes.errorbar(place, middle, np.abs(ends - middle), fmt="o-", ms=4, capsize=3, label=name)
    axes.set_xticks(range(len(counts)), list(map(str, counts)))
    axes.set_yscale("log")
    ticks = [1, 2, 5, 10, 20, 50]
    axes.set_yticks(ticks, list(map(str, ticks)))
    axes.minorticks_off()
    axes.set_title(f"Where was {recording} pressed?", fontsize=TITLE, loc="left", weight="bold")
    axes.set_xlabel("real presses that were learned from", fontsize=HEADING)
    axes.set_ylabel("median error [mm], with 95 % interval", fontsize=HEADING)
    axes.tick_params(labelsize=NOTE)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=NOTE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    return figure
