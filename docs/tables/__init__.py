"""Tables of the documentation, made from stored runs and studies.

A table stands between `<!-- table: NAME -->` and `<!-- end of table -->`. `make tables` writes them
all anew; a test fails where a page and its record differ.
"""

import re
from pathlib import Path

from docs.tables import (
    board,
    ceiling,
    design,
    installation,
    latency,
    novelty,
    per_frame,
    recorded,
    simulated,
    speed,
    uncertainty,
    wiring,
)
from docs.tables.record import DOCS

TABLES = {
    **simulated.TABLES,
    **board.TABLES,
    **ceiling.TABLES,
    **uncertainty.TABLES,
    **novelty.TABLES,
    **recorded.TABLES,
    **wiring.TABLES,
    **design.TABLES,
    **installation.TABLES,
    **latency.TABLES,
    **per_frame.TABLES,
    **speed.TABLES,
}
_PLACE = re.compile(r"(<!-- table: (.+?) -->\n).*?(<!-- end of table -->)", flags=re.DOTALL)


def pages() -> list[Path]:
    """Return all pages that may hold a table."""
    return [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def filled(text: str) -> str:
    """Return a page with its tables made anew."""
    return _PLACE.sub(
        lambda place: place[1] + TABLES[place[2]]().strip("\n") + "\n" + place[3], text
    )
