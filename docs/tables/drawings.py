"""`python -m docs.tables.drawings [NAME...]`: draw figures of pages from records, all or some."""

import sys
from collections.abc import Callable

import matplotlib as mpl
from docs.tables.record import DOCS
from docs.tables.recorded import transfer
from matplotlib.figure import Figure

from eitbench.benchmark.findings.transfer import over_skins
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.findings.transfer import draw as draw_transfer


def _new_skin() -> Figure:
    return draw_transfer(over_skins(transfer("new-skin")))


DRAWINGS: dict[str, Callable[[], Figure]] = {"new-skin": _new_skin}
"""By the names of their files in `docs`."""


if __name__ == "__main__":
    for name in sys.argv[1:] or DRAWINGS:
        with mpl.rc_context(STYLE):
            save(DRAWINGS[name](), DOCS / name, ("png",))
