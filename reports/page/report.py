"""The comparison report: one HTML page that needs nothing else, and the files for a paper."""

from __future__ import annotations

import json
import os
import re
import time
import warnings
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

import joblib
from markupsafe import Markup

from eitbench import __version__
from eitbench.benchmark import EitbenchError, InputError, atomic_write, worker_pool, writing
from eitbench.benchmark.analysis.results import Run, plugin_copies, read_run
from eitbench.benchmark.metrics.specs import ANCHORS
from eitbench.benchmark.rundir.manifest import FILE_NAME
from eitbench.reports.figures.style import COLOURS, CONDUCTIVITY_MAP, CONTRAST_MAP, STYLE, to_png
from eitbench.reports.findings.collect import findings
from eitbench.reports.findings.finding import Finding
from eitbench.reports.page.answer import MOST_ANSWERS, answer, summary
from eitbench.reports.page.images import FEW_STEPS, pack
from eitbench.reports.page.paper import board_maps, overall_figure, write_paper
from eitbench.reports.page.rendering import asset, render
from eitbench.reports.page.report_data import (
    FAST_MS,
    MOST_SINGLE,
    BoardData,
    ReportData,
    counted_data,
    largest,
    report_of,
)
from eitbench.reports.tables.boards import PrintedBoard
from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.references import reference

PAGE = "index.html"
MANY_SAMPLES = 20_000
"""Rows of samples of which the report is made by two processes: to start them takes seconds."""
_MAP_STEPS = 256


def write_report(runs: Sequence[Path], out: Path) -> tuple[list[Path], list[str]]:
    """Write the report of run directories into `out`: the page, and files for a paper.

    A page that is there stays until the new one is ready.

    Returns:
        The files, the page first; and what the runs lack, a sentence each, as on the page.

    Raises:
        InputError, DataCorruptError: as for `read_run` and `report_of`, `out` is a run directory,
            or there are files of somebody else in it.
        EitbenchError: the files cannot be written.
    """
    read = [read_run(run) for run in runs]
    if (out / FILE_NAME).exists():
        raise InputError(
            f"{out} is a run directory, which holds what a run writes alone: choose another folder "
            "with --out."
        )
    check_own_folder(out)
    new_folder, new_page = not out.exists(), not (out / PAGE).exists()
    if new_page:  # so that the folder is ours if this is interrupted
        with writing(f"the report into {out}"):
            atomic_write(out / PAGE, _NOT_FINISHED.encode())
    try:
        report, found, files = _both_parts(read, out)
    except EitbenchError:
        if new_page and [*out.iterdir()] == [out / PAGE]:  # other files stay ours by it
            (out / PAGE).unlink()
            if new_folder:
                out.rmdir()
        raise
    with writing(f"the report into {out}"):
        page = to_page(report, _code_links(read, out), found)
        atomic_write(out / PAGE, page.encode())
    return [out / PAGE, *files], report["missing"]


def check_own_folder(out: Path, besides: Collection[str] = ()) -> None:
    """Check that no file of somebody else would be replaced in the folder `out`.

    It is new or empty, but for hidden files and those named `besides`, or it has a page of ours.

    Raises:
        InputError: it has files of others.
        EitbenchError: what is there cannot be read.
    """
    page = out / PAGE
    with writing(out):
        there = page.read_bytes()[:2000] if page.exists() else None
        names = sorted(path.name for path in out.iterdir()) if out.exists() else []
    if there is not None and not _OWN_TITLE.search(there):
        raise InputError(f"{page} is no page of eitbench: choose another folder with --out.")
    others = [name for name in names if name not in besides and not name.startswith(".")]
    if there is None and others:
        raise InputError(
            f"{out} holds files of others, such as {others[0]}: choose an empty folder with --out."
        )


_NOT_FINISHED = "<!doctype html><title>Not finished – eitbench</title>"
_OWN_TITLE = re.compile("<title>[^<]*– eitbench".encode())


