"""A public leaderboard: static pages that work from a disk, and under any address.

The front page shows all suites; every suite, method and recording has a page, and the full report
of each suite lies beside them. Pages but these reports hold no scripts, and nothing is loaded from
elsewhere.
"""

from __future__ import annotations

import html
import json
import shutil
import urllib.parse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import TypeAdapter

from eitbench import __version__
from eitbench.benchmark import InputError, atomic_write, atomic_write_json, with_bar, writing
from eitbench.benchmark.analysis.catalogue import about_method, about_recording, packaged_suites
from eitbench.benchmark.analysis.results import NOTES_FILE, Run, plugin_copies
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.benchmark.rundir.kinds import RUN_KINDS
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.submissions.statement import read_statement
from eitbench.benchmark.submissions.submission import FOLDER as SUBMISSIONS
from eitbench.benchmark.submissions.tiers import is_submission
from eitbench.reports.page.rendering import asset, render
from eitbench.reports.page.report import check_own_folder, to_page
from eitbench.reports.site import images
from eitbench.reports.site.croissant import LICENCE, recording_card, suite_card
from eitbench.reports.site.edition import Edition, SuitePart, editions, method_file, origins
from eitbench.reports.site.pages import (
    MOST_TABLES,
    answers,
    board_table,
    brief_answers,
    chosen_parameters,
    columns_legend,
    failings,
    hidden_keys,
    hidden_table,
    matrix_table,
    overall_table,
    results_table,
    self_reported_table,
    summary_table,
    told,
    training_cost,
)
from eitbench.reports.site.stated import method_stated_table, stated_tables
from eitbench.reports.tables.columns import layout, printable
from eitbench.reports.tables.gaps import run_tier
from eitbench.reports.tables.references import (
    KEYS,
    RECORDINGS,
    SELF,
    entries,
    entry_field,
    reference,
)

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.catalogue import Recording

ARCHIVE = "archive"
FILES = ".files.json"
"""Names of all files of a site, by which the next one in its place deletes those that went."""
_NAMES = TypeAdapter(list[str])
_DOCUMENTATION = "docs/index.html"
_TRUTHS = {
    "position": "the place of each press",
    "classes": "which parts conduct better or worse",
    "none": "none",
}


class WrittenSite(NamedTuple):
    """What `write_site` wrote.

    Attributes:
        pages: the pages, the front page first.
        left_out: a part of a sentence for each run that is not shown, and why.
    """

    pages: list[Path]
    left_out: list[str]


def write_site(folder: Path, out: Path, *, progress: bool = False) -> WrittenSite:
    """Write the site of the records, or of the run directories, in `folder` into `out`.

    `folder` holds versions of the leaderboard, see `reports.board`, or runs. The newest version is
    at the top, those before it under `archive/`; there, the newest one has pages that lead to its
    own, so that addresses with a version last. Files of an earlier site in `out` go. Runs and
    submissions that cannot be read are left out, with a sentence on the front page. With
    `progress`, stderr says how far it is.

    Raises:
        InputError: there is no run directory in `folder`, `out` is that folder or a run, or
            it holds files of somebody else.
        DataCorruptError: a record of the leaderboard cannot be read.
        EitbenchError: the pages cannot be written.
    """
    if out.resolve() == folder.resolve():
        raise InputError(f"{out} holds the runs: give another folder for the site.")
    if (out / manifest.FILE_NAME).exists():
        raise InputError(f"{out} is a run directory: choose another folder for the site.")
    check_own_folder(out, besides=[Path(_DOCUMENTATION).parts[0]])
    found = editions(folder)
    written, files = [], list[str]()
    with writing(f"the site into {out}"):
        for k, edition in enumerate(found):
            place = f"{ARCHIVE}/{edition.version}/" if k else ""
            site = _Site(edition, out, place, found)
            for name, content in site.files(progress=progress):
                atomic_write(out / place / name, content)
                files.append(f"{place}{name}")
                if not name.endswith(".html"):
                    continue
                written.append(out / place / name)
                if edition.version and not place:
                    stub = f"{ARCHIVE}/{edition.version}/{name}"
                    atomic_write(out / stub, _forwarding(name, stub.count("/")))
                    files.append(stub)
            files += [f"{place}{name}" for name in site.copy_records()]
        _clear(out, files)
    return WrittenSite(written, [why for edition in found for why in edition.left_out])


