"""Grids of images: the truth beside the image of each method, one row a sample."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark import Similarity, nearest_pixels, writing
from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import Scene
from eitbench.reports.figures.challenge import draw_challenge
from eitbench.reports.figures.style import (
    CONDUCTIVITY_MAP,
    CONTRAST_MAP,
    HEADING,
    NOTE,
    OUTSIDE,
    TITLE,
    save,
)
from eitbench.reports.tables.boards import printed_boards
from eitbench.reports.tables.challenge import PUBLISHED, challenge_rows
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Images = NDArray[np.floating]

_X_OF_CONTACT = re.compile(r"x\d*_m")
# Distances [in], the same in all grids.
_LINE = NOTE * 1.3 / 72
_CELL, _GAP, _LABEL, _BAR, _HEAD = 1.3, 0.12, 1.15, 0.85, 0.95
_HEAD_LINES = 3
_HEAD_WIDTH = 15
_MAX_ROWS = 12
_ROWS_WITHOUT_FAMILIES = 5
_CHALLENGERS = 4  # methods in the figure of all targets of the challenge


@dataclass(frozen=True, eq=False)
class Tile:
    """One image of a grid.

    Attributes:
        image: (H, W) [S/m]; None where there is none.
        note: lines under it.
        crosses: where contacts really were, in the image's frame [m]; empty if unknown.
    """

    image: Images | None
    note: tuple[str, ...]
    crosses: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class ImageGrid:
    """A grid as plain data.

    Attributes:
        title: of the whole grid.
        columns: headings.
        rows: label lines and tiles of each sample.
        limits: the values [S/m] at the ends of the colour scale.
        contrast: True if images show contrast, not conductivity.
        bounds: (x_min, y_min, x_max, y_max) [m] of an image.
        footnote: meaning of the crosses, and methods that are left out; "" without either.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[tuple[str, ...], tuple[Tile, ...]], ...]
    limits: tuple[float, float]
    contrast: bool
    bounds: tuple[float, float, float, float]
    footnote: str


Columns = list[tuple[str, list[Tile]]]


def write_figures(run: Path) -> list[Path]:
    """Draw the comparison of every scenario of the run directory `run` as PNG and PDF.

    Returns:
        The files, all in `run/figures`; none for operators, which make no images.

    Raises:
        InputError, DataCorruptError: the run cannot be read.
        EitbenchError: the files cannot be written.
    """
    read = read_run(run)
    if read.kind != METHOD_RUNS:
        return []
    written = []
    with writing(f"the figures of {run}"):
        for scenario in read.scenarios():
            figure = draw(comparison(read, scenario))
            written += save(figure, run / "figures" / f"comparison-{file_name(scenario)}")
        best = [row.method for row in challenge_rows(leaderboard_rows([read]))]
        if shown := [name for name in dict.fromkeys(best) if name not in PUBLISHED][:_CHALLENGERS]:
            written += save(draw_challenge(read, shown), run / "figures" / "challenge")
    return written


