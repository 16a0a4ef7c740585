"""Tables of things that have a name, for a terminal."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

# Longer than a line; programs get it.
_HIDDEN = ("citation",)


def names_table(rows: Sequence[Mapping[str, str | int | None]]) -> "Table":
    """`rows` with the name first: it is never cut, since commands take it; the rest is folded."""
    from rich.table import Table
    from rich.text import Text

    shown = [{k: v for k, v in row.items() if k not in _HIDDEN} for row in rows]
    longest = max((len(str(next(iter(row.values())))) for row in shown), default=0)
    table = Table(box=None, pad_edge=False)
    for k, column in enumerate(shown[0] if shown else ()):
        first = k == 0
        table.add_column(
            column, overflow="fold", no_wrap=first, min_width=longest if first else None
        )
    for row in shown:
        table.add_row(*(Text("" if value is None else str(value)) for value in row.values()))
    return table
