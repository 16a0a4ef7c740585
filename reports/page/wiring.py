"""The page of the doctor of wiring: what it found, and measured beside modelled frames."""

from collections.abc import Sequence
from pathlib import Path

from eitbench.benchmark import atomic_write
from eitbench.reports.figures.style import STYLE, to_png
from eitbench.reports.figures.wiring import WiringFrames, wiring_figure
from eitbench.reports.page.rendering import asset, render


def write_wiring_page(path: Path, title: str, said: Sequence[str], frames: WiringFrames) -> None:
    """Write one HTML file at `path` with sentences, the figure and nothing that is loaded.

    Raises:
        OSError: the folder is not writable or full.
    """
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        picture = to_png(wiring_figure(frames))
    page = render(
        "wiring.html.jinja", title=title, said=said, picture=picture, style=asset("report.css")
    )
    atomic_write(path, page.encode())