def comparison(
    run: Run,
    scenario: str,
    methods: Sequence[str] | None = None,
    samples: Sequence[int] | None = None,
) -> ImageGrid:
    """Return the grid of a scenario: by default methods by rank, the first sample of each family.

    Given `samples` are in increasing order.
    """
    rows = [row for row in leaderboard_rows([run]) if row["scenario"] == scenario]
    methods = methods or list(dict.fromkeys(row["method"] for row in rows))
    samples = samples or _chosen(run.samples[run.samples["scenario"] == scenario])
    scene = run.scene(scenario, samples)
    contrast = scene.truth is None or scene.has_classes
    shift = scene.background if contrast else 0.0
    columns: Columns = []
    for method in methods:
        images = run.estimates(scenario, method, samples)
        cell = _by_sample(run.cell(scenario, method))
        image_of = _registration(run, scenario, method)
        tiles = [
            _tile(cell, sample, None if images is None else images[k] - shift, scene, image_of)
            for k, sample in enumerate(samples)
        ]
        columns.append((printable(method), tiles))
    columns, without = _with_images(columns, always=scene.truth is None)
    limits = _limits(scene, [tile.image for _, tiles in columns for tile in tiles])
    if scene.truth is not None:
        scale = limits[1] if scene.has_classes else 1.0
        heading = "truth (classes)" if scene.has_classes else "truth"
        columns.insert(0, (heading, [_true_tile(scene, sample, scale) for sample in samples]))
    described = _by_sample(run.samples[run.samples["scenario"] == scenario])
    labels = [_label(described[sample]) for sample in samples]
    footnotes = []
    if any(tile.crosses for _, tiles in columns for tile in tiles):
        footnotes.append(_CROSSES)
    if without:
        footnotes.append(f"left out, without any image here: {', '.join(without)}")
    return ImageGrid(
        title=printed_boards(rows)[0].title,
        columns=tuple(name for name, _ in columns),
        rows=tuple(
            (label, tuple(tiles[k] for _, tiles in columns)) for k, label in enumerate(labels)
        ),
        limits=limits,
        contrast=contrast,
        bounds=scene.bounds,
        footnote="\n".join(footnotes),
    )


_CROSSES = (
    "+  a true place of contact, turned, moved and scaled into each method's image as the "
    "validation presses tell (not drawn where that is outside the image)"
)


def _registration(run: Run, scenario: str, method: str) -> Similarity | None:
    """The similarity from a method's images to places, if the run has a sound one."""
    cells = run.cells[(run.cells["scenario"] == scenario) & (run.cells["method"] == method)]
    try:
        return Similarity.from_json(cells["registration"].iloc[0])
    except (KeyError, IndexError, ValueError, TypeError):
        return None


def _with_images(columns: Columns, *, always: bool) -> tuple[Columns, list[str]]:
    """Return the columns with any image, and the names of the others with the reasons.

    Where no column has one, all are returned if there must `always` be some.
    """
    with_image = [c for c in columns if any(tile.image is not None for tile in c[1])]
    if always and not with_image:
        return columns, []
    reasons = {
        name: ", ".join(dict.fromkeys(line for tile in tiles for line in tile.note))
        for name, tiles in columns
        if all(tile.image is None for tile in tiles)
    }
    return with_image, [f"{name} ({reason})" for name, reason in reasons.items()]


def _by_sample(rows: pd.DataFrame) -> dict[int, dict[str, Any]]:
    return {int(row["sample"]): row for row in rows.to_dict("records")}  # type: ignore[misc]


def _chosen(rows: pd.DataFrame) -> list[int]:
    """Return the first sample of each family, or without families samples among the touched."""
    first = rows.drop_duplicates("sample").sort_values("sample")
    if "family" in first and first["family"].notna().any():
        chosen = first.drop_duplicates("family")["sample"].to_numpy()[:_MAX_ROWS]
    else:
        if "touched" in first and (first["touched"] == True).any():  # noqa: E712
            first = first[first["touched"] == True]  # noqa: E712
        count = min(_ROWS_WITHOUT_FAMILIES, len(first))
        chosen = first["sample"].to_numpy()[
            np.linspace(0, len(first) - 1, count).round().astype(int)
        ]
    return sorted(int(sample) for sample in chosen)


