"""Draws docs/hard-skins.png and docs/hard-skins-maps.png from this folder and the record.

Run: python -m docs.studies.hard-skins.draw
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from docs.tables.recorded import transfer

HERE = Path(__file__).parent
SERIES = {
    ("kernel-ridge", 25): ("kernel ridge, 25 labelled", "o", "#b0b0b0"),
    ("topographic-map-skins", 0): ("map from other skins, none labelled", "s", "#d95f02"),
    ("topographic-map", 25): ("map of the skin alone, 25 labelled", "^", "#1b9e77"),
    ("topographic-map-skins", 25): ("map from other skins, 25 labelled", "D", "#386cb0"),
}

skins = pd.read_csv(HERE / "properties.csv").set_index("skin").sort_values("explained")
errors = pd.DataFrame(transfer("new-skin"))
errors = errors.set_index(["method", "labelled", "recording"])["median_mm"].sort_index()
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
across = range(len(skins))
for series, (label, marker, colour) in SERIES.items():
    axes.plot(across, errors[series][skins.index], marker, color=colour, label=label, ms=7)
axes.plot(
    across, skins["at_1500"], "_", color="k", ms=14, mew=2, label="kernel ridge, 1,500 labelled"
)
ticks = [f"{name[-2:]}\n{share:.0%}" for name, share in skins["explained"].items()]
axes.set_xticks(across, ticks)
axes.set_xlabel("skin, and the share of its frames' variance that the place explains")
axes.set_ylabel("median error of the place [mm]")
axes.set_ylim(0, 21)  # room for the legend
axes.grid(axis="y", alpha=0.3)
axes.spines[["top", "right"]].set_visible(False)
axes.legend(frameon=False, fontsize=9)
figure.savefig(HERE.parents[1] / "hard-skins.png", dpi=130)

maps = pd.read_csv(HERE / "maps.csv")
names = list(maps["skin"].unique())
figure, places = plt.subplots(4, 7, figsize=(8, 5.4), layout="constrained")
for k, name in enumerate(names):
    of = maps[maps["skin"] == name]
    for row, what in enumerate(("size", "of_place")):
        axes = places[2 * (k // 7) + row, k % 7]
        grid = of.pivot(index="row", columns="column", values=what)
        shown = axes.pcolormesh(grid.columns, grid.index, np.log2(grid), vmin=-2, vmax=2)
        axes.set_aspect("equal")
        axes.set_axis_off()
        if row == 0:
            axes.set_title("model" if name == "disc" else name[-2:], fontsize=10)
for axes, label in zip(places[:, 0], ("whole", "by the place") * 2, strict=True):
    x, y = axes.get_xlim()[0], sum(axes.get_ylim()) / 2
    axes.text(x, y, label, rotation=90, ha="right", va="center", fontsize=9)
scale = figure.colorbar(shown, ax=places, location="bottom", shrink=0.4, aspect=40)
scale.set_ticks([-2, -1, 0, 1, 2], labels=["1/4", "1/2", "1", "2", "4"])
scale.set_label("rms of what a press changes, over that of the skin's median cell", fontsize=9)
figure.savefig(HERE.parents[1] / "hard-skins-maps.png", dpi=130)