def _forwarding(name: str, depth: int) -> bytes:
    """A page at the lasting address of a page `name` of the newest version, which leads to it.

    Once there is a newer version, the page itself stands there.
    """
    to = html.escape("../" * depth + urllib.parse.quote(name))
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Newest version – eitbench'
        f'</title><meta http-equiv="refresh" content="0; url={to}"><a href="{to}">The page</a>\n'
    ).encode()


def _clear(out: Path, files: Iterable[str]) -> None:
    """Delete what an earlier build wrote into `out` and this one did not, and note its `files`."""
    note, now, before = out / FILES, {*files}, list[str]()
    with suppress(OSError, ValueError):  # the first build, or a damaged note
        before = _NAMES.validate_json(note.read_bytes())
    root = out.resolve()
    for name in {*before} - now:
        path = root / name
        # Whoever gave us the site with its note: nothing outside, and nothing hidden.
        inside = path.parent.resolve() == path.parent and path.is_relative_to(root)
        if inside and not any(part.startswith(".") for part in Path(name).parts):
            with suppress(OSError):  # it is a folder now, or the folder holds more
                path.unlink(missing_ok=True)
                for folder in path.relative_to(root).parents[:-1]:
                    (root / folder).rmdir()
    atomic_write_json(note, sorted(now))


