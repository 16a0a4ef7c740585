"""What the records of the leaderboard are, and what they cost."""

from docs.tables.record import DOCS, printed

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.board.records import spent_s

_BOARD = DOCS.parent / "reports" / "board"


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


TABLES = {"records of the leaderboard": _records}
