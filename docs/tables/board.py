"""What the records of the leaderboard are, and what they cost."""

from docs.tables.record import DOCS, printed

from eitbench.benchmark.analysis.hidden import read_hidden
from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.tables.gaps import HEADS, gap_texts

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
        minutes = (run.samples["frame_ms"].sum() / 1e3 + run.cells["setup_s"].sum()) / 60
        size = sum(file.stat().st_size for file in path.parent.iterdir()) / 1e6
        rows.append([
            path.parents[1].name, f"`{path.parent.name}`", str(run.cells["method"].nunique()),
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


TABLES = {"records of the leaderboard": _records, "open and hidden figures": _gaps}
