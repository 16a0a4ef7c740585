"""The transfer question as one table and one figure: the error over labelled presses."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import pandas as pd

from eitbench.benchmark import atomic_write
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.transfer import over_skins, skin_errors
from eitbench.reports.figures.style import (
    NOTE,
    PAGE,
    STYLE,
    label_axes,
    line_style,
    new_figure,
    save,
)
from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.formats import csv_text, escape_markdown, markdown_table

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.transfer import SkinError

LEGEND = (
    "Median over skins of the median distance between a press and its place, in brackets the 95 % "
    "interval over skins. Without labelled presses, places are registered by a similarity."
)


def write_transfer(run: Path) -> list[Path]:
    """Write `transfer.md`, `transfer.csv` and `figures/transfer.{png,pdf,svg}` of a run directory.

    Returns:
        The files; none where no scenario is of the kind "transfer".

    Raises:
        InputError, DataCorruptError: the run cannot be read.
    """
    errors = skin_errors([read_run(run)])
    return write_files(errors, run, run / "figures", "transfer") if errors else []


def write_files(errors: Sequence[SkinError], tables: Path, figures: Path, stem: str) -> list[Path]:
    """Write the table over skins, the errors of each skin, and the figure."""
    import matplotlib as mpl

    curves = over_skins(errors)
    written = [tables / f"{stem}.md", tables / f"{stem}.csv"]
    atomic_write(written[0], to_markdown(curves).encode())
    atomic_write(written[1], csv_text(pd.DataFrame(errors), "%.6g").encode())
    with mpl.rc_context(STYLE):
        return written + save(draw(curves), figures / stem, ("png", "pdf", "svg"), dpi=200)


def to_png(errors: Sequence[SkinError]) -> str:
    """Return the figure as a `data:` address, for a page."""
    import matplotlib as mpl

    content = io.BytesIO()
    with mpl.rc_context(STYLE):
        draw(over_skins(errors)).savefig(content, format="png", dpi=170)
    return f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"


def to_markdown(curves: pd.DataFrame) -> str:
    """Methods by numbers of labelled presses: the error, and its interval in brackets."""
    heads, *rows = ([escape_markdown(text) for text in row] for row in grid(curves))
    return "\n".join([*markdown_table(heads, rows), "", LEGEND, ""])


def grid(curves: pd.DataFrame) -> list[list[str]]:
    """The table as texts, its heads first; the best method of each number first."""
    counts = sorted(curves["labelled"].unique())
    known = {(row["method"], row["labelled"]): row for row in curves.to_dict("records")}
    methods = list(dict.fromkeys(curves["method"]))
    heads = [f"{count} labelled [mm]" for count in counts]
    return [
        ["method", *heads],
        *(
            [printable(method), *(_cell(known.get((method, count))) for count in counts)]
            for method in methods
        ),
    ]


def _cell(row: Mapping[Hashable, Any] | None) -> str:
    if row is None:
        return "–"
    ends = "" if pd.isna(row["low_mm"]) else f" ({row['low_mm']:.1f} to {row['high_mm']:.1f})"
    return f"{row['median_mm']:.1f}{ends}"


def draw(curves: pd.DataFrame) -> Figure:
    """The error of each method over the number of labelled presses, both on log axes."""
    figure = new_figure(PAGE, 4.2)
    axes = figure.subplots()
    counts = sorted(curves["labelled"].unique())
    # 0 has no place on a logarithmic axis: it stands before the others.
    place = {count: count or min((c for c in counts if c), default=10) / 3 for count in counts}
    methods = list(dict.fromkeys(curves["method"]))
    for k, method in enumerate(methods):
        of = curves[curves["method"] == method].sort_values("labelled")
        beside = 1.03 ** (k - (len(methods) - 1) / 2)
        x = of["labelled"].map(place).to_numpy(dtype=float) * beside
        middle = of["median_mm"].to_numpy()
        style = line_style(k)
        axes.plot(x, middle, label=printable(method), **style)
        axes.vlines(x, of["low_mm"], of["high_mm"], color=style["color"], lw=0.8, alpha=0.5)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([place[c] for c in counts], list(map(str, counts)))
    least, most = curves["median_mm"].min() / 2, 1.3 * curves["median_mm"].max()
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50) if least < tick < most]
    axes.set_yticks(ticks, list(map(str, ticks)))
    axes.minorticks_off()
    label_axes(axes, "", "labelled presses of the skin", "error of the place [mm]")
    axes.legend(fontsize=NOTE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    return figure
