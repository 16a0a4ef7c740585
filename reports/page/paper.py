"""Files for a paper: tables, vector figures in the widths of IEEE's columns, BibTeX."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eitbench.benchmark import atomic_write
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.reports.figures.critical_difference import critical_difference_figure
from eitbench.reports.figures.error_maps import error_maps_figure
from eitbench.reports.figures.style import (
    COLOURS,
    COLUMN,
    CONDUCTIVITY_MAP,
    CONTRAST_MAP,
    OUTSIDE,
    PAGE,
    STYLE,
    line_style,
    marker,
    new_figure,
    plain_label,
    save,
)
from eitbench.reports.page.bibliography import bibliography
from eitbench.reports.page.images import unpacked
from eitbench.reports.page.report_data import MOST_SINGLE, PAGE_COLUMNS, rows_of
from eitbench.reports.tables.columns import layout, printable
from eitbench.reports.tables.leaderboard import write_leaderboard
from eitbench.reports.tables.references import data_keys

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.leaderboard import Row
    from eitbench.reports.page.report_data import BoardData, ReportData

DEADLINE_MS = 100.0


def write_paper(report: ReportData, out: Path) -> list[Path]:
    """Write `tables/`, `figures/` and `references.bib` of a report into `out`."""
    import matplotlib as mpl

    boards = report["boards"]
    about = {(run["kind"], run["run"]): run for run in report["runs"]}
    rows_by_kind = {
        kind: [
            row
            | {
                "why_not": board["why_not"],
                "cites": data_keys(about[kind, printable(row["run"])], row["scenario"]),
            }
            for board in boards
            if board["kind"] == kind
            for row in rows_of([board])
        ]
        for kind in ("method", "operator")
    }
    written = []
    for rows, stem in zip(rows_by_kind.values(), ("leaderboard", "operators"), strict=True):
        if rows:
            stored = [{k: v for k, v in row.items() if k not in PAGE_COLUMNS} for row in rows]
            written += write_leaderboard(stored, out / "tables", ("csv", "md", "latex"), stem)
    with mpl.rc_context(STYLE):
        figures = [*paper_figures(boards), *overall_figure(report), *suite_maps(report)]
        for stem, figure in figures:
            written += save(figure, out / "figures" / file_name(stem), ("pdf", "svg"))
    references = out / "references.bib"
    atomic_write(references, bibliography(report).encode())
    return [*written, references]


def paper_figures(boards: Sequence[BoardData]) -> Iterator[tuple[str, Figure]]:
    """The figures with the stems of their files."""
    for board in boards if len(boards) <= MOST_SINGLE else ():
        data = re.sub(r"\W+", "-", board["apart"])
        name = "-".join(filter(None, (board["suite"], board["scenario"], data)))
        rows = rows_of([board])
        ranked = layout(rows[0]).column(board["ranked_by"]) is not None
        if ranked and any(row.get("frame_ms_p50") for row in rows):
            yield f"frontier-{name}", frontier(board)
        if board["images"] is not None:
            yield f"comparison-{name}", comparison(board["images"])
        if board["maps"] is not None:
            yield f"maps-{name}", board_maps(board)
    for suite in dict.fromkeys(board["suite"] for board in boards):
        with_noise = [b for b in boards if b["suite"] == suite and b["snr_db"] is not None]
        # Boards of one level differ in something else.
        if len({b["snr_db"] for b in with_noise}) == len(with_noise) > 1:
            yield f"noise-{suite}", noise(with_noise)


def overall_figure(report: ReportData) -> Iterator[tuple[str, Figure]]:
    """The critical-difference figure with the stem of its files, if there is an overall view."""
    if found := report["overall"].get("||"):
        ranks = [(row["method"], row["rank"]) for row in found["rows"]]
        figure = critical_difference_figure(ranks, found["critical_difference"])
        yield "critical-difference", figure


def board_maps(board: BoardData) -> Figure:
    """Where the best methods err, a map each, in a column's width."""
    about = board["maps"]
    assert about is not None
    panels = [("", about, of) for of in about["maps"]]
    return error_maps_figure(panels, COLUMN, len(panels))


def suite_maps(report: ReportData) -> Iterator[tuple[str, Figure]]:
    """Where the best method of each sensor errs, all sensors of a report, in a page's width."""
    panels = [
        (board["scenario"], about, about["maps"][0])
        for board in report["boards"]
        if (about := board["maps"]) is not None
    ]
    if len(panels) > 1:
        yield "maps", error_maps_figure(panels, PAGE, 5)


def _blank(width: float, height: float) -> tuple[Figure, Axes]:
    figure = new_figure(width, height)
    axes = figure.subplots()
    axes.grid(alpha=0.3, lw=0.4)
    axes.set_axisbelow(True)
    return figure, axes


