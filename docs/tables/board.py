"""Records of the leaderboard: what they are, what they cost, and what is printed of one."""

import io

from docs.tables.record import DOCS, printed
from rich.console import Console

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.board.records import spent_s
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


def _boards(suite: str) -> list[str]:
    """Lines that `eitbench leaderboard` prints of the newest record of a suite."""
    path = sorted(_BOARD.glob(f"2*/{suite}"))[-1]
    out = io.StringIO()
    Console(file=out, width=_WIDTH, highlight=False).print(table(ranked_rows([path]), _WIDTH))
    return [line.rstrip() for line in out.getvalue().rstrip().splitlines()]


def _listing(lines: list[str]) -> str:
    return "\n".join(["```text", *lines, "```"])


TABLES = {
    "records of the leaderboard": _records,
    "boards of quick": lambda: _listing(_boards("quick")),
    "first board of quick": lambda: _listing([*_boards("quick")[2 : 5 + _SHORT], "   …"]),
}
