"""A finding of runs: a table with its figure, written into a folder or shown on a page."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from eitbench.benchmark import atomic_write
from eitbench.reports.figures.style import STYLE, save, svg
from eitbench.reports.tables.formats import csv_text, escape_markdown, markdown_table

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Finding:
    """A table of runs, with its figure.

    Attributes:
        stem: of its files.
        title: heading on a page.
        table: all figures.
        grid: the printed table, its heads first.
        legend: explains the table and the figure.
        figure: made in the style `STYLE`; None where there is none.
        shows: sentence for those who cannot see the figure.
        narrow: the figure for one column of a paper; None where it is the same.
    """

    stem: str
    title: str
    table: pd.DataFrame
    grid: list[list[str]]
    legend: str
    figure: Figure | None = None
    shows: str = "A line for each method; the table below has the figures"
    narrow: Figure | None = None

    def write(self, tables: Path, figures: Path) -> list[Path]:
        """Write `STEM.md` and `STEM.csv`, and the figures as PNG, PDF and SVG."""
        import matplotlib as mpl

        written = [tables / f"{self.stem}.{form}" for form in ("md", "csv")]
        heads, *rows = ([escape_markdown(text) for text in row] for row in self.grid)
        text = "\n".join([*markdown_table(heads, rows), "", self.legend, ""])
        atomic_write(written[0], text.encode())
        atomic_write(written[1], csv_text(self.table, "%.6g").encode())
        if self.figure is None:
            return written
        written.append(figures / f"{self.stem}.svg")
        atomic_write(written[-1], self._svg)
        with mpl.rc_context(STYLE):
            written += save(self.figure, figures / self.stem, dpi=200)
            if self.narrow is not None:
                written += save(self.narrow, figures / f"{self.stem}-column", ("pdf",))
        return written

    def picture(self) -> str:
        """Return the figure as a `data:` address, for a page; "" where there is none."""
        if self.figure is None:
            return ""
        return f"data:image/svg+xml;base64,{base64.b64encode(self._svg).decode()}"

    @cached_property  # a page shows it, and a folder holds it
    def _svg(self) -> bytes:
        import matplotlib as mpl

        assert self.figure is not None
        with mpl.rc_context(STYLE):
            return svg(self.figure)
