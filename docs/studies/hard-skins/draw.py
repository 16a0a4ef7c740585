"""Draws docs/hard-skins.png from the record: python docs/studies/hard-skins/draw.py."""

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

HERE = Path(__file__).parent
SERIES = {
    ("kernel-ridge", 25): ("kernel ridge, 25 labelled", "o", "#b0b0b0"),
    ("topographic-map-skins", 0): ("map from other skins, none labelled", "s", "#d95f02"),
    ("topographic-map", 25): ("map of the skin alone, 25 labelled", "^", "#1b9e77"),
    ("topographic-map-skins", 25): ("map from other skins, 25 labelled", "D", "#386cb0"),
}

skins = pd.read_csv(HERE / "properties.csv").set_index("skin").sort_values("explained")
errors = (
    pd.read_csv(HERE / "errors.csv")
    .set_index(["method", "labelled", "skin"])["median_mm"]
    .sort_index()
)
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