def _tile(
    cell: dict[int, dict[str, Any]],
    sample: int,
    image: Images | None,
    scene: Scene,
    registration: Similarity | None,
) -> Tile:
    if sample not in cell:
        return Tile(None, ("not run",))
    row = cell[sample]
    if row["status"] != "ok" or image is None:
        return Tile(None, (printable(str(row["status"])),))
    known = {name: float(row[name]) for name in _NOTES if pd.notna(row.get(name))}
    crosses: tuple[tuple[float, float], ...] = ()
    note = _note(known)
    if pd.notna(row.get("expected_x_m")):
        if pd.isna(row["found_x_m"]):
            note = ("no contact found",)
        crosses = ((float(row["expected_x_m"]), float(row["expected_y_m"])),)
        of_contacts = [x for x in row if _X_OF_CONTACT.fullmatch(x) and pd.notna(row[x])]
        places = [[row[x], row[f"y{x[1:]}"]] for x in of_contacts]
        if len(places) > 1 and registration is not None:
            crosses = tuple((x, y) for x, y in registration.inverse(places).tolist())
    return Tile(np.where(scene.mask, image, np.nan), note, crosses)


# Metrics that may stand under an image, with their format.
_NOTES = {
    "ssim": "SSIM {:.3f}",
    "cc": "CC {:.3f}",
    "psnr": "PSNR {:.1f} dB",
    "rie": "RIE {:.3f}",
    "iou": "IoU {:.2f}",
    "localisation_mm": "{:.1f} mm off",
    "response": "rms {:.2g} S/m",
}


def _note(known: dict[str, float]) -> tuple[str, ...]:
    lines: tuple[tuple[str, ...], ...]
    if "ssim" in known:
        lines = (("ssim", "cc"), ("psnr", "rie"))
    elif "cc" in known:
        lines = (("cc",), ("iou",))
    else:
        lines = (("localisation_mm",), ("response",))
    texts = ("  ".join(_NOTES[n].format(known[n]) for n in line if n in known) for line in lines)
    return tuple(text for text in texts if text)


def _true_tile(scene: Scene, sample: int, scale: float) -> Tile:
    if scene.truth is None or sample not in scene.sample:
        return Tile(None, ())
    image = scene.truth[int(np.flatnonzero(scene.sample == sample)[0])] * scale
    return Tile(np.where(nearest_pixels(scene.mask, image.shape), image, np.nan), ())


def _limits(scene: Scene, images: Sequence[Images | None]) -> tuple[float, float]:
    """Return the ends of the colour scale that all images of a scenario share."""
    if scene.truth is not None and not scene.has_classes:
        values = scene.truth[:, scene.mask]
        low = min(float(values.min()), scene.background)
        high = max(float(values.max()), scene.background)
        room = 0.1 * ((high - low) or scene.data_range)
        return max(low - room, 0.0), high + room
    # Methods differ in scale by orders of magnitude; the middle one sets the scale.
    peaks = [float(np.nanpercentile(np.abs(i), 99.5)) for i in images if i is not None]
    peaks = [peak for peak in peaks if peak > 0]
    reach = float(np.median(peaks)) if peaks else scene.data_range
    return -reach, reach


def _label(row: dict[str, Any]) -> tuple[str, ...]:
    lines = [f"sample {row['sample']}"]
    if pd.notna(row.get("family")):
        lines.insert(0, printable(str(row["family"])))
    elif pd.notna(row.get("target")):
        lines.insert(0, printable(str(row["target"])))
    if pd.notna(row.get("snr_db")):
        lines.append(f"{row['snr_db']:.0f} dB")
    if np.isfinite(row.get("touch_snr_db", np.nan)):
        lines.append(f"touch {row['touch_snr_db']:.0f} dB")
    if pd.notna(row.get("depth_mm")):
        lines.append(f"{row['depth_mm']:.3g} mm deep")
    return tuple(lines)


