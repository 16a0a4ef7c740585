"""A public leaderboard: static pages from many runs, one a suite and one a method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup
from packaging.version import InvalidVersion, Version

from eitbench import __version__
from eitbench.benchmark import EitbenchError, InputError, atomic_write
from eitbench.benchmark.analysis.rerun import digest, verified
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.reports.page.answer import answer
from eitbench.reports.page.rendering import asset, render
from eitbench.reports.page.report import to_page
from eitbench.reports.page.report_data import ReportData, counted_data, report_data, rows_of
from eitbench.reports.tables.columns import layout, printable

SELF_REPORTED = "self-reported"
GUIDE = (
    "Run a whole suite with your method: as it comes with the suite, without --limit.",
    "Check the run: complete, on our data, and with the figures of its images.",
    "Send the run directory as it is. We check it again, and put it among the others. Where we run "
    "the methods again and they make the same images, it is called verified; else its images are "
    "self-reported.",
    "Times are taken on your machine. Those of different machines are compared in calibration "
    "solves, the time that each takes for one fixed solve.",
)


@dataclass(frozen=True)
class Section:
    """A part of a page; what is no markup is escaped."""

    title: str
    sentences: Sequence[str] = ()
    commands: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()


@dataclass(frozen=True)
class _Edition:
    """The runs of one suite made with one version of eitbench.

    Attributes:
        checked: by the name of a run, whether its methods were run again.
    """

    suite: str
    version: str
    report: ReportData
    checked: Mapping[str, str]

    @property
    def file(self) -> str:
        """The path of its page, from the front page."""
        return f"archive/{file_name(self.version)}/{file_name(self.suite)}.html"

    @property
    def age(self) -> tuple[bool, Version]:
        """Increases with the version; releases up to this one come after what is none."""
        try:
            version = Version(self.version)
        except InvalidVersion:
            return False, Version("0")
        released = not version.is_prerelease and version <= Version(__version__)
        return released, version


def write_site(runs: Path, out: Path) -> list[Path]:
    """Write the site of all run directories in the folder `runs` into `out`.

    Every version of eitbench has its pages under `archive/`, and those of the latest are what the
    front page names first. Runs that cannot be read are left out, with a sentence on the front.

    Raises:
        InputError: there is no run directory in `runs`.
        EitbenchError: the pages cannot be written.
    """
    editions, left_out = _editions(runs)
    rows = [row for edition in editions for row in rows_of(edition.report["boards"])]
    methods = sorted({row["method"] for row in rows if "method" in row})
    pages = {"index.html": _front(editions, methods, left_out), "guide.html": _guide()}
    pages |= {edition.file: to_page(edition.report) for edition in editions}
    pages |= {_method_file(name): _method(name, editions) for name in methods}
    written = []
    try:
        for name, text in pages.items():
            path = out / name
            atomic_write(path, text.encode())
            written.append(path)
    except OSError as error:
        raise EitbenchError(f"Could not write the site into {out}: {error.strerror}.") from error
    return written


def _editions(runs: Path) -> tuple[list[_Edition], list[str]]:
    """Return the editions, the newest of each suite first, and reasons for runs left out."""
    paths = sorted(path.parent for path in runs.glob(f"*/{manifest.FILE_NAME}"))
    if not paths:
        raise InputError(f"There is no run directory in {runs}: name the folder that holds them.")
    known = verified(runs)
    paths_of: dict[tuple[str, str], list[Path]] = {}
    left_out = []
    for path in paths:
        if path.is_symlink():
            left_out.append(f"{path.name} is left out: it is a link")
            continue
        try:
            to_page(report_data([path]))
            content = manifest.read(path)
            suite, version = content["plan"]["suite"]["name"], content["versions"]["eitbench"]
        # One run, whatever is wrong with it, does not take the site down.
        except Exception as error:
            left_out.append(f"{path.name} is left out: {error or type(error).__name__}")
            continue
        paths_of.setdefault((str(suite), str(version)), []).append(path)
    editions = []
    for (suite, version), same in paths_of.items():
        told = {path.name: known.get(digest(path)) for path in same}
        checked = {run: f"verified on {n}" if n else SELF_REPORTED for run, n in told.items()}
        report = report_data(same)
        for path, run in zip(same, report["runs"], strict=True):
            run["checked"] = checked[path.name]
        editions.append(_Edition(suite, version, report, checked))
    editions.sort(key=lambda edition: edition.age, reverse=True)
    return sorted(editions, key=lambda edition: edition.suite), left_out


def _method_file(name: str) -> str:
    return f"methods/{file_name(name)}.html"


def _front(editions: Sequence[_Edition], methods: Sequence[str], left_out: Sequence[str]) -> str:
    latest: dict[str, _Edition] = {}
    for edition in editions:
        latest.setdefault(edition.suite, edition)
    boards = [board for edition in latest.values() for board in edition.report["boards"]]
    suites = [
        (_link(e.suite, e.file), " ".join(answer(board, boards) for board in e.report["boards"]))
        for e in latest.values()
    ]
    overall = [
        (_link(e.suite, e.file), printable(row["method"]), _with_ends(row, "rank", ".2f"),
         _with_ends(row, "wins", ".0%"), _with_ends(row, "ratio", ".2f"),
         str(len(e.report["overall"]["||"]["scenarios"])))
        for e in latest.values()
        for row in e.report["overall"].get("||", {"rows": []})["rows"]
    ]  # fmt: skip
    archive = [(e.suite, _link(e.version, e.file), str(len(e.report["runs"]))) for e in editions]
    links = [(_link(printable(name), _method_file(name)),) for name in methods]
    guide = _link("How to submit a run", "guide.html")
    sections = [
        Section("Suites", heads=("Suite", "The answer"), rows=suites),
        Section("Methods", heads=("Method",), rows=links),
        Section("All versions", heads=("Suite", "eitbench", "Runs"), rows=archive),
        Section("Send yours", heads=("",), rows=[(guide,)]),
    ]
    if overall:
        heads = ("Suite", "Method", "Mean rank", "Wins", "Error over a guess's", "Scenarios")
        counted = [
            of
            for e in latest.values()
            if "||" in e.report["overall"] and (of := counted_data(e.report["boards"]))
        ]
        title = "Over all scenarios of a suite"
        sections.insert(1, Section(title, counted, heads=heads, rows=overall))
    if left_out:
        sections.append(Section("Left out", sentences=[printable(reason) for reason in left_out]))
    lead = "Methods of electrical impedance tomography for touch, compared."
    return _page("Leaderboards", lead, sections, home="")


def _with_ends(row: Mapping[str, Any], name: str, form: str) -> str:
    """A figure of `OverallRow` with its 95 % interval, if it has one; "–" where it is not known."""
    if row[name] is None:
        return "–"
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    ends = "" if low is None else f" ({format(low, form)} to {format(high, form)})"
    return format(row[name], form) + ends


def _link(text: str, file: str) -> Markup:
    # What is quoted in a file's name is quoted once more.
    return Markup('<a href="{}">{}</a>').format(quote(file), text)


def _guide() -> str:
    commands = ("eitbench run paper --methods my-method --plugin my_method.py --out runs/mine",
                "eitbench submission check runs/mine")  # fmt: skip
    return _page("How to submit a run", "", [Section("Steps", GUIDE, commands)], home="./")


_HEADS = (
    "Suite", "Scenario", "eitbench", "Date", "Run", "Checked", "Rank", "Ties",
    "Figure", "Coverage", "Command",
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
                    rank = f"{row['rank']} of {len(board['views'][0]['rows'])}"
                    rows += [
                        (
                            _link(edition.suite, f"../{edition.file}"),
                            row["scenario"] + (f" ({board['apart']})" if board["apart"] else ""),
                            edition.version, starts.get(run, ""), run,
                            edition.checked.get(run, SELF_REPORTED), rank,
                            row["group"] or "–", figure, f"{row['coverage']:.1%}", row["command"],
                        )
                        for run in [row["run"], *(row["repeats"] or "").split(", ")]
                        if run
                    ]  # fmt: skip
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