class _Site:
    """The pages of one edition; `place` is its way from the front of the newest one."""

    def __init__(self, edition: Edition, out: Path, place: str, found: Sequence[Edition]) -> None:
        self.edition, self.out, self.place, self.found = edition, out, place, found
        self._top = "../" * place.count("/")
        self._newest = f"{self._top}index.html" if place else ""
        self._docs = self._top + _DOCUMENTATION if (out / _DOCUMENTATION).is_file() else ""
        self._strips: dict[str, bytes] = {}

    def files(self, *, progress: bool) -> Iterator[tuple[str, bytes]]:
        """Yield the name of each file and its content, the front page first."""
        edition = self.edition
        yield "index.html", self._front()
        title = "How to submit a run"
        # The steps are for `quick`, in the newest version that has a record of it.
        to = {suite.name: suite.version for suite in self.found[0].suites}.get("quick", "")
        keys = hidden_keys(edition)
        yield "submit.html", self._page("submit", title, home="", keys=keys, to=to)
        what = f"Pages of suites {edition.version}".rstrip()
        for suite in with_bar(edition.suites, what, len(edition.suites), show=progress):
            yield suite.file, self._suite(suite)
            yield suite.report_file, to_page(suite.report, found=suite.found).encode()
            yield self._card_of(suite), _json(self._suite_card(suite))
        for name in edition.methods:
            yield method_file(name), self._method(name)
            if about := about_method(name):
                yield _code_file(about.module), about.code.encode()
        for name, recording in self.recordings().items():
            yield _recording_file(name), self._recording(recording)
            yield _card_file(name), _json(recording_card(recording))
        # Pages name their pictures, so that these are known when all pages are made.
        yield from self._strips.items()

    def copy_records(self) -> Iterator[str]:
        """Copy manifests and tables of runs, which pages of suites link to; yield their names."""
        for part in self.edition.parts:
            for run in part.runs:
                folder = _folder(part, run)
                (self.out / self.place / folder).mkdir(parents=True, exist_ok=True)
                for name, shown in _kept(run).items():
                    copy = f"{folder}/{shown}"
                    shutil.copyfile(run.path / name, self.out / self.place / copy)
                    yield copy

    def _older(self, suite: SuitePart) -> str:
        """What tells that a suite stands in this version as it was in an older one."""
        return f", from version {suite.version}" if suite.version != self.edition.version else ""

    def recordings(self) -> dict[str, Recording]:
        """The public recorded sets of all suites, by name."""
        names = sorted(set[str]().union(*(suite.recordings for suite in self.edition.suites)))
        return {name: found for name in names if (found := about_recording(name))}

    def _page(self, template: str, title: str, home: str, **values: Any) -> bytes:
        here = values.pop("here", None)
        tabs = [{"name": "Overall", "file": "index.html", "here": here == ""}]
        tabs += [
            {"name": s.name, "file": _quoted(s.file), "here": here == s.name}
            for s in self.edition.suites
        ]
        return render(
            f"site/{template}.html.jinja",
            title=title,
            home=home,
            version=self.edition.version,
            newest=self._newest,
            docs=self._docs,
            tabs=tabs,
            made_by=__version__,
            css=asset("site/site.css"),
            **values,
        ).encode()

    def _front(self) -> bytes:
        edition = self.edition
        several = "s" * (len(edition.suites) != 1)
        lead = (
            "Methods of electrical impedance tomography for touch, compared: "
            f"{len(edition.ranked)} methods on {len(edition.suites)} suite{several} with "
            f"{edition.frames:,} test frames. Every figure is read from a stored run."
        )
        if edition.version and not self._newest:  # older versions had other suites
            known = packaged_suites()
            recorded = sum(suite.name in known for suite in edition.suites)
            lead += f" There is a record of {recorded} of {len(known)} suites."
        suites = [
            {
                "name": suite.name,
                "file": _quoted(suite.file),
                "title": suite.title,
                "size": _size(suite) + self._older(suite),
                "answers": brief_answers(suite),
            }
            for suite in edition.suites
        ]
        return self._page(
            "front",
            "Leaderboard",
            home="",
            here="",
            lead=lead,
            overall=overall_table(edition),
            suites=suites,
            methods=[(printable(name), _quoted(method_file(name))) for name in edition.methods],
            recordings=[(name, _recording_file(name)) for name in self.recordings()],
            versions=[
                (of.version, f"{self._top}{ARCHIVE}/{of.version}/index.html")
                for of in self.found
                if of.version
            ],
            left_out=edition.left_out,
        )

    def _suite(self, suite: SuitePart) -> bytes:
        boards = suite.report["boards"]
        few = len(boards) <= MOST_TABLES
        runs = []
        for run in (run for part in suite.parts for run in part.runs):
            days, commits, processors = (
                dict.fromkeys(of) for of in zip(*origins(run), strict=True)
            )
            code = ", ".join(dict.fromkeys(map(_short, filter(None, commits))))
            about = [
                " to ".join(dict.fromkeys([min(days), max(days)])),
                f"eitbench {run.manifest['versions'].get('eitbench', '')}".strip(),
                f"commit{'s' * (len(commits) > 1)} {code}" if code else "",
                *filter(None, processors),
                run_tier(run),
            ]
            runs.append(
                {
                    "name": printable(run.path.name),
                    "about": printable(", ".join(filter(None, about))),
                    "files": _files(suite, run),
                    "said": read_statement(run.path) if is_submission(run.path) else None,
                }
            )
        return self._page(
            "suite",
            printable(suite.name),
            home="../",
            here=suite.name,
            suite=suite,
            answers=answers(suite),
            older=self._older(suite),
            report=_quoted(f"../{suite.report_file}"),
            above=[of for of in (summary_table(suite), matrix_table(suite)) if of],
            boards=[
                *((board_table(board, suite) for board in boards) if few else ()),
                *filter(None, [self_reported_table(suite), hidden_table(suite)]),
                *stated_tables(suite),
            ],
            legend=columns_legend(suite) if few else "",
            runs=runs,
            licence=LICENCE,
            recordings=[
                (name, f"../{_recording_file(name)}")
                for name in self.recordings()
                if name in suite.recordings
            ],
            card=_quoted(f"../{self._card_of(suite)}"),
            citation=entries()[SELF],
        )

    def _card_of(self, suite: SuitePart) -> str:
        """The path of the card of a suite, beside the table that it describes."""
        return f"{_folder(suite, suite.runs[0])}/croissant.json"

    def _suite_card(self, suite: SuitePart) -> dict[str, Any]:
        run = suite.runs[0]
        table = run.path / SAMPLES
        return suite_card(
            suite.name,
            suite.title,
            suite.description,
            suite.version,
            suite.date,
            table,
            run.samples,
        )

    def _method(self, name: str) -> bytes:
        edition, about = self.edition, about_method(name)
        entry = entries().get(KEYS.get(name, ""), "")
        stated = {
            k: v
            for part in edition.parts
            for run in part.report["runs"]
            for k, v in run["sources"].items()
        }
        wins = next((row for row in edition.wins if row.method == name), None)
        code = [(about.module, f"../{_code_file(about.module)}")] if about else []
        return self._page(
            "method",
            printable(name),
            home="../",
            about=about,
            submissions=[
                {
                    "name": printable(f"{part.name} / {run.path.name}"),
                    "said": read_statement(run.path),
                    "files": _files(part, run),
                }
                for part in edition.parts
                for run in part.runs
                if is_submission(run.path) and name in set(run.cells[run.kind.name])
            ],
            source=printable(reference(name) or stated.get(name, "")),
            doi=entry_field(entry, "doi"),
            code=code,
            wins=wins
            and f"{wins.share:.0%} of its comparisons, on {wins.suites} suites "
            f"({wins.data_sets} data sets)",
            chosen=chosen_parameters(name, edition),
            told=told(name, edition),
            training=training_cost(name, edition),
            stated=method_stated_table(name, edition),
            noise=list(self._noise(name)),
            strips=list(self._images(name)),
            failings=failings(name, edition),
            results=results_table(name, edition),
        )

    def _noise(self, name: str) -> Iterator[tuple[str, str]]:
        for suite in self.edition.suites:
            if drawn := images.over_noise(suite.boards, name):
                file = f"images/{file_name(suite.name)}/{file_name(name)}-noise.svg"
                self._strips[file] = drawn
                yield suite.name, _quoted(f"../{file}")

    def _images(self, name: str) -> Iterator[Mapping[str, Any]]:
        for suite in self.edition.suites:
            shown = (
                (b, found)
                for b, row in suite.rows(name)
                if (found := images.extremes(b, row["label"]))
            )
            board, positions = next(shown, (None, (0, 0)))
            if board is None or board["images"] is None:
                continue
            label = next(row["label"] for b, row in suite.rows(name) if b is board)
            file = f"images/{file_name(suite.name)}/{file_name(name)}.png"
            self._strips[file] = images.strip(board["images"], label, positions)
            height, width = board["images"]["shape"]
            panels = 4 if board["images"]["has_truth"] else 2
            order = "truth and image, best and worst" if panels == 4 else "best and worst"
            by = board["ranked_by"]
            column = layout(board["views"][0]["rows"][0]).column(by)
            reached = [board["images"]["figures"][label][k][by] for k in positions]
            figures = column and f"; {column.title} {' and '.join(map(column.number, reached))}"
            yield {
                "file": _quoted(f"../{file}"),
                "width": panels * width + (panels - 1) * images.GAP,
                "height": height,
                "alt": f"Images of {printable(name)} on {board['scenario']}: {order}",
                "caption": printable(f"{suite.name} / {board['scenario']}: {order}{figures or ''}"),
            }

    def _recording(self, recording: Recording) -> bytes:
        entry = entries().get(RECORDINGS.get(recording.name, ""), "")
        suites = [
            (suite.name, _quoted(f"../{suite.file}"))
            for suite in self.edition.suites
            if recording.name in suite.recordings
        ]
        return self._page(
            "recording",
            recording.name,
            home="../",
            of=recording,
            truth=_TRUTHS[recording.truth],
            doi=entry_field(entry, "doi"),
            suites=suites,
            card=f"../{_card_file(recording.name)}",
        )