def _both_parts(runs: Sequence[Run], out: Path) -> tuple[ReportData, list[Finding], list[Path]]:
    """Return what a report shows, the findings of `runs`, and the files of both, in `out`.

    Findings with their figures take almost half of the time: of many samples another process makes
    them, if it can.
    """
    if sum(len(run.samples) for run in runs) <= MANY_SAMPLES:
        report, files = _written_report(runs, out)
        found, more = _written_findings(runs, out)
        return report, found, files + more
    with warnings.catch_warnings():
        # Of an error here, joblib would say that the other process was not waited for.
        warnings.filterwarnings("ignore", "[0-9]+ tasks which were still being processed")
        pool = worker_pool(2, return_as="generator")
        beside = pool([joblib.delayed(_written_findings)(runs, out)])
        try:
            report, files = _written_report(runs, out)
            ((found, more),) = beside
        except BrokenProcessPool:  # killed, as by a lack of memory for two
            found, more = _written_findings(runs, out)
        finally:
            beside.close()
    return report, found, files + more


def _written_report(runs: Sequence[Run], out: Path) -> tuple[ReportData, list[Path]]:
    """Return what a report of `runs` shows, and its files for a paper, written into `out`."""
    report = report_of(runs)
    with writing(f"the report into {out}"):
        return report, write_paper(report, out)


def _written_findings(runs: Sequence[Run], out: Path) -> tuple[list[Finding], list[Path]]:
    """Write the findings of `runs` into `out`; return them, and the files."""
    found = findings(runs)
    with writing(f"the report into {out}"):
        files = [file for one in found for file in one.write(out / "tables", out / "figures")]
    return found, files


def _code_links(runs: Sequence[Run], out: Path) -> dict[str, str]:
    """Return addresses of the plugins' copies in run directories, seen from `out`, by `code`."""
    links = {}
    for run in runs:
        for copy in plugin_copies(run):
            with suppress(ValueError):  # on another drive there is no way from there
                way = Path(os.path.relpath(run.path / copy, out))
                links[f"{copy} in the run {run.path.name}"] = quote(way.as_posix())
    return links


def to_page(
    report: ReportData,
    code_links: Mapping[str, str] = MappingProxyType({}),
    found: Sequence[Finding] = (),
) -> str:
    """Return the HTML page of a report.

    Args:
        code_links: addresses of the files that `code` of a row names.
        found: what the runs show besides their leaderboards.
    """
    methods = _methods(report)
    suites = dict.fromkeys(board["suite"] for board in report["boards"])
    read_by_script = {
        "boards": [_for_script(board) for board in report["boards"]],
        "overall": report["overall"],
        "fast_ms": FAST_MS,
        "most_single": MOST_SINGLE,
        "methods": [method["name"] for method in methods],
        "maps": _colour_maps(),
        "colours": COLOURS,
    }
    return render(
        "report.html.jinja",
        **report,
        title=" and ".join(map(printable, suites)) or "No results",
        made=time.strftime("%Y-%m-%d"),
        version=__version__,
        findings=found,
        answers=[answer(board, report["boards"]) for board in report["boards"]],
        summary=summary(largest(report["boards"])),
        most_answers=MOST_ANSWERS,
        methods=methods,
        counted_data=counted_data(report["boards"]),
        code_links=code_links,
        image_steps=FEW_STEPS,
        fewer_families=_fewer_families(report),
        critical_difference=_critical_difference(report),
        board_maps=_board_maps(report),
        fast_ms=FAST_MS,
        anchors=", ".join(
            f"{name.upper()} {low:g} and {high:g}" for name, (low, high) in ANCHORS.items()
        ),
        css=asset("report.css"),
        js=asset("report.js"),
        plotly=_plotly(),
        data=Markup(_packed(read_by_script)),
    )


