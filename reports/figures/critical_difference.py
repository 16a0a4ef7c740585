"""The critical-difference figure: mean ranks on a line, bars over those that may be equal.

Source: Demsar, Statistical Comparisons of Classifiers over Multiple Data Sets, Journal of Machine
Learning Research 7, 2006, fig. 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eitbench.reports.figures.style import PAGE, STYLE, new_figure, plain_label

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

_LINE, _BAR = 0.17, 0.09  # heights of a name and of a bar [in]
_LETTERS = 27  # of a name, which has 2 in


def joined(ranks: Sequence[float], critical_difference: float) -> list[tuple[int, int]]:
    """The first and last of each longest row of sorted `ranks` that differ by less than that."""
    ends = [int(np.searchsorted(ranks, rank + critical_difference)) - 1 for rank in ranks]
    return [(k, end) for k, end in enumerate(ends) if end > k and (k == 0 or end > ends[k - 1])]


def critical_difference_figure(
    ranks: Sequence[tuple[str, float]], critical_difference: float
) -> Figure:
    """Draw methods with their mean `ranks`, the best first, in the width of a page."""
    names, values = zip(*ranks, strict=True)
    half = (len(names) + 1) // 2
    bars = joined(values, critical_difference)
    top = 0.45 + _BAR * len(bars)  # of the names, below the line of ranks [in]
    height = 0.4 + top + _LINE * half
    figure = new_figure(PAGE, height)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(0, PAGE)
    axes.set_ylim(height - 0.5, -0.5)  # inches below the line of ranks
    axes.axis("off")
    left, right = 2.1, PAGE - 2.1

    def x(rank: float) -> float:
        return left + (right - left) * (rank - 1) / max(1, len(names) - 1)

    def line(xs: Sequence[float], ys: Sequence[float], width: float = 0.7) -> None:
        axes.plot(xs, ys, color="black", lw=width, solid_capstyle="butt")

    line([x(1), x(len(names))], [0, 0])
    step = max(1, len(names) // 6)
    for k in range(len(names)):
        line([x(k + 1)] * 2, [0, -0.03 if k % step else -0.06])
        if k % step == 0:
            axes.text(x(k + 1), -0.08, str(k + 1), ha="center", va="bottom")
    span = min(x(1 + critical_difference), PAGE - 0.1) - x(1)
    line([x(1), x(1) + span], [-0.33, -0.33], 1.2)
    axes.text(
        x(1), -0.36, f"critical difference {critical_difference:.2f}", ha="left", va="bottom",
        fontsize=STYLE["legend.fontsize"],
    )  # fmt: skip
    for k, (first, last) in enumerate(bars):
        line([x(values[first]) - 0.03, x(values[last]) + 0.03], [0.12 + _BAR * k] * 2, 2.2)
    for k, (name, rank) in enumerate(ranks):
        # The better half stands on the left, the best on top; of the others the worst.
        y = top + _LINE * (k if k < half else len(names) - 1 - k) - 0.15
        at_left = k < half
        edge = left - 0.1 if at_left else right + 0.1
        line([x(rank), x(rank), edge], [0, y, y])
        axes.text(
            edge + (-0.04 if at_left else 0.04), y, f"{plain_label(_short(name))} {rank:.2f}",
            ha="right" if at_left else "left", va="center", fontsize=STYLE["legend.fontsize"],
        )  # fmt: skip
    return figure


def _short(name: str) -> str:
    return name if len(name) <= _LETTERS else f"{name[: _LETTERS - 1]}…"
