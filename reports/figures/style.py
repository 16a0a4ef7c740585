"""The style of figures: widths, fonts, colours, markers, and the way they are made and saved."""

from __future__ import annotations

import base64
import io
from functools import partial
from typing import TYPE_CHECKING, Any

from eitbench.benchmark import atomic_write
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
"""Settings of Matplotlib while figures for papers are made and written."""

TITLE, HEADING, NOTE = 11, 8.5, 7
"""Sizes of type [pt] in figures for the screen."""

CONDUCTIVITY_MAP, CONTRAST_MAP = "viridis", "PuOr_r"
"""Colour maps of images in every figure, page and live view: purple conducts less (resistive),
yellow or orange conducts more; of contrasts and errors white is none. Truth and estimates share map
and scale. Colour-blind readers can read both: viridis rises evenly in lightness, and ColorBrewer
calls PuOr safe."""

OUTSIDE = "0.88"
"""What lies outside a sensor where images show contrast, whose white would not end on paper."""

# Six of Okabe and Ito's colours, then those that are farthest from all before them in normal,
# red-blind and green-blind eyes; markers and dashes tell lines apart in grey.
COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#960019", "#fac87d",
    "#64324b", "#0032af", "#4b7dfa", "#4b19fa",
)  # fmt: skip
_MARKERS = "osDP^*Xh"  # shifted by one each time round the colours, so that no pair comes twice
_DASHES = ("-", "--", ":", "-.")

# No date, so that the same figure gives the same file.
_METADATA: dict[str, dict[str, Any]] = {
    "png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}
}  # fmt: skip


def marker(k: int) -> str:
    """Return the marker of line `k`: with its colour, no pair comes twice."""
    return _MARKERS[(k + k // len(COLOURS)) % len(_MARKERS)]


def line_style(k: int) -> dict[str, Any]:
    """Return the marker, colour and dashes of line `k`."""
    dashes = _DASHES[k // len(COLOURS) % len(_DASHES)]
    return {"marker": marker(k), "color": COLOURS[k % len(COLOURS)], "ls": dashes}


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [in] that belongs to no window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def label_axes(axes: Axes, title: str, x: str, y: str) -> None:
    """Give axes of a figure for the screen their title, labels, grid and spines."""
    axes.set_title(title, fontsize=TITLE, loc="left", weight="bold")
    axes.set_xlabel(x, fontsize=HEADING)
    axes.set_ylabel(y, fontsize=HEADING)
    axes.tick_params(which="both", labelsize=NOTE)
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)


def plain_label(text: str) -> str:
    """Return a name that Matplotlib shows as it is: no mathematics, no hidden label."""
    shown = printable(text).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def save(
    figure: Figure, stem: Path, formats: Sequence[str] = ("png", "pdf"), dpi: float = 180
) -> list[Path]:
    """Write a figure as `stem.png` and `stem.pdf`, or in other formats, always the same bytes."""
    written = []
    for form in formats:
        written.append(stem.with_name(f"{stem.name}.{form}"))
        about = _METADATA[form]
        atomic_write(written[-1], partial(figure.savefig, format=form, dpi=dpi, metadata=about))
        figure.set_layout_engine(None)  # it is laid out, which takes as long as drawing it
    return written


def svg(figure: Figure) -> bytes:
    """The figure as SVG, always the same bytes."""
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata=_METADATA["svg"])
    figure.set_layout_engine(None)
    return content.getvalue()


def to_png(figure: Figure) -> str:
    """Return a figure as a `data:` address, for a page."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=160)
    return f"data:image/png;base64,{base64.b64encode(content.getvalue()).decode()}"