_KEPT = (
    *("label", "method", "operator", "track", "training", "anchored", "rank", "weights_won", "n"),
    *("frame_ms_p50", "frame_solves", "forward_ms"),
    *("score", "ssim", "cc", "rie", "psnr", "localisation_mm"),
)  # fmt: skip
"""Figures of rows that the script reads beside those of its columns."""


def _for_script(board: BoardData) -> dict[str, Any]:
    """Return what the script shows of a board."""
    names = {*_KEPT, *(column["name"] for column in board["columns"])}
    names |= {f"{name}_{end}" for name in names for end in ("low", "high")}
    views = []
    for view in board["views"]:
        printed = PrintedBoard("", "", view["rows"])
        columns = printed.columns()
        rows = [
            {name: value for name, value in row.items() if name in names and value is not None}
            | {"best": [of.name for of in columns if printed.is_best(of, row)]}
            for row in view["rows"]
        ]
        views.append(view | {"rows": rows})
    return {**board, "views": views, "maps": None}


def _packed(value: Any) -> str:
    """Return plain data as packed JSON."""
    text = json.dumps(_rounded(value), separators=(",", ":"), allow_nan=False)
    return pack(text.encode())


def _rounded(value: Any) -> Any:
    """Return plain data with numbers of 8 digits: at most 5 are shown.

    With no more than 5 a number could be rounded twice, and differ from that of another table.
    """
    if isinstance(value, dict):
        return {name: _rounded(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return float(f"{value:.8g}") if isinstance(value, float) else value


def _fewer_families(report: ReportData) -> str:
    """Say how many families of a board have images here; "" where all of each board have."""
    counts = [
        (len({case["family"] for case in images["cases"]}), images["families"])
        for board in report["boards"]
        if (images := board["images"]) is not None
    ]
    shown = max((few for few, all_of in counts if few < all_of), default=0)
    most = max((all_of for few, all_of in counts if few < all_of), default=0)
    return f"first {shown} of up to {most} families of each scenario" if shown else ""


def _methods(report: ReportData) -> list[dict[str, Any]]:
    """Return for each method what it was told on the scenarios, its source and its code."""
    found: dict[str, dict[str, Any]] = {}
    of_plugins = {name: text for run in report["runs"] for name, text in run["sources"].items()}
    for board in report["boards"]:
        for row in board["views"][0]["rows"] if board["kind"] == "method" else ():
            source = reference(row["method"]) or of_plugins.get(row["method"], "")
            about = found.setdefault(
                row["label"], {"name": row["label"], "source": source, "code": {}, "told": {}}
            )
            about["code"][row["code"]] = None
            if told := row.get("prior_knowledge"):
                about["told"].setdefault(told, []).append(board["scenario"])
    return list(found.values())


def _critical_difference(report: ReportData) -> str:
    """Return the figure as a `data:` address; "" where there is none."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        return next((to_png(figure) for _, figure in overall_figure(report)), "")


def _board_maps(report: ReportData) -> list[tuple[str, str]]:
    """Return the name of each board with maps of errors, and its figure as a `data:` address."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        return [
            (printable(board["name"]), to_png(board_maps(board)))
            for board in report["boards"]
            if board["maps"] is not None
        ]


@cache
def _plotly() -> Markup:
    """Return Plotly's own bundle, packed to a third of its size, so that nothing is downloaded."""
    return Markup(pack(files("plotly").joinpath("package_data", "plotly.min.js").read_bytes()))


def _colour_maps() -> dict[str, str]:
    """Return the colour maps as hexadecimal digits, six a colour."""
    import matplotlib as mpl
    import numpy as np

    def digits(name: str) -> str:
        colours = mpl.colormaps[name](np.linspace(0, 1, _MAP_STEPS), bytes=True)[:, :3]
        return bytes(colours.ravel()).hex()

    return {"value": digits(CONDUCTIVITY_MAP), "signed": digits(CONTRAST_MAP)}
