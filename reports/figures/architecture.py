"""Diagrams of networks, from their layers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.reports.figures.style import COLOURS, NOTE, new_figure, save

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.studies.architecture import Layer

TITLES = {
    "phydnn": ("DNN and PhyDNN", "voltages", "conductivity"),
    "surrogate": ("The learned forward operator", "conductivity", "voltages"),
}
"""Name of a network, its input and its output."""
# Distances [in].
_STEP, _WIDTH, _HIGH, _ROW, _MARGIN = 0.62, 0.32, 0.98, 1.4, 0.45
_COLOURS = {"dense": COLOURS[4], "conv": COLOURS[5], "residual": COLOURS[0], "up": COLOURS[2]}


def write_architectures(networks: Mapping[str, Sequence[Layer]], folder: Path) -> list[Path]:
    """Draw `architecture-NAME.png` and `.pdf` of each network into `folder`."""
    written = []
    for name, layers in networks.items():
        written += save(draw(layers, *TITLES[name]), folder / f"architecture-{name}")
    return written


def draw(layers: Sequence[Layer], title: str, given: str, returned: str) -> Figure:
    """Draw layers from left to right, those on coarser grids lower; vectors are at the top."""
    words = {"input": given, "output": returned}
    columns = _columns(layers)
    lanes = _lanes(layers, columns)
    bottom = max(lanes.values())
    size = (2 * _MARGIN + max(columns.values()) * _STEP, (bottom + 1) * _ROW + 0.35)
    figure = new_figure(*size)
    axes = figure.add_subplot()
    axes.set(xlim=(-_MARGIN, size[0] - _MARGIN), ylim=(-bottom * _ROW - 0.75, 0.95))
    axes.set(xticks=[], yticks=[])
    axes.set_axis_off()
    count = sum(layer.parameters for layer in layers)
    axes.set_title(f"{title} ({count:,} parameters)", fontsize=9, loc="left", weight="bold")
    of = {layer.name: layer for layer in layers}
    place = {name: (columns[name] * _STEP, -lanes[name] * _ROW) for name in of}
    for layer in layers:
        for source in layer.inputs:
            _arrow(axes, place[source], place[layer.name])
    for name, layer in of.items():
        _box(axes, layer, words.get(name, layer.kind), place[name])
    return figure


def _columns(layers: Sequence[Layer]) -> dict[str, int]:
    """Return the number of layers on the longest way to each from the input."""
    columns: dict[str, int] = {}
    for layer in layers:
        columns[layer.name] = 1 + max((columns[name] for name in layer.inputs), default=-1)
    return columns


def _lanes(layers: Sequence[Layer], columns: Mapping[str, int]) -> dict[str, int]:
    """Return the row of each layer: vectors above, a second chain of them below the first."""
    first: dict[int, str] = {}
    vectors: dict[str, int] = {}
    for layer in layers:
        if len(layer.shape) == 1:
            chain = max((vectors.get(name, 0) for name in layer.inputs), default=0)
            taken = first.setdefault(columns[layer.name], layer.name) != layer.name
            vectors[layer.name] = 1 if taken else chain
    sides = sorted({layer.shape[-1] for layer in layers if len(layer.shape) > 1}, reverse=True)
    below = 1 + max(vectors.values())
    return vectors | {
        layer.name: below + sides.index(layer.shape[-1]) for layer in layers if len(layer.shape) > 1
    }


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    (x0, y0), (x1, y1) = start, end
    corners = [(x0 + _WIDTH / 2, y0), (x1 - _WIDTH / 2, y1)]
    if x1 - x0 > 1.5 * _STEP:  # past other layers: above them
        above = y1 + _HIGH / 2
        corners = [(x0 + _WIDTH / 2, y0), (x1, y0), (x1, above)]
        if y0 == y1:
            over = above + 0.14
            corners = [(x0, above), (x0, over), (x1, over), (x1, above)]
    axes.add_patch(
        FancyArrowPatch(
            path=Path(corners), arrowstyle="-|>", mutation_scale=7, color="0.45", lw=0.8
        )
    )


def _box(axes: Axes, layer: Layer, word: str, place: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    x, y = place
    kind = "up" if "↑" in layer.kind else layer.kind.split()[0]
    corner = x - _WIDTH / 2, y - _HIGH / 2
    fill = (_COLOURS[kind], 0.45) if kind in _COLOURS else "0.92"
    axes.add_patch(Rectangle(corner, _WIDTH, _HIGH, facecolor=fill, edgecolor="0.3", lw=0.6))
    axes.text(x, y, word, rotation=90, ha="center", va="center", fontsize=NOTE)
    shape = " × ".join(map(str, layer.shape[-2:]))
    text = f"{layer.shape[0]} of\n{shape}" if len(layer.shape) == 3 else shape
    axes.text(x, y - _HIGH / 2 - 0.04, text, ha="center", va="top", fontsize=NOTE - 1)
