"""The published picture of training: both losses of DNN and PhyDNN, and how they differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.reports.figures.image_grid import HEADING, NOTE, TITLE

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes

_LOSSES = {
    "data loss": ("train", "validation"),
    "physical loss": ("train_physical", "validation_physical"),
}
_COLOURS = {"train": "C0", "validation": "C1"}


def write_losses(curves: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Draw `losses.png` and `losses.pdf` from the learning curves of "dnn" and "phydnn".

    Above, each loss of both over the epochs; below, how much lower or higher it is with the
    physical loss, in percent of what it is without.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 5.2), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(3, 2))
    for column, (loss, names) in enumerate(_LOSSES.items()):
        above, below = axes[0][column], axes[1][column]
        for split, name in zip(_COLOURS, names, strict=True):
            for method, style in (("dnn", "--"), ("phydnn", "-")):
                curve = curves[method]
                label = f"{'PhyDNN' if method == 'phydnn' else 'DNN'}, {split}"
                above.plot(curve["epoch"], curve[name], style, color=_COLOURS[split], label=label)
            percent = difference_percent(curves, name)
            below.plot(percent.index, percent, color=_COLOURS[split], label=split)
        above.set_yscale("log")
        above.set_title(loss, fontsize=TITLE, loc="left", weight="bold")
        below.axhline(0, color="0.4", lw=0.8)
        below.set_xlabel("epoch", fontsize=HEADING)
        _tidy(above)
        _tidy(below)
    axes[0][0].set_ylabel("mean loss", fontsize=HEADING)
    axes[1][0].set_ylabel("PhyDNN to DNN [%]", fontsize=HEADING)
    axes[0][0].legend(fontsize=NOTE, frameon=False)
    axes[1][0].legend(fontsize=NOTE, frameon=False)
    written = []
    for suffix, metadata in (("png", {}), ("pdf", {"CreationDate": None})):
        path = folder / f"losses.{suffix}"
        figure.savefig(path, dpi=180, metadata=metadata)
        written.append(path)
    return written


def difference_percent(curves: Mapping[str, pd.DataFrame], loss: str) -> pd.Series[float]:
    """How much the `loss` of "phydnn" differs from that of "dnn" [% of the latter], by epoch."""
    of = {name: curve.set_index("epoch")[loss] for name, curve in curves.items()}
    return (100 * (of["phydnn"] / of["dnn"] - 1)).dropna()


def _tidy(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.tick_params(which="both", labelsize=NOTE)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25, lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