def frontier(board: BoardData) -> Figure:
    """Quality against the time of a frame, in a column's width, a legend beside it."""
    rows = board["views"][0]["rows"]
    by = board["ranked_by"]
    column = layout(rows[0]).column(by)
    assert column is not None
    shown = [row for row in rows if row[by] is not None and row["frame_ms_p50"]]
    figure, axes = _blank(COLUMN, 2.3 + 0.08 * len(shown))
    front = fastest_for_quality(
        [(row["frame_ms_p50"], -row[by] if column.best == "max" else row[by]) for row in shown]
    )
    axes.plot(
        [shown[k]["frame_ms_p50"] for k in front], [shown[k][by] for k in front],
        drawstyle="steps-post", color="0.35", lw=0.9, zorder=1,
        label="no method beats these in both",
    )  # fmt: skip
    for k, row in enumerate(shown):
        ends = [row[f"{by}_{end}"] for end in ("low", "high")]
        error = None if None in ends else np.abs(np.array(ends) - row[by])[:, None]
        axes.errorbar(
            row["frame_ms_p50"], row[by], error, fmt=marker(k), ms=4.5,
            color=COLOURS[k % len(COLOURS)], lw=0.7, capsize=1.5, mec="black", mew=0.3,
            label=plain_label(row["label"]),
        )  # fmt: skip
    axes.axvline(DEADLINE_MS, color="0.4", lw=0.7, ls="--", label="10 frames/s")
    axes.set_xscale("log")
    if column.best == "min":
        axes.invert_yaxis()
    axes.set_xlabel("time of a frame [ms]")
    axes.set_ylabel(column.title)
    figure.legend(
        loc="outside lower center", ncols=2, frameon=False, handletextpad=0.3, columnspacing=1
    )
    return figure


def fastest_for_quality(costs: Sequence[tuple[float, float]]) -> list[int]:
    """Return the places of (time, error) that no other beats in both, the fastest first."""
    front: list[int] = []
    for k in sorted(range(len(costs)), key=costs.__getitem__):
        if not front or costs[k][1] < costs[front[-1]][1]:
            front.append(k)
    return front


_ACROSS = 4
_FEWEST_PT = 6.5  # at the width of a column, which is that of the figure


def comparison(images: Mapping[str, Any]) -> Figure:
    """One sample by all methods, four images a row, in a column's width.

    The sample is the median one of the first family. Without a truth, images show contrast.

    Args:
        images: those of `packed_images`.
    """
    case = next(case for case in images["cases"] if case["kind"] == "median")
    values = unpacked(images)[:, images["samples"].index(case["sample"])]
    x0, y0, x1, y1 = (1e3 * end for end in images["bounds"])
    shift = 0.0 if images["has_truth"] else images["background"]
    down = -(-len(values) // _ACROSS)
    tile = 0.78 * (y1 - y0) / (x1 - x0)
    figure = new_figure(COLUMN, down * (tile + 0.2) + 0.55)
    axes = figure.subplots(down, _ACROSS, squeeze=False)
    for place in axes.flat:
        place.set(xticks=[], yticks=[], facecolor="none")
        place.spines[:].set_visible(False)
    for place, name, image in zip(axes.flat, images["names"], values, strict=False):
        shown = place.imshow(
            image - shift, origin="lower", extent=(x0, x1, y0, y1), interpolation="nearest",
            cmap=CONDUCTIVITY_MAP if images["has_truth"] else CONTRAST_MAP,
            vmin=images["low"] - shift, vmax=images["high"] - shift,
        )  # fmt: skip
        place.set_facecolor("none" if images["has_truth"] else OUTSIDE)
        title = "\n".join(textwrap.wrap(plain_label(name), 15, max_lines=2, placeholder="…"))
        place.set_title(title, fontsize=_FEWEST_PT, pad=2)
    scale = figure.colorbar(shown, ax=axes, location="bottom", shrink=0.6, aspect=35, pad=0.02)
    scale.ax.tick_params(labelsize=_FEWEST_PT, length=2)
    what = "conductivity" if images["has_truth"] else "contrast"
    of = ", ".join(filter(None, (case["family"], f"sample {case['sample']}")))
    scale.set_label(f"{what} [S/m] ({plain_label(of)})", fontsize=_FEWEST_PT)
    return figure


def noise(boards: Sequence[BoardData]) -> Figure:
    """S of every method against SNR with bands, in the width of a page."""

    def level(board: BoardData) -> float:
        snr_db = board["snr_db"]
        return snr_db if isinstance(snr_db, float) else float("inf")

    ordered = sorted(boards, key=level)
    labels = ["clean" if b["snr_db"] == "clean" else f"{b['snr_db']:g}{_touch(b)}" for b in ordered]
    names = dict.fromkeys(row["label"] for row in rows_of(ordered))
    figure, axes = _blank(PAGE, 3.2)
    for k, name in enumerate(names):
        rows: list[Row] = [
            next((r for r in rows_of([b]) if r["label"] == name), {}) for b in ordered
        ]
        value, low, high = (
            np.array([row.get(f"score{end}") for row in rows], dtype=float)
            for end in ("", "_low", "_high")
        )
        axes.plot(labels, value, **line_style(k), ms=4, lw=1, label=plain_label(name))
        axes.fill_between(labels, low, high, color=COLOURS[k % len(COLOURS)], alpha=0.12, lw=0)
    axes.set_xlabel("SNR of a frame (of what a touch changes in it, median) [dB]")
    axes.set_ylabel("S")
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def _touch(board: BoardData) -> str:
    touch = board["touch_snr_db"]
    return "" if touch is None else f" ({touch:.0f})"
