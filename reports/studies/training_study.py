"""What a study found: tables and one figure, from its stored rows."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import read_json, read_table
from eitbench.benchmark.metrics.statistics import bootstrap_means, nested_bootstrap_means
from eitbench.benchmark.studies.training_study import METRICS, SAMPLES
from eitbench.reports.figures.image_grid import HEADING, NOTE, TITLE
from eitbench.reports.tables.published import BETA

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = dict[str, Any]

_TITLES = {"ssim": "SSIM", "cc": "CC", "rie": "RIE", "psnr": "PSNR [dB]", "score": "S"}


def write_study(folder: Path) -> list[Path]:
    """Write `summary.json`, `summary.md`, `study.png` and `study.pdf` of the study in `folder`.

    Raises:
        InputError: it holds no finished study.
    """
    if not (folder / SAMPLES).is_file():
        raise InputError(f"{folder} holds no finished study: run `eitbench study` with --out.")
    asked = read_json(folder / "study.json")
    table = read_table(folder / SAMPLES)
    name = asked["study"]
    cost_h = float(table.groupby(_choices(table))["train_s"].first().sum()) / 3600
    summary = {**asked, "training_hours": round(cost_h, 2), "rows": SUMMARIES[name](table)}
    written = [folder / "summary.json", folder / "summary.md"]
    written[0].write_text(json.dumps(summary, indent=1) + "\n")
    written[1].write_text(to_markdown(summary))
    figure = draw(summary)
    for suffix in ("png", "pdf"):
        path = folder / f"study.{suffix}"
        figure.savefig(path, dpi=180, metadata={"CreationDate": None} if suffix == "pdf" else {})
        written.append(path)
    return written


def draw(summary: Row) -> Figure:
    """The figure of a study."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    DRAWINGS[summary["study"]](figure.subplots(), summary)
    return figure


def to_markdown(summary: Row) -> str:
    """The rows as a table, under what was asked and what it cost."""
    rows = summary["rows"]
    asked = ", ".join(
        f"{key} {summary[key]}" for key in ("suite", "epochs", "limit", "scored", "operator")
    )
    lines = [
        f"### Study {summary['study']}",
        "",
        f"{asked}; {summary['training_hours']} h",
        "",
    ]
    lines.append("| " + " | ".join(rows[0]) + " |")
    lines.append("|" + " --- |" * len(rows[0]))
    lines += ["| " + " | ".join(map(_text, row.values())) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _choices(table: pd.DataFrame) -> list[str]:
    known = {"scenario", "sample", "train_s", *METRICS}
    return [str(name) for name in table.columns if name not in known]


def _means(table: pd.DataFrame) -> list[Row]:
    """Mean metrics of every choice, and the interval of S over samples."""
    rows = []
    for choice, group in table.groupby(_choices(table)):
        row = dict(zip(_choices(table), choice, strict=True))
        if group["score"].notna().all():
            row |= {name: float(group[name].mean()) for name in METRICS}
            (interval,) = bootstrap_means(group[["score"]])
            row |= {"score_low": interval.low, "score_high": interval.high}
            row |= {"n": len(group), "train_s": float(group["train_s"].iloc[0])}
        rows.append(row)
    return rows


def _differences(table: pd.DataFrame) -> list[Row]:
    """Paired differences to the training without physics, over seeds and samples."""
    rows = []
    for scenario, group in table.groupby("scenario", sort=False):
        arrays = {
            physics: np.stack([of.sort_values("sample")[list(METRICS)] for _, of in found])
            for physics, found in (
                (str(name), of.groupby("seed")) for name, of in group.groupby("physics")
            )
        }
        for physics, values in arrays.items():
            if physics == "none":
                continue
            difference = values - arrays["none"]
            intervals = nested_bootstrap_means(difference)
            for k, (metric, interval) in enumerate(zip(METRICS, intervals, strict=True)):
                rows.append(
                    {
                        "scenario": scenario,
                        "physics": physics,
                        "metric": metric,
                        "without": float(arrays["none"][..., k].mean()),
                        "difference": interval.value,
                        "low": interval.low,
                        "high": interval.high,
                        "each_seed": [float(d) for d in difference[..., k].mean(axis=1)],
                        "n": values.shape[1],
                    }
                )
    return rows


def _draw_beta(axes: Axes, summary: Row) -> None:
    rows = [row for row in summary["rows"] if "score" in row]
    beta, score, low, high = (
        np.array([row[key] for row in rows]) for key in ("beta", "score", "score_low", "score_high")
    )
    axes.fill_between(beta, low, high, color="C0", alpha=0.2, lw=0, label="95 % over samples")
    axes.plot(beta, score, "o-", color="C0", ms=3, lw=1)
    axes.axvline(BETA, color="0.4", lw=1, ls="--", label="published best")
    axes.set_xscale("log")
    _finish(axes, "Weight of the physical loss", "beta", "mean score S")


def _draw_physics(axes: Axes, summary: Row) -> None:
    rows = [row for row in summary["rows"] if row["metric"] == "psnr"]
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    for k, physics in enumerate(dict.fromkeys(row["physics"] for row in rows)):
        of = [row for row in rows if row["physics"] == physics]
        place = np.arange(len(of)) + 0.2 * k - 0.1
        mean = np.array([row["difference"] for row in of])
        ends = np.array([[row["low"], row["high"]] for row in of]).T
        axes.errorbar(place, mean, abs(ends - mean), fmt="o", ms=4, capsize=3, label=physics)
        for x, row in zip(place, of, strict=True):
            axes.plot([x] * len(row["each_seed"]), row["each_seed"], "_", color="0.5", ms=6)
    axes.axhline(0, color="0.4", lw=1)
    axes.set_xticks(range(len(scenarios)), scenarios, rotation=20, ha="right")
    _finish(axes, "What the physical loss adds to the data loss", "", "PSNR difference [dB]")


def _draw_size(axes: Axes, summary: Row) -> None:
    for backbone in dict.fromkeys(row["backbone"] for row in summary["rows"]):
        of = [r for r in summary["rows"] if r["backbone"] == backbone and "psnr" in r]
        axes.plot([r["samples"] for r in of], [r["psnr"] for r in of], "o-", ms=4, label=backbone)
    axes.set_xscale("log")
    samples = sorted({row["samples"] for row in summary["rows"]})
    axes.set_xticks(samples, list(map(str, samples)))
    axes.minorticks_off()
    _finish(axes, "Data and size of the network", "training samples", "PSNR [dB]")


def _finish(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=TITLE, loc="left", weight="bold")
    axes.set_xlabel(x, fontsize=HEADING)
    axes.set_ylabel(y, fontsize=HEADING)
    axes.tick_params(labelsize=NOTE)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=NOTE, frameon=False)


SUMMARIES: dict[str, Callable[[pd.DataFrame], list[Row]]] = {
    "beta": _means,
    "physics": _differences,
    "size": _means,
}
DRAWINGS: dict[str, Callable[[Axes, Row], None]] = {
    "beta": _draw_beta,
    "physics": _draw_physics,
    "size": _draw_size,
}