def _size(suite: SuitePart) -> str:
    boards = suite.boards
    rows = {row["label"] for board in boards for row in board["views"][0]["rows"]}
    scenarios = "1 scenario" if len(boards) == 1 else f"{len(boards)} scenarios"
    frames = sum(board["n"] for board in boards)
    return f"{scenarios}, {len(rows)} methods, {frames:,} frames, run until {suite.date}"


def _short(commit: str) -> str:
    """A commit as a reader copies it, and whether the code was changed since."""
    return commit[:10] + "-dirty" * commit.endswith("-dirty")


def _json(value: Mapping[str, Any]) -> bytes:
    return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()


def _quoted(path: str) -> str:
    """A path as an address: what is quoted in a file's name is quoted once more."""
    return path.replace("%", "%25")


def _code_file(module: str) -> str:
    # A browser shows text, and downloads what it takes for a program.
    return f"code/{module}.txt"


def _recording_file(name: str) -> str:
    return f"data/{file_name(name)}.html"


def _card_file(name: str) -> str:
    return f"data/{file_name(name)}.croissant.json"


def _folder(suite: SuitePart, run: Run) -> str:
    """The folder of the files of a run, from the front page; no two runs of an edition share it."""
    kind = SUBMISSIONS if is_submission(run.path) else "records"
    return f"{kind}/{file_name(suite.name)}/{file_name(run.path.name)}"


def _files(suite: SuitePart, run: Run) -> list[tuple[str, str]]:
    """The names of the files of a run, and their addresses from a page of a suite or a method."""
    folder = _folder(suite, run)
    return [(name, _quoted(f"../{folder}/{shown}")) for name, shown in _kept(run).items()]


def _kept(run: Run) -> dict[str, str]:
    """The files of a run that the site holds, with their names there."""
    names = (manifest.FILE_NAME, SAMPLES, *(kind.table for kind in RUN_KINDS.values()), NOTES_FILE)
    kept = {name: name for name in names if (run.path / name).is_file()}
    return kept | {copy: f"{Path(copy).name}.txt" for copy in plugin_copies(run)}
