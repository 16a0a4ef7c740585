"""The losses of DNN and PhyDNN in training, and how they differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.reports.figures.style import NOTE, label_axes, new_figure, save

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

_LOSSES = {
    "data loss": ("train", "validation"),
    "physical loss": ("train_physical", "validation_physical"),
}
_COLOURS = {"train": "C0", "validation": "C1"}


def write_losses(curves: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Draw `losses.png` and `losses.pdf` from the learning curves of "dnn" and "phydnn".

    Above, each loss of both over the epochs; below, how much lower or higher it is with the
    physical loss, in percent of what it is without. Losses that were not noted have no line: a
    training that is told of no operator has no physical ones.
    """
    from matplotlib.ticker import MaxNLocator

    figure = new_figure(7.6, 5.2)
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(3, 2))
    for column, (loss, names) in enumerate(_LOSSES.items()):
        above, below = axes[0][column], axes[1][column]
        for split, name in zip(_COLOURS, names, strict=True):
            for method, style in (("dnn", "--"), ("phydnn", "-")):
                curve = curves[method]
                if name not in curve:
                    continue
                label = f"{'PhyDNN' if method == 'phydnn' else 'DNN'}, {split}"
                above.plot(curve["epoch"], curve[name], style, color=_COLOURS[split], label=label)
            if all(name in curve for curve in curves.values()):
                percent = difference_percent(curves, name)
                below.plot(percent.index, percent, color=_COLOURS[split], label=split)
        above.set_yscale("log")
        below.axhline(0, color="0.4", lw=0.8)
        first = column == 0
        label_axes(above, loss, "", "mean loss" if first else "")
        label_axes(below, "", "epoch", "PhyDNN to DNN [%]" if first else "")
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes[0][0].legend(fontsize=NOTE, frameon=False)
    axes[1][0].legend(fontsize=NOTE, frameon=False)
    return save(figure, folder / "losses")


def difference_percent(curves: Mapping[str, pd.DataFrame], loss: str) -> pd.Series[float]:
    """Return the `loss` of "phydnn" less that of "dnn" [% of the latter], by epoch."""
    of = {name: curve.set_index("epoch")[loss] for name, curve in curves.items()}
    return (100 * (of["phydnn"] / of["dnn"] - 1)).dropna()