def draw(grid: ImageGrid) -> "Figure":
    """Draw a grid, its title above and its footnote below."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    # Names are data: a dollar sign in one is no formula.
    plain: dict[str, Any] = {"fontsize": NOTE, "parse_math": False}
    x0, y0, x1, y1 = grid.bounds
    tile = max(_CELL * (y1 - y0) / (x1 - x0), 4 * _LINE)
    gap = _GAP + _LINE * max((len(t.note) for _, tiles in grid.rows for t in tiles), default=0)
    width = _LABEL + len(grid.columns) * (_CELL + _GAP) + _BAR
    # A narrow grid still has to hold the words under it.
    letters = int(width * 72 / (NOTE * 0.6))
    foot = [part for line in grid.footnote.splitlines() for part in textwrap.wrap(line, letters)]
    bottom = gap + (len(foot) + 1) * _LINE
    title = textwrap.wrap(grid.title, int(width * 72 / (TITLE * 0.65)))
    head = _HEAD + (len(title) - 1) * TITLE * 1.3 / 72
    height = head + len(grid.rows) * (tile + gap) + bottom - gap
    figure = Figure(figsize=(width, height), facecolor="white")
    figure.suptitle(
        "\n".join(title), x=0.15 / width, y=1 - 0.15 / height, ha="left", va="top", weight="bold",
        **plain | {"fontsize": TITLE},
    )  # fmt: skip
    figure.supxlabel("\n".join(foot), x=0.15 / width, y=0.1 / height, ha="left", **plain)
    colours = ScalarMappable(
        Normalize(*grid.limits), CONTRAST_MAP if grid.contrast else CONDUCTIVITY_MAP
    )
    inside = {
        "left": _LABEL / width,
        "right": 1 - (_BAR + _GAP) / width,
        "bottom": bottom / height,
        "top": 1 - head / height,
        "wspace": _GAP / _CELL,
        "hspace": gap / tile,
    }
    axes = figure.subplots(len(grid.rows), len(grid.columns), squeeze=False, gridspec_kw=inside)
    for above, name in zip(axes[0], grid.columns, strict=True):
        heading = textwrap.wrap(name, _HEAD_WIDTH, max_lines=_HEAD_LINES, placeholder="…")
        above.set_title("\n".join(heading), **plain | {"fontsize": HEADING})
    for (label, tiles), of_row in zip(grid.rows, axes, strict=True):
        lines = (line if len(line) <= 18 else f"{line[:17]}…" for line in label)
        of_row[0].set_ylabel("\n".join(lines), rotation=0, ha="right", va="center", **plain)
        for one, of_tile in zip(tiles, of_row, strict=True):
            of_tile.set(xlim=(x0, x1), ylim=(y0, y1), xticks=[], yticks=[], aspect="equal")
            of_tile.spines[:].set_visible(False)
            of_tile.set_facecolor(OUTSIDE if grid.contrast else "none")
            _draw_tile(of_tile, one, grid.bounds, colours, plain)
    long = min(2.4, max(height - head - bottom, 0.6))
    place = (1 - (_BAR - 0.1) / width, 1 - (head + long) / height, 0.13 / width, long / height)
    scale = figure.colorbar(colours, cax=figure.add_axes(place), extend="both")
    scale.ax.tick_params(labelsize=NOTE, length=2)
    scale.set_label("contrast [S/m]" if grid.contrast else "conductivity [S/m]", fontsize=NOTE)
    return figure


def _draw_tile(
    axes: "Axes",
    tile: Tile,
    bounds: tuple[float, float, float, float],
    colours: Any,
    plain: dict[str, Any],
) -> None:
    from matplotlib.patheffects import Normal, Stroke

    x0, y0, x1, y1 = bounds
    note = "\n".join(tile.note)
    if tile.image is None:
        axes.set_facecolor("0.95")
        place = (x0 + x1) / 2, (y0 + y1) / 2
        axes.text(*place, note, color="0.35", ha="center", va="center", **plain)
        return
    axes.set_xlabel(note, **plain)
    axes.imshow(
        tile.image, origin="lower", extent=(x0, x1, y0, y1), cmap=colours.cmap, norm=colours.norm,
        interpolation="nearest",
    )  # fmt: skip
    for cross in tile.crosses:
        halo = [Stroke(linewidth=3, foreground="white"), Normal()]
        axes.plot(*cross, "+", color="black", markersize=9, mew=1.4, path_effects=halo)
