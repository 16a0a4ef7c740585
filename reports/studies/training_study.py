"""The table and the figure of a study of trainings, from its stored rows."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import numpy as np
import pandas as pd

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import read_json, read_table
from eitbench.benchmark.metrics.statistics import bootstrap, seed_means
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.studies.training_study import METRICS
from eitbench.reports.figures.style import NOTE, label_axes, new_figure, save
from eitbench.reports.studies.summaries import StudyRow, StudySummary
from eitbench.reports.tables.formats import markdown_table
from eitbench.reports.tables.published import BETA, BETA_OF_MEANS

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write_study(folder: Path) -> list[Path]:
    """Write `summary.json`, `summary.md`, `study.png` and `study.pdf` of the study in `folder`.

    Raises:
        InputError: it holds no finished study.
    """
    if not (folder / SAMPLES).is_file():
        raise InputError(f"{folder} holds no finished study: run `eitbench study` with --out.")
    options = read_json(folder / "study.json")
    table = read_table(folder / SAMPLES)
    hours = float(table.groupby(_choices(table))["train_s"].first().sum()) / 3600
    rows = STUDIES[options["study"]][0](table)
    if not rows:
        raise InputError(
            f"{folder} holds no two trainings to compare: those of all seeds diverged."
        )
    summary = cast("StudySummary", options | {"training_hours": round(hours, 2), "rows": rows})
    written = [folder / "summary.json", folder / "summary.md"]
    written[0].write_text(json.dumps(summary, indent=1) + "\n")
    written[1].write_text(to_markdown(summary))
    return written + save(draw(summary), folder / "study")


def draw(summary: StudySummary) -> Figure:
    """Draw the figure of a study."""
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    STUDIES[summary["study"]][1](axes, summary)
    axes.legend(fontsize=NOTE, frameon=False)
    return figure


def to_markdown(summary: StudySummary) -> str:
    """The rows as a table, below the options and the hours of the study."""
    heads = list(dict.fromkeys(head for row in summary["rows"] for head in row))
    # A training that diverged has no figures.
    rows = [[_text(row.get(head, "–")) for head in heads] for row in summary["rows"]]
    options = (
        f"suite {summary['suite']}, epochs {summary['epochs']}, limit {summary['limit']}, "
        f"scored {summary['scored']}, operator {summary['operator']}"
    )
    table = markdown_table(heads, rows, [False] * len(heads))
    title = f"### Study {summary['study']}"
    return "\n".join([title, "", f"{options}; {summary['training_hours']} h", "", *table]) + "\n"


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _choices(table: pd.DataFrame) -> list[str]:
    known = {"scenario", "sample", "cluster", "train_s", *METRICS}
    return [str(name) for name in table.columns if name not in known]


def _means(table: pd.DataFrame) -> list[StudyRow]:
    """Return mean metrics of every choice, and the interval of S over samples."""
    rows = []
    for choice, group in table.groupby(_choices(table)):
        row = dict(zip(_choices(table), choice, strict=True))
        if group["score"].notna().all():
            row |= {name: float(group[name].mean()) for name in METRICS}
            (interval,) = bootstrap(group[["score"]], group["cluster"])
            row |= {"score_low": interval.low, "score_high": interval.high}
            row |= {"n": len(group), "train_s": float(group["train_s"].iloc[0])}
        rows.append(row)
    return rows


def _differences(table: pd.DataFrame) -> list[StudyRow]:
    """Return differences to the training without physics, paired by seed and sample.

    Seeds of which a training diverged are left out.
    """
    rows = []
    choices, table = table["physics"].nunique(), table[table["scenario"] != ""]
    table = table[table.groupby("seed")["physics"].transform("nunique") == choices]
    for scenario, group in table.groupby("scenario", sort=False):
        arrays = {
            str(physics): np.stack(
                [seed.sort_values("sample")[list(METRICS)] for _, seed in of_one.groupby("seed")]
            )
            for physics, of_one in group.groupby("physics")
        }
        for physics, values in arrays.items():
            if physics == "none":
                continue
            difference = values - arrays["none"]
            for k, interval in enumerate(seed_means(difference)):
                row = {"scenario": scenario, "physics": physics, "metric": METRICS[k]}
                row |= {"without": float(arrays["none"][..., k].mean())}
                row |= {"difference": interval.value, "low": interval.low, "high": interval.high}
                each_seed = difference[..., k].mean(axis=1).tolist()
                rows.append(row | {"each_seed": each_seed, "n": values.shape[1]})
    return rows


def _draw_beta(axes: Axes, summary: StudySummary) -> None:
    rows = pd.DataFrame(summary["rows"]).dropna(subset="score")
    axes.fill_between(
        rows["beta"], rows["score_low"], rows["score_high"], color="C0", alpha=0.2, lw=0,
        label="95 % over samples",
    )  # fmt: skip
    axes.plot(rows["beta"], rows["score"], "o-", color="C0", ms=3, lw=1)
    axes.axvline(BETA, color="0.4", lw=1, ls="--", label="published best, of means")
    axes.axvline(BETA_OF_MEANS, color="0.4", lw=1, ls=":", label="published best, if of sums")
    axes.set_xscale("log")
    label_axes(axes, "Weight of the physical loss", "beta", "mean score S")


def _draw_physics(axes: Axes, summary: StudySummary) -> None:
    rows = pd.DataFrame(summary["rows"]).query("metric == 'psnr'")
    for k, (physics, of) in enumerate(rows.groupby("physics", sort=False)):
        place, mean = np.arange(len(of)) + 0.2 * k - 0.1, of["difference"].to_numpy()
        ends = np.abs(of[["low", "high"]].to_numpy().T - mean)
        axes.errorbar(place, mean, ends, fmt="o", ms=4, capsize=3, label=str(physics))
        axes.plot(place, of["each_seed"].tolist(), "_", color="0.5", ms=6)
    axes.axhline(0, color="0.4", lw=1)
    scenarios = rows["scenario"].unique()
    axes.set_xticks(range(len(scenarios)), scenarios, rotation=20, ha="right")
    label_axes(axes, "What the physical loss adds to the data loss", "", "PSNR difference [dB]")


def _draw_supervision(axes: Axes, summary: StudySummary) -> None:
    rows = pd.DataFrame(summary["rows"]).dropna(subset="psnr")
    for alpha, of in rows.groupby("alpha", sort=False):
        label = "voltages alone" if alpha == 0 else "true images and voltages"
        axes.plot(of["seed"], of["psnr"], "o", ms=5, label=f"alpha = {alpha:g}: {label}")
    axes.set_xticks(sorted(rows["seed"].unique()))
    label_axes(axes, "What true images are worth in training", "seed", "PSNR [dB]")


def _draw_size(axes: Axes, summary: StudySummary) -> None:
    rows = pd.DataFrame(summary["rows"])
    for backbone, of in rows.dropna(subset="psnr").groupby("backbone", sort=False):
        axes.plot(of["samples"], of["psnr"], "o-", ms=4, label=str(backbone))
    axes.set_xscale("log")
    samples = sorted(rows["samples"].unique())
    axes.set_xticks(samples, list(map(str, samples)))
    axes.minorticks_off()
    label_axes(axes, "Data and size of the network", "training samples", "PSNR [dB]")


Summarise = Callable[[pd.DataFrame], list[StudyRow]]
Draw = Callable[["Axes", StudySummary], None]
STUDIES: dict[str, tuple[Summarise, Draw]] = {
    "beta": (_means, _draw_beta),
    "physics": (_differences, _draw_physics),
    "size": (_means, _draw_size),
    "supervision": (_means, _draw_supervision),
}
