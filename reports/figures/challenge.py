"""The 21 targets of the Kuopio Tomography Challenge 2023 as methods see them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.ktc import enlarged, segmented
from eitbench.reports.figures.style import CONTRAST_MAP, NOTE, TITLE
from eitbench.reports.tables.challenge import LEVELS, SCENARIO, TARGETS
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CELL, _LABEL, _FOOT = 0.52, 1.2, 0.3
_REACH = 1.4  # ends of the colour map, where it is too dark to tell its colours apart


def draw_challenge(run: Run, methods: Sequence[str]) -> "Figure":
    """Draw the truth above the classes of each of `methods`, with the score below each image."""
    from matplotlib.figure import Figure

    rows, columns = 1 + len(methods), TARGETS * len(LEVELS)
    line = NOTE * 1.5 / 72
    width, height = _LABEL + columns * _CELL + 0.1, _FOOT + rows * (_CELL + line) + _FOOT
    figure = Figure(figsize=(width, height), facecolor="white")
    # A gap between two levels is a narrow column of its own.
    wide = [1.0 if k % (TARGETS + 1) != TARGETS else 0.15 for k in range(columns + len(LEVELS) - 1)]
    axes = figure.subplots(
        rows, len(wide), squeeze=False,
        gridspec_kw={
            "left": _LABEL / width, "right": 1 - 0.05 / width, "wspace": 0.06,
            "top": 1 - (_FOOT + line) / height, "bottom": _FOOT / height,
            "hspace": line / _CELL, "width_ratios": wide,
        },
    )  # fmt: skip
    for place in axes.flat:
        place.set(xticks=[], yticks=[])
        place.set_axis_off()
    samples = list(range(TARGETS))
    for level in LEVELS:
        scenario = SCENARIO.format(level)
        first = (level - 1) * (TARGETS + 1)
        axes[0, first + TARGETS // 2].set_title(f"level {level}", fontsize=TITLE)
        truth = run.scene(scenario, samples).truth
        shown = [[None if truth is None else truth[k] for k in samples]]
        notes = [[""] * TARGETS]
        for method in methods:
            images = run.estimates(scenario, method, samples)
            cell = run.cell(scenario, method).set_index("sample")["ktc_score"]
            found = [None if images is None else segmented(enlarged(images[k])) for k in samples]
            shown.append(found)
            notes.append([f"{cell[k]:.2f}" for k in samples])
        for row, (of_row, under) in enumerate(zip(shown, notes, strict=True)):
            for k, (image, note) in enumerate(zip(of_row, under, strict=True)):
                place = axes[row, first + k]
                if image is not None:
                    place.imshow(
                        image, cmap=CONTRAST_MAP, vmin=-_REACH, vmax=_REACH, origin="lower"
                    )
                place.text(0.5, -0.04, note, transform=place.transAxes, ha="center", va="top",
                           fontsize=NOTE)  # fmt: skip
    for row, name in enumerate(["truth", *methods]):
        axes[row, 0].text(-0.15, 0.5, printable(name), transform=axes[row, 0].transAxes,
                          ha="right", va="center", fontsize=TITLE, parse_math=False)  # fmt: skip
    figure.text(
        0.05 / width, 0.08 / height,
        "orange: conductive, purple: resistive, as the challenge's rule cuts each image; below it "
        "its score, at most 1",
        fontsize=NOTE,
    )  # fmt: skip
    return figure
