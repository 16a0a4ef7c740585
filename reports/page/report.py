"""The comparison report: one HTML page that needs nothing else, and the files for a paper."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup

from eitbench import __version__
from eitbench.benchmark import EitbenchError, atomic_write
from eitbench.benchmark.analysis.ladder import Ladder, read_ladder
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.metrics.specs import ANCHORS
from eitbench.reports.figures.ladder import LEGEND, grid, to_png, write_files
from eitbench.reports.figures.style import COLOURS, CONDUCTIVITY_MAP, CONTRAST_MAP
from eitbench.reports.page.answer import answer
from eitbench.reports.page.images import pack
from eitbench.reports.page.paper import write_paper
from eitbench.reports.page.rendering import asset, render
from eitbench.reports.page.report_data import ReportData, report_data
from eitbench.reports.tables.columns import printable

PAGE = "index.html"
DATA = "report.json"
_MAP_STEPS = 256


def write_report(runs: Sequence[Path], out: Path) -> list[Path]:
    """Write the report of run directories into `out`: the page, its data, and files for a paper.

    Raises:
        InputError, DataCorruptError: as for `report_data`.
        EitbenchError: the files cannot be written.
    """
    report = report_data(runs)
    ladders = _ladders(runs)
    try:
        written = [out / PAGE, out / DATA]
        atomic_write(written[0], to_page(report, list(ladders.values())).encode())
        atomic_write(written[1], (json.dumps(report, allow_nan=False) + "\n").encode())
        written += write_paper(report, out)
        for stem, ladder in ladders.items():
            written += write_files(ladder, out / "tables", out / "figures", stem)
    except OSError as error:
        raise EitbenchError(f"Could not write the report into {out}: {error.strerror}.") from error
    return written


def _ladders(runs: Sequence[Path]) -> dict[str, Ladder]:
    """Read the ladders of run directories, by the stem of their files."""
    read = ((run, read_ladder(read_run(run))) for run in runs)
    ladders = {run.name: ladder for run, ladder in read if ladder is not None}
    return {
        "ladder" if len(ladders) == 1 else f"ladder-{name}": ladder
        for name, ladder in ladders.items()
    }


def to_page(report: ReportData, ladders: Sequence[Ladder] = ()) -> str:
    """Return the HTML page of a report, with its ladders from simulation to reality."""
    suites = dict.fromkeys(board["suite"] for board in report["boards"])
    read_by_script = {
        "boards": report["boards"],
        "score_weights": report["score_weights"],
        "maps": _colour_maps(),
        "colours": COLOURS,
    }
    return render(
        "report.html.jinja",
        **report,
        title=" and ".join(map(printable, suites)) or "No results",
        made=time.strftime("%Y-%m-%d"),
        version=__version__,
        ladders=[{"grid": grid(ladder), "figure": to_png(ladder)} for ladder in ladders],
        ladder_legend=LEGEND,
        answers=[answer(board) for board in report["boards"]],
        anchors=", ".join(
            f"{name.upper()} {low:g} and {high:g}" for name, (low, high) in ANCHORS.items()
        ),
        css=asset("report.css"),
        js=asset("report.js"),
        plotly=_plotly(),
        data=_json_in_script(read_by_script),
    )


@cache
def _plotly() -> Markup:
    """Return Plotly's own bundle, packed to a third of its size, so that nothing is downloaded."""
    return Markup(pack(files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()))


def _json_in_script(value: Any) -> Markup:
    """Return JSON that can stand in a script element: nothing in it can close one."""
    text = json.dumps(value, allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _colour_maps() -> dict[str, str]:
    """Return the colour maps as hexadecimal digits, six a colour."""
    import matplotlib as mpl
    import numpy as np

    def digits(name: str) -> str:
        colours = mpl.colormaps[name](np.linspace(0, 1, _MAP_STEPS), bytes=True)[:, :3]
        return bytes(colours.ravel()).hex()

    return {"value": digits(CONDUCTIVITY_MAP), "signed": digits(CONTRAST_MAP)}
