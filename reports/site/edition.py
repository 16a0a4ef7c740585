"""What the site shows: one version of the leaderboard, read from records or runs in a folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitbench.benchmark import DataCorruptError, InputError
from eitbench.benchmark.analysis.overall import DataFigures, WinsRow, wins_over_suites
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.few_bytes import with_short_hashes
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.benchmark.submissions.hidden import PublishedKey, published_keys
from eitbench.benchmark.submissions.statement import read_statement
from eitbench.benchmark.submissions.submission import FOLDER as SUBMISSIONS
from eitbench.benchmark.submissions.sums import SUMS, check_sums
from eitbench.benchmark.submissions.tiers import board_of, is_ranked, is_submission
from eitbench.reports.board.changes import (
    VERSION,
    changes,
    in_words,
    last_before,
    reasons,
    version_key,
)
from eitbench.reports.findings.collect import findings
from eitbench.reports.page.report import to_page
from eitbench.reports.page.report_data import (
    BoardData,
    ReportData,
    largest,
    ranking_figures,
    report_of,
)
from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.gaps import run_tier

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.leaderboard import Row
    from eitbench.reports.findings.finding import Finding


@dataclass(frozen=True, eq=False)
class SuitePart:
    """The runs of one suite.

    Attributes:
        name: of the suite.
        runs: as they were read, the files of each in its `path`.
        report: what a report of them shows.
        found: the findings of the report.
        self_reported: the submissions that are not ranked, see `is_ranked`; None without any.
    """

    name: str
    runs: Sequence[Run]
    report: ReportData
    found: Sequence[Finding]
    self_reported: SuitePart | None = None

    @property
    def parts(self) -> list[SuitePart]:
        """What is ranked, and what is self-reported if there is anything."""
        return [self] if self.self_reported is None else [self, self.self_reported]

    @property
    def has_submissions(self) -> bool:
        """True if a run is a submission, ranked or not."""
        return any(is_submission(run.path) for part in self.parts for run in part.runs)

    def run(self, name: str) -> Run:
        """The run of a name."""
        return next(run for run in self.runs if run.path.name == name)

    @property
    def title(self) -> str:
        """Its title, as the first run has it; its name where it has none."""
        return printable(str(self._declared.get("title") or self.name))

    @property
    def description(self) -> str:
        """What it is for, in a few sentences."""
        return printable(" ".join(str(self._declared.get("description", "")).split()))

    @property
    def recordings(self) -> set[str]:
        """Names of the recorded sets that its scenarios use."""
        used: set[str] = set()
        for scenario in self._declared["scenarios"]:
            used |= {scenario.get("recording"), *(scenario.get("others") or ())} - {None}
        return used

    @property
    def _declared(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = self.runs[0].manifest["plan"]["suite"]
        return found

    @property
    def version(self) -> str:
        """The version of the leaderboard that its runs are of; "" for runs of a folder."""
        board = board_of(self.runs[0].path)
        return board.name if board and VERSION.fullmatch(board.name) else ""

    @property
    def date(self) -> str:
        """The day on which the newest figures of its record, or of its first run, were made."""
        return max((day for day, _, _ in origins(self.runs[0])), default="")

    @property
    def changed(self) -> list[str]:
        """What differs from the record of the version before, a sentence each."""
        record = self.runs[0].path
        if not VERSION.fullmatch(record.parent.name):
            return []
        older = last_before(record)
        return in_words(changes(older, record), reasons(record.parent)) if older else []

    @cached_property
    def frames(self) -> dict[str, frozenset[str]]:
        """By scenario, the hashes of its test frames, of the first run that has it.

        Other machines make the same frames with other last bits, and so other hashes.
        """
        found: dict[str, frozenset[str]] = {}
        for run in self.runs:
            samples = with_short_hashes(run.samples)
            for scenario, hashes in samples.groupby("scenario")["input_hash"]:
                found.setdefault(str(scenario), frozenset(hashes))
        return found

    @property
    def file(self) -> str:
        """The path of its page, from the front page."""
        return f"suites/{file_name(self.name)}.html"

    @property
    def report_file(self) -> str:
        """The path of its full report, from the front page."""
        return f"reports/{file_name(self.name)}/index.html"

    @property
    def boards(self) -> list[BoardData]:
        """One board for each scenario, that with the most samples."""
        return largest(self.report["boards"])

    @cached_property
    def figures(self) -> dict[str, dict[str, float]]:
        """By scenario and method, the figure that ranks; more is better.

        Of several runs of a method the first counts: a record comes before submissions.
        """
        order = [run.path.name for run in self.runs]
        found: dict[str, dict[str, float]] = {}
        for board in self.boards:
            known = ranking_figures(board)
            rows = sorted(board["views"][0]["rows"], key=lambda row: order.index(row["run"]))
            of = found.setdefault(board["scenario"], {})
            for row in rows:
                if row["label"] in known:
                    of.setdefault(name_of(row), known[row["label"]])
        return found

    def rows(self, method: str) -> list[tuple[BoardData, Row]]:
        """The rows of a method, with their boards."""
        return [
            (board, row)
            for board in self.boards
            for row in board["views"][0]["rows"]
            if name_of(row) == method
        ]


@dataclass(frozen=True, eq=False)
class Edition:
    """One version of the leaderboard.

    Attributes:
        version: such as "2026.1"; "" for runs in a folder.
        suites: by name.
        left_out: a sentence for each run that could not be read.
        keys: of its hidden sets.
    """

    version: str
    suites: Sequence[SuitePart]
    left_out: Sequence[str]
    keys: Sequence[PublishedKey]

    @cached_property
    def methods(self) -> list[str]:
        """Names of all methods and operators, also of those that are not ranked."""
        return _names(self.parts)

    @property
    def parts(self) -> list[SuitePart]:
        """What is ranked of each suite, and what is self-reported."""
        return [part for suite in self.suites for part in suite.parts]

    @property
    def ranked(self) -> list[str]:
        """Names of the methods and operators that are ranked on a suite."""
        return _names(self.suites)

    @cached_property
    def wins(self) -> list[WinsRow]:
        """Methods over all suites of methods, every frame counting once."""
        return wins_over_suites(
            DataFigures(
                suite.name, suite.frames[board["scenario"]], suite.figures[board["scenario"]]
            )
            for suite in self.suites
            for board in suite.boards
            if board["kind"] == "method"
        )

    @property
    def frames(self) -> int:
        """Number of test frames of all suites; one that several use counts once."""
        return len(
            frozenset().union(*(of for suite in self.suites for of in suite.frames.values()))
        )


def _names(parts: Iterable[SuitePart]) -> list[str]:
    return sorted({
        name_of(row)
        for part in parts
        for board in part.report["boards"]
        for row in board["views"][0]["rows"]
    })  # fmt: skip


def origins(run: Run) -> list[tuple[str, str, str]]:
    """Day, commit and processor of what made the cells of a run, each once, the oldest first.

    A record may have rows of several runs, and a run may have been resumed.
    """
    keys = run.cells[[run.kind.name, "scenario"]].itertuples(index=False, name=None)
    found = set[tuple[str, str, str]]()
    for name, scenario in keys:
        made = manifest.origin(run.manifest, name, scenario)
        cpu = str(made["machine"].get("cpu") or "")
        found.update((time[:10], commit or "", cpu) for time, commit in manifest.starts(made))
    return sorted(found)


def name_of(row: Row) -> str:
    """The method or operator of a row."""
    return str(row.get("operator") or row["method"])


def method_file(name: str) -> str:
    """The path of the page of a method, from the front page."""
    return f"methods/{file_name(name)}.html"


def editions(folder: Path) -> list[Edition]:
    """Read the versions in a folder of records, the newest first, or the runs of a folder.

    A suite that a version lacks stands in it as in the one before.

    Raises:
        InputError: there is no run directory.
        DataCorruptError: a record of a version cannot be read; other runs are left out.
    """
    versions = [
        path
        for path in folder.glob("2*")
        if VERSION.fullmatch(path.name) and (_runs_in(path) or (path / SUMS).is_file())
    ]
    if not versions:
        return [_edition(folder, "")]
    found: list[Edition] = []
    for path in sorted(versions, key=lambda path: version_key(path.name)):
        edition = _edition(path, path.name)
        found.insert(0, _filled(edition, found[0]) if found else edition)
    return found


def _filled(edition: Edition, older: Edition) -> Edition:
    """An edition with the suites that only the one before it has."""
    own = {suite.name for suite in edition.suites}
    more = [suite for suite in older.suites if suite.name not in own]
    keys = [key for key in older.keys if key.suite not in own]
    suites = sorted([*edition.suites, *more], key=lambda suite: suite.name)
    return replace(edition, suites=suites, keys=[*edition.keys, *keys])


def _runs_in(folder: Path) -> list[Path]:
    """Records or runs of a folder, then submissions, by name."""
    below = ("*", f"{SUBMISSIONS}/*/*")
    found = [
        path.parent
        for where in below
        for path in folder.glob(f"{where}/{manifest.FILE_NAME}")
        if not path.parent.name.startswith(".")  # what a stopped command left
    ]
    return sorted(found, key=lambda path: (is_submission(path), path))


def _edition(folder: Path, version: str) -> Edition:
    if version:
        check_sums(folder)
    paths = _runs_in(folder)
    if not paths:
        raise InputError(
            f"There is no run directory in {folder}: name the folder that holds them, not one of "
            "them."
        )
    by_suite: dict[str, dict[bool, list[SuitePart]]] = {}
    left_out = []
    for path in paths:
        if path.is_symlink():
            left_out.append(f"{path.name} is left out: it is a link")
            continue
        try:
            run = read_run(path)
            suite = str(run.manifest["plan"]["suite"]["name"])
            part = _part(suite, [run])
            to_page(part.report, found=part.found)
            if not all(isinstance(name, str) for name in part.recordings):
                raise ValueError("a scenario names something that is no recording")
            if is_submission(path):
                read_statement(path)
            ranked = is_ranked(run)
        # One run, whatever is wrong with it, does not take the site down.
        except Exception as error:
            reason = printable(str(error) or type(error).__name__)
            if version and not is_submission(path):
                raise DataCorruptError(
                    f"The record {path} cannot be read, take it from git again: {reason}"
                ) from error
            left_out.append(f"{path.name} is left out: {reason}")
            continue
        same = by_suite.setdefault(suite, {True: [], False: []})[ranked]
        if path.name in [other.path.name for known in same for other in known.runs]:
            left_out.append(
                f"{path.name} is left out: suite {suite} has another folder of this name; rename it"
            )
            continue
        same.append(part)
    suites = []
    for suite, of in sorted(by_suite.items()):
        if of[True]:
            self_reported = _joined(of[False]) if of[False] else None
            suites.append(replace(_joined(of[True]), self_reported=self_reported))
            continue
        left_out += [
            f"{part.runs[0].path.name} is left out: it is self-reported, and there is no record of "
            f"suite {suite} that it could stand below"
            for part in of[False]
        ]
    keys = [key for key in published_keys(folder) if key.version == version]
    return Edition(version, suites, left_out, keys)


def _joined(parts: Sequence[SuitePart]) -> SuitePart:
    if len(parts) == 1:
        return parts[0]
    return _part(parts[0].name, [run for part in parts for run in part.runs])


def _part(suite: str, runs: Sequence[Run]) -> SuitePart:
    report = report_of(runs)
    for run, origin in zip(runs, report["runs"], strict=True):
        origin["checked"] = run_tier(run)
    return SuitePart(suite, runs, report, findings(runs))
