"""Tables and figures of the documentation, read from stored runs and studies.

A table stands between `<!-- table: NAME -->` and `<!-- end of table -->`, a figure of a sentence as
`docs.tables.figures` says. `make tables` writes them all anew; a test fails where a page and its
record differ.
"""

import re
from pathlib import Path

from docs.tables import (
    board,
    ceiling,
    checks,
    claims,
    comparison,
    design,
    installation,
    latency,
    learned,
    novelty,
    per_frame,
    recorded,
    sim2real,
    simulated,
    skin,
    speed,
    tuning,
    uncertainty,
    wiring,
)
from docs.tables.figures import with_figures
from docs.tables.record import DOCS

TABLES = {
    **learned.TABLES,
    **comparison.TABLES,
    **claims.TABLES,
    **sim2real.TABLES,
    **simulated.TABLES,
    **skin.TABLES,
    **checks.TABLES,
    **tuning.TABLES,
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
    """Return all pages that may hold a table or a figure."""
    return [DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


def filled(text: str) -> str:
    """Return a page with its tables made and its figures read anew."""
    text = _PLACE.sub(
        lambda place: place[1] + TABLES[place[2]]().strip("\n") + "\n" + place[3], text
    )
    return with_figures(text)
