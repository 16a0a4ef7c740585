"""The style of figures for papers: widths, fonts, colours, markers."""

from typing import Any

COLUMN, PAGE = 3.5, 7.16
"""Widths of IEEE's columns and pages [in]."""

FONT = 8
STYLE: Any = {  # the key type of Matplotlib's stubs names every parameter
    "font.size": FONT,
    "axes.titlesize": FONT,
    "legend.fontsize": FONT - 1,
    "xtick.labelsize": FONT - 1,
    "ytick.labelsize": FONT - 1,
    # Fonts go into the file, as text that can be searched.
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "eitbench",
    "axes.spines.top": False,
    "axes.spines.right": False,
}
"""How Matplotlib is to be set while these figures are made and written."""

# Okabe and Ito's colours; markers and dashes tell lines apart in grey.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a6d00", "#7f7f7f")
_MARKERS = "osDP^*Xh"  # as many as colours: shifted by one each time round, no pair comes twice
DASHES = ("-", "--", ":", "-.")


def marker(k: int) -> str:
    """The marker of line `k`: with its colour, no pair comes twice."""
    return _MARKERS[(k + k // len(COLOURS)) % len(_MARKERS)]
