"""Records of the leaderboard: what they are, what they cost, and what is printed of one."""

import io
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd
from docs.tables.record import BOARD, newest_version, printed, recorded
from rich.console import Console

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.metrics import METRICS
from eitbench.benchmark.rundir.manifest import ADDED, commits
from eitbench.benchmark.submissions.hidden import Gap, read_hidden
from eitbench.reports.board.changes import changes, last_before, reasons, version_key
from eitbench.reports.board.records import spent_s
from eitbench.reports.tables.gaps import HEADS, gap_texts
from eitbench.reports.tables.terminal import table

_WIDTH = 120
_SHORT = 7
"""Methods that the README shows."""
_MOST_GAPS = 2
"""Scenarios of a suite whose hidden figures are shown; of more, the one in the middle is."""


def _commit(name: str) -> str:
    """Its first figures, and whether files had changed since."""
    head, _, changed = name.partition("-")
    return f"{head[:8]}-{changed}" if changed else head[:8]


def _minutes(about: dict[str, Any]) -> str:
    """From the beginning to the end of a run; "" where it was not one run with one job."""
    if about["resumed"] or about.get(ADDED) or about["jobs"] != 1:
        return ""
    ends = [datetime.fromisoformat(about[name]) for name in ("started", "finished")]
    return f"{(ends[1] - ends[0]).total_seconds() / 60:.1f}"


def _timed(cells: pd.DataFrame) -> str:
    """How many of all cells have their times: the machine was not busy, and they did not fail."""
    times = [name for name in ("frame_ms_p50", "forward_ms") if name in cells]
    return f"{cells[times].notna().any(axis=1).sum()} of {len(cells)}"


def _records() -> str:
    rows = []
    for version in sorted(BOARD.glob("2*"), key=lambda path: version_key(path.name)):
        whole, hashes = np.zeros(2), set[str]()
        for path in sorted(version.glob("*/manifest.json")):
            run = read_run(path.parent)
            frames = sum(run.n(name) for name in run.scenarios())
            minutes = spent_s(run).sum() / 60
            size = sum(file.stat().st_size for file in path.parent.iterdir()) / 1e6
            whole += minutes, size
            hashes.update(run.samples["input_hash"])
            methods = run.cells[run.kind.name].nunique()
            made = [run.manifest, *run.manifest.get(ADDED, [])]
            rows.append([
                version.name, f"`{path.parent.name}`", str(methods), f"{frames:,}",
                f"{minutes:.1f}", _minutes(run.manifest), _timed(run.cells), f"{size:.1f}",
                ", ".join(dict.fromkeys(str(of["started"])[:10] for of in made)),
                ", ".join(dict.fromkeys(_commit(str(c)) for of in made for c in commits(of))),
            ])  # fmt: skip
        minutes, size = whole
        total = [f"{len(hashes):,}", f"{minutes:.1f}", "", "", f"{size:.1f}"]
        rows.append([version.name, "all", "", *total, "", ""])
    counts = ["methods", "frames", "minutes of methods", "in all", "timed", "MB"]
    heads = ["version", "suite", *counts, "made", "commit"]
    right = [False, False, *[True] * len(counts), False, False]
    return printed(heads, rows, right)


def _changed() -> str:
    """What became of the methods of suites that the version before has, too."""
    rows = []
    for path in sorted(BOARD.glob("2*/*/manifest.json")):
        if (older := last_before(path.parent)) is None:
            continue
        found, why = changes(older, path.parent), reasons(path.parents[1])
        names = [path.parents[1].name, f"`{path.parent.name}`", found.older]
        sure = "to the last bit" if found.exact else "to the rounding of processors"
        for methods, said in (
            (found.kept, f"the same {sure}"),
            (found.taken, f"those of {found.older}"),
        ):
            if methods:
                rows.append([*names, ", ".join(f"`{name}`" for name in methods), said])
        if found.unlike:
            whose = "" if found.kept or found.taken or found.changed else "all"
            others = ", ".join(found.unlike)
            rows.append([*names, whose, f"not compared: data of {others} are others"])
        rows += [[*names, "", f"gone: {what}: {why.get(what, '')}"] for what in found.gone]
        rows += [
            [*names, f"`{name}`", f"changed ({what}): {why.get(name, '')}"]
            for name, what in found.changed.items()
        ]
    return printed(["version", "suite", "against", "methods", "figures"], rows, [False] * 5)


def _gaps() -> str:
    rows = []
    for version in sorted(BOARD.glob("2*")):
        found: list[tuple[str, Gap]] = []
        for record in read_hidden(version):
            scenarios = list(dict.fromkeys(gap.scenario for gap in record.gaps))
            shown = scenarios if len(scenarios) <= _MOST_GAPS else [scenarios[len(scenarios) // 2]]
            found += [(record.key, gap) for gap in record.gaps if gap.scenario in shown]
        # Of several runs on a set, the best method first.
        found.sort(key=lambda of: (of[1].scenario, -METRICS[of[1].figure].sign * of[1].open))
        for key, gap in found:
            texts = [f"`{text}`" if k < 2 else text for k, text in enumerate(gap_texts(gap))]
            rows.append([version.name, *texts, key[:8]])
    heads = ["version", *map(str.lower, HEADS[:2]), *HEADS[2:], "key"]
    return printed(heads, rows, [False, False, False, False, *[True] * 5, False, False])


def _without_hidden() -> str:
    """Methods of records of the newest version that have no hidden figures."""
    records = read_hidden(newest_version())
    rows = []
    for path in sorted(newest_version().glob("*/manifest.json")):
        run, suite = read_run(path.parent), path.parent.name
        names = list(run.cells[run.kind.name].unique())
        have = {gap.method for of in records if of.suite == suite for gap in of.gaps}
        lacking = ", ".join(f"`{name}`" for name in names if name not in have) if have else "all"
        rows.append([f"`{suite}`", f"{len(have)} of {len(names)}", lacking])
    return printed(["suite", "methods with hidden figures", "without"], rows, [False, True, False])


def _boards() -> list[str]:
    """Lines that `eitbench leaderboard` prints of the newest record of the suite `quick`."""
    out = io.StringIO()
    Console(file=out, width=_WIDTH, highlight=False).print(table(recorded("quick"), _WIDTH))
    return [line.rstrip() for line in out.getvalue().rstrip().splitlines()]


def _listing(lines: list[str]) -> str:
    return "\n".join(["```text", *lines, "```"])


TABLES = {
    "changes of the leaderboard": _changed,
    "open and hidden figures": _gaps,
    "methods without hidden figures": _without_hidden,
    "records of the leaderboard": _records,
    "boards of quick": lambda: _listing(_boards()),
    "first board of quick": lambda: _listing([*_boards()[2 : 5 + _SHORT], "   …"]),
}
