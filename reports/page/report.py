"""The comparison report: one HTML page that needs nothing else, and the files for a paper."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from eitbench import __version__
from eitbench.benchmark import EitbenchError
from eitbench.benchmark.analysis.ladder import Ladder, read_ladder
from eitbench.benchmark.analysis.leaderboard import is_whole
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.benchmark.metrics.specs import ANCHORS
from eitbench.reports.figures.ladder import LEGEND, grid, to_png, write_files
from eitbench.reports.page.gathered import Gathered, gather
from eitbench.reports.page.images import pack
from eitbench.reports.page.paper import write_paper
from eitbench.reports.tables.columns import layout, printable

PAGE = "index.html"
DATA = "report.json"
_MAP_STEPS = 256
_MOST_NAMES = 3


def write_report(runs: Sequence[Path], out: Path) -> list[Path]:
    """Write the report of run directories into `out`: the page, its data, and files for a paper.

    Raises:
        InputError, DataCorruptError: as for `gather`.
        EitbenchError: the files cannot be written.
    """
    found = gather(runs)
    ladders = _ladders(runs)
    try:
        out.mkdir(parents=True, exist_ok=True)
        written = [out / PAGE, out / DATA]
        written[0].write_text(to_page(found, list(ladders.values())), encoding="utf-8")
        written[1].write_text(json.dumps(found, allow_nan=False) + "\n", encoding="utf-8")
        written += write_paper(found, out)
        for stem, ladder in ladders.items():
            written += write_files(ladder, out / "tables", out / "figures", stem)
    except OSError as error:
        raise EitbenchError(f"Could not write the report into {out}: {error.strerror}.") from error
    return written


def _ladders(runs: Sequence[Path]) -> dict[str, Ladder]:
    """The ladders of run directories, by the stem of their files."""
    read = [(run, read_ladder(read_run(run))) for run in runs]
    found = [(run, ladder) for run, ladder in read if ladder is not None]
    stems = ["ladder" if len(found) == 1 else f"ladder-{run.name}" for run, _ in found]
    return {stem: ladder for stem, (_, ladder) in zip(stems, found, strict=True)}


def to_page(found: Gathered, ladders: Sequence[Ladder] = ()) -> str:
    """The page of what was gathered, and of the ladders from simulation to reality among it."""
    suites = dict.fromkeys(board["suite"] for board in found["boards"])
    shown = {
        key: value
        for key, value in found.items()
        if key not in ("runs", "missing", "cards", "claims")
    }
    return (
        environment()
        .get_template("report.html.jinja")
        .render(
            **found,
            title=" and ".join(map(printable, suites)) or "No results",
            made=time.strftime("%Y-%m-%d"),
            version=__version__,
            ladders=[{"grid": grid(ladder), "figure": to_png(ladder)} for ladder in ladders],
            ladder_legend=LEGEND,
            answers=[answer(board) for board in found["boards"]],
            anchors=", ".join(
                f"{name.upper()} {low:g} and {high:g}" for name, (low, high) in ANCHORS.items()
            ),
            css=Markup(asset("report.css")),
            js=Markup(asset("report.js")),
            plotly=Markup(_plotly()),
            data=Markup(_json(shown | {"maps": _maps()})),
        )
    )


def answer(board: Gathered) -> str:
    """Which method is the best on a board, how surely, and which of its equals is the fastest."""
    rows, kind, by = board["views"][0]["rows"], board["kind"], board["ranked_by"]
    where = f"On {board['suite']} / {board['scenario']} ({board['n']:,} samples)"
    column = next((c for c in layout(rows[0]).columns if c.name == by), None)
    first = rows[0]
    if column is None or first.get(by) is None:
        return printable(f"{where}, no {kind} has a figure to rank by.")
    if not is_whole(first):
        return printable(f"{where}, no {kind} has all samples yet.")
    figure = f"{column.title} {column.number(first[by])}"
    if first.get(f"{by}_low") is None:
        return printable(f"{where}, {first['label']} is first: {figure}.")
    figure += (
        f" (95 %: {column.number(first[f'{by}_low'])} to {column.number(first[f'{by}_high'])})"
    )
    pairs = [pair for pair in board["pairs"] if pair["first"] == 0]
    tied = [rows[pair["second"]] for pair in pairs if pair["p"] >= SIGNIFICANT]
    if not tied:
        return printable(f"{where}, {first['label']} is the best: {figure}. {_lead(board, column)}")
    said = f"{where}, {first['label']} is first with {figure}, but cannot be told apart from "
    said += _listed([row["label"] for row in tied])
    return printable(f"{said}{_fastest(board, [first, *tied])}.")


def _fastest(board: Gathered, rows: Sequence[Any]) -> str:
    """Which of the rows needs the least time for a frame, in what their machines share."""
    shown = {column["name"] for column in board["columns"]}
    unit = {"frame_ms_p50": "ms", "frame_solves": "calibration solves"}
    name = next((name for name in unit if name in shown), None)
    timed = [row for row in rows if name is not None and row[name] is not None]
    if not timed or name is None:
        return ""
    fastest = min(timed, key=lambda row: row[name])
    return f"; the fastest of them is {fastest['label']} ({fastest[name]:.3g} {unit[name]} a frame)"


def _lead(board: Gathered, column: Any) -> str:
    """By how much the first is ahead of the second."""
    rows = board["views"][0]["rows"]
    pair = next((p for p in board["pairs"] if p["first"] == 0), None)
    if pair is None:
        return ""
    p = "p < 0.001" if pair["p"] < 0.001 else f"p = {pair['p']:.3f}"
    low, high = sorted((column.number(abs(pair[end])) for end in ("low", "high")), key=float)
    return (
        f"It is ahead of {rows[pair['second']]['label']} by "
        f"{column.number(abs(pair['difference']))} ({low} to {high}; {p})."
    )


def _listed(names: Sequence[str]) -> str:
    if len(names) > _MOST_NAMES + 1:
        names = [*names[:_MOST_NAMES], f"{len(names) - _MOST_NAMES} others"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def environment() -> Environment:
    """Templates of pages, which show names and texts as they are."""
    return Environment(
        loader=PackageLoader("eitbench.reports.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def asset(name: str) -> str:
    """A file beside the templates."""
    return files("eitbench.reports.page").joinpath("templates", name).read_text(encoding="utf-8")


def _plotly() -> str:
    """Plotly's own bundle, packed: a third of its size, and no request leaves the page."""
    return pack(files("plotly").joinpath("package_data", "plotly.min.js").read_bytes())


def _json(value: Any) -> str:
    """JSON that can stand in a script element: nothing in it can close one."""
    text = json.dumps(value, allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _maps() -> dict[str, str]:
    """The colour maps as hexadecimal digits, six a colour."""
    import matplotlib as mpl
    import numpy as np

    def digits(name: str) -> str:
        colours = mpl.colormaps[name](np.linspace(0, 1, _MAP_STEPS), bytes=True)[:, :3]
        return bytes(colours.ravel()).hex()

    return {"value": digits("viridis"), "signed": digits("coolwarm")}
