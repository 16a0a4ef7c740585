"""Where records lie, and how a table of them is printed."""

from collections.abc import Sequence
from pathlib import Path

from eitbench.reports.tables.formats import markdown_table

DOCS = Path(__file__).resolve().parents[1]
STUDIES = DOCS / "studies"


def printed(
    heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool] | None = None
) -> str:
    """Return a table in Markdown."""
    return "\n".join(markdown_table(heads, rows, right))
