"""A public leaderboard: static pages from many runs, one a suite and one a method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from eitbench.benchmark import EitbenchError, InputError
from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.rundir import manifest
from eitbench.reports.page.answer import answer
from eitbench.reports.page.rendering import asset, render
from eitbench.reports.page.report import to_page
from eitbench.reports.page.report_data import ReportData, report_data
from eitbench.reports.tables.columns import layout, printable

GUIDE = (
    "Run a whole suite with your method: as it comes with the suite, without --limit.",
    "Check the run: complete, on our data, and with the figures of its images.",
    "Send the run directory as it is. We check it again, and put it among the others.",
    "Times are taken on your machine. Those of different machines are compared in calibration "
    "solves, the time that each takes for one fixed solve.",
)


@dataclass(frozen=True)
class TableCell:
    """A cell of a table, with a link if `href` is not empty."""

    text: str
    href: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a page."""

    title: str
    sentences: Sequence[str] = ()
    commands: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[TableCell]] = ()


@dataclass(frozen=True)
class _Edition:
    """The runs of one suite made with one version of eitbench."""

    suite: str
    version: str
    report: ReportData

    @property
    def file(self) -> str:
        """The path of its page, from the front page."""
        # A version that is nothing but dots would be another folder.
        version = quote(self.version, safe="").replace(".", "%2E", not self.version.strip("."))
        return f"archive/{version}/{quote(self.suite, safe='')}.html"


def write_site(runs: Path, out: Path) -> list[Path]:
    """Write the site of all run directories in the folder `runs` into `out`.

    Every version of eitbench has its pages under `archive/`, and those of the latest are what the
    front page names first. Runs that cannot be read are left out, with a sentence on the front.

    Raises:
        InputError: there is no run directory in `runs`.
        EitbenchError: the pages cannot be written.
    """
    editions, left_out = _editions(runs)
    methods = sorted(
        {row["method"] for e in editions for row in _rows(e.report) if "method" in row}
    )
    pages = {"index.html": _front(editions, methods, left_out), "guide.html": _guide()}
    pages |= {edition.file: to_page(edition.report) for edition in editions}
    pages |= {_method_file(name): _method(name, editions) for name in methods}
    written = []
    try:
        for name, text in pages.items():
            path = out / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            written.append(path)
    except OSError as error:
        raise EitbenchError(f"Could not write the site into {out}: {error.strerror}.") from error
    return written


def _editions(runs: Path) -> tuple[list[_Edition], list[str]]:
    """Return the editions, the newest of each suite first, and reasons for runs left out."""
    paths = sorted(path.parent for path in runs.glob(f"*/{manifest.FILE_NAME}"))
    if not paths:
        raise InputError(f"There is no run directory in {runs}: name the folder that holds them.")
    paths_of: dict[tuple[str, str], list[Path]] = {}
    left_out = []
    for path in paths:
        try:
            report_data([path])
            content = manifest.read(path)
            suite, version = content["plan"]["suite"]["name"], content["versions"]["eitbench"]
        except (EitbenchError, KeyError, TypeError) as error:
            left_out.append(f"{path.name} is left out: {error}")
            continue
        paths_of.setdefault((str(suite), str(version)), []).append(path)
    ordered = sorted(
        paths_of.items(), key=lambda item: (item[0][0], [-n for n in _parts(item[0][1])])
    )
    editions = [_Edition(suite, version, report_data(same)) for (suite, version), same in ordered]
    return editions, left_out


def _parts(version: str) -> list[int]:
    return [int(part) if part.isdecimal() else 0 for part in version.split(".")]


def _rows(report: ReportData) -> Iterable[Row]:
    return (row for board in report["boards"] for row in board["views"][0]["rows"])


def _method_file(name: str) -> str:
    return f"methods/{quote(name, safe='')}.html"


def _front(editions: Sequence[_Edition], methods: Sequence[str], left_out: Sequence[str]) -> str:
    latest: dict[str, _Edition] = {}
    for edition in editions:
        latest.setdefault(edition.suite, edition)
    # In links, what is quoted in a file's name is quoted once more.
    suites = [
        [
            TableCell(edition.suite, quote(edition.file)),
            TableCell(" ".join(answer(board) for board in edition.report["boards"])),
        ]
        for edition in latest.values()
    ]
    archive = [
        [
            TableCell(e.suite),
            TableCell(e.version, quote(e.file)),
            TableCell(str(len(e.report["runs"]))),
        ]
        for e in editions
    ]
    links = [TableCell(printable(name), quote(_method_file(name))) for name in methods]
    sections = [
        Section("Suites", heads=("Suite", "The answer"), rows=suites),
        Section("Methods", heads=("Method",), rows=[[of] for of in links]),
        Section("All versions", heads=("Suite", "eitbench", "Runs"), rows=archive),
        Section("Send yours", rows=[[TableCell("How to submit a run", "guide.html")]], heads=("",)),
    ]
    if left_out:
        sections.append(Section("Left out", sentences=[printable(reason) for reason in left_out]))
    lead = "Methods of electrical impedance tomography for touch, compared."
    return _page("Leaderboards", lead, sections, home="")


def _guide() -> str:
    commands = ("eitbench run paper --methods my-method --plugin my_method.py --out runs/mine",
                "eitbench submission check runs/mine")  # fmt: skip
    return _page("How to submit a run", "", [Section("Steps", GUIDE, commands)], home="./")


_HEADS = (
    "Suite", "Scenario", "eitbench", "Date", "Run", "Rank", "Ties", "Figure", "Coverage", "Command",
)  # fmt: skip


def _method(name: str, editions: Sequence[_Edition]) -> str:
    rows = []
    for edition in editions:
        starts = {run["run"]: (run["started"] or "")[:10] for run in edition.report["runs"]}
        for board in edition.report["boards"]:
            for row in board["views"][0]["rows"]:
                if row.get("method") == name:
                    column = layout(row).column(row["ranked_by"])
                    figure = "–" if column is None else f"{column.title} {column.whole_text(row)}"
                    rows.append([
                        TableCell(edition.suite, quote(f"../{edition.file}")),
                        TableCell(row["scenario"]),
                        TableCell(edition.version),
                        TableCell(starts.get(row["run"], "")),
                        TableCell(row["run"]),
                        TableCell(f"{row['rank']} of {len(board['views'][0]['rows'])}"),
                        TableCell(row["group"] or "–"),
                        TableCell(figure),
                        TableCell(f"{row['coverage']:.1%}"),
                        TableCell(row["command"]),
                    ])  # fmt: skip
    section = Section("Every result, the newest version first", heads=_HEADS, rows=rows)
    return _page(printable(name), "", [section], home="../")


def _page(title: str, lead: str, sections: Sequence[Section], home: str) -> str:
    return render(
        "site.html.jinja",
        title=title,
        lead=lead,
        sections=sections,
        home=home,
        css=asset("report.css"),
    )
