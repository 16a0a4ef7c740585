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
    COLOURS,
    COLUMN,
    HEADING,
    NOTE,
    PAGE,
    STYLE,
    new_figure,
    plain_label,
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
    "interval over skins. Without labelled presses, places are registered by a similarity. Methods "
    "that share a letter in a column cannot be told apart (signed-rank test of the skins' median "
    "errors, Holm's correction for all pairs of the column)."
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
    """Write the table over skins, the errors of each skin, and the figure for page and column."""
    import matplotlib as mpl

    curves = over_skins(errors)
    written = [tables / f"{stem}.md", tables / f"{stem}.csv"]
    atomic_write(written[0], to_markdown(curves).encode())
    atomic_write(written[1], csv_text(pd.DataFrame(errors), "%.6g").encode())
    with mpl.rc_context(STYLE):
        written += save(draw(curves), figures / stem, ("png", "pdf", "svg"), dpi=200)
        return written + save(draw(curves, COLUMN), figures / f"{stem}-column", ("pdf",))


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
    return f"{row['median_mm']:.1f}{ends} {row['ties']}".rstrip()


def draw(curves: pd.DataFrame, width: float = PAGE) -> Figure:
    """The error of each method over the number of labelled presses, a panel each, on log axes.

    Bars are 95 % intervals over skins. The other methods are grey behind it, and a dashed line is
    what guessing one place costs. In a column of a paper (`width`), three panels lie side by side.
    """
    methods = list(dict.fromkeys(curves["method"]))
    across = min(5 if width > COLUMN else 3, len(methods))
    down = -(-len(methods) // across)
    figure = new_figure(width, 0.5 + 1.25 * down)
    guess, counts = curves["guess_mm"].median(), sorted(curves["labelled"].unique())
    # 0 has no place on a logarithmic axis: it stands before the others.
    place = {count: count or min((c for c in counts if c), default=10) / 3 for count in counts}
    lines = {
        method: of.sort_values("labelled")
        for method, of in curves.assign(x=curves["labelled"].map(place)).groupby("method")
    }
    panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    for k, axes in enumerate(panels[: len(methods)]):
        for of in lines.values():
            axes.plot(of["x"], of["median_mm"], color="0.85", lw=0.8, marker=".", ms=2, zorder=1)
        of, colour = lines[methods[k]], COLOURS[0]
        axes.vlines(of["x"], of["low_mm"], of["high_mm"], color=colour, lw=1.2, zorder=2)
        axes.plot(of["x"], of["median_mm"], color=colour, lw=1.2, marker="o", ms=3.5, zorder=3)
        axes.axhline(guess, color="black", ls="--", lw=0.7, zorder=1)
        axes.set_title(plain_label(methods[k]), fontsize=NOTE if width > COLUMN else 5.5)
        axes.tick_params(labelsize=NOTE - 1, labelbottom=k + across >= len(methods))
    right, above = max(place.values()), 1.04 * guess
    panels[0].text(right, above, "guessing one place", ha="right", va="bottom", fontsize=NOTE - 1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([place[c] for c in counts], list(map(str, counts)))
    least, most = curves["median_mm"].min() / 1.5, 1.7 * max(guess, curves["median_mm"].max())
    axes.set_ylim(least, most)
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50) if least < tick < most]
    axes.set_yticks(ticks, list(map(str, ticks)))
    for axes in panels:
        axes.minorticks_off()
    for axes in panels[len(methods) :]:
        axes.set_visible(False)
    figure.supxlabel("labelled presses of the skin", fontsize=HEADING)
    figure.supylabel("error of the place [mm]", fontsize=HEADING)
    return figure
