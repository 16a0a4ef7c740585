"""Records of the leaderboard: what they are, what they cost, and what is printed of one."""

import io

from docs.tables.record import DOCS, printed
from rich.console import Console

from eitbench.benchmark.analysis.hidden import read_hidden
from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.board.changes import version_key
from eitbench.reports.board.records import spent_s
from eitbench.reports.tables.gaps import HEADS, gap_texts
from eitbench.reports.tables.leaderboard import ranked_rows
from eitbench.reports.tables.terminal import table

_BOARD = DOCS.parent / "reports" / "board"
_WIDTH = 120
_SHORT = 7
"""Methods that the README shows."""


def _commit(name: str) -> str:
    """Its first figures, and whether files had changed since."""
    head, _, changed = name.partition("-")
    return f"{head[:8]}-{changed}" if changed else head[:8]


def _records() -> str:
    rows = []
    for path in sorted(_BOARD.glob("2*/*/manifest.json")):
        run = read_run(path.parent)
        frames = sum(run.n(name) for name in run.scenarios())
        minutes = spent_s(run).sum() / 60
        size = sum(file.stat().st_size for file in path.parent.iterdir()) / 1e6
        rows.append([
            path.parents[1].name, f"`{path.parent.name}`", str(run.cells[run.kind.name].nunique()),
            f"{frames:,}", f"{minutes:.1f}", f"{size:.1f}", str(run.manifest["started"])[:10],
            _commit(str(run.manifest["git_commit"])),
        ])  # fmt: skip
    heads = ["version", "suite", "methods", "frames", "minutes of methods", "MB", "made", "commit"]
    return printed(heads, rows, [False, False, True, True, True, True, False, False])


def _gaps() -> str:
    rows = []
    for version in sorted(_BOARD.glob("2*")):
        for record in read_hidden(version):
            for gap in record.gaps:
                texts = [f"`{text}`" if k < 2 else text for k, text in enumerate(gap_texts(gap))]
                rows.append([version.name, *texts, record.key[:8]])
    heads = ["version", *map(str.lower, HEADS[:2]), *HEADS[2:], "key"]
    return printed(heads, rows, [False, False, False, False, *[True] * 5, False, False])


def _boards(suite: str) -> list[str]:
    """Lines that `eitbench leaderboard` prints of the newest record of a suite."""
    path = max(_BOARD.glob(f"2*/{suite}"), key=lambda path: version_key(path.parent.name))
    out = io.StringIO()
    Console(file=out, width=_WIDTH, highlight=False).print(table(ranked_rows([path]), _WIDTH))
    return [line.rstrip() for line in out.getvalue().rstrip().splitlines()]


def _listing(lines: list[str]) -> str:
    return "\n".join(["```text", *lines, "```"])


TABLES = {
    "open and hidden figures": _gaps,
    "records of the leaderboard": _records,
    "boards of quick": lambda: _listing(_boards("quick")),
    "first board of quick": lambda: _listing([*_boards("quick")[2 : 5 + _SHORT], "   …"]),
}
