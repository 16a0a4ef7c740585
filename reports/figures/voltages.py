"""Voltages that forward operators predict for a touch, beside those of the exact model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.file_names import file_name
from eitbench.benchmark.rundir.kinds import OPERATOR_RUNS
from eitbench.benchmark.rundir.run_arrays import (
    TOUCHES_KEPT,
    TRUTH,
    Bounds,
    read_responses,
    read_touch,
)
from eitbench.reports.figures.style import (
    COLOURS,
    CONDUCTIVITY_MAP,
    NOTE,
    TITLE,
    label_axes,
    new_figure,
    plain_label,
    save,
)
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from eitbench.benchmark.analysis.results import Run


_ROUNDING = 1e-9


def write_voltages(run: Path) -> list[Path]:
    """Draw `voltages-SCENARIO.png` and `.pdf` of a run of operators; nothing of other runs.

    The sample shown is the one with the median error of the last operator on the board, among those
    whose images the run keeps.

    Raises:
        DataCorruptError: the run's file of voltages is damaged.
    """
    written = []
    for scenario, figure in voltage_figures(read_run(run)):
        stem = run / "figures" / f"voltages-{file_name(scenario)}"
        written += save(figure, stem)
    return written


def voltage_figures(read: Run) -> Iterator[tuple[str, Figure]]:
    """Yield the scenarios of a run of operators with their figures, see `write_voltages`."""
    arrays = read.path / OPERATOR_RUNS.arrays
    if read.kind != OPERATOR_RUNS or not arrays.is_file():
        return
    rows = leaderboard_rows([read])
    for scenario in read.scenarios():
        whole = (row for row in rows if row["scenario"] == scenario and row["coverage"] == 1)
        names = [row["operator"] for row in whole]
        if not names:
            continue
        of_last = read.samples["operator"] == names[-1]
        of_last &= read.samples["scenario"] == scenario
        sample = typical_sample(read.samples[of_last].nsmallest(TOUCHES_KEPT, "sample"))
        n = read.n(scenario)
        responses = read_responses(arrays, scenario, names, sample, n)
        touch = read_touch(arrays, scenario, sample, n)
        yield scenario, draw(responses, *touch, f"{printable(scenario)}, sample {sample}")


def typical_sample(samples: pd.DataFrame) -> int:
    """Return the `sample` of the median `mse` (the upper one of two) among rows of an operator."""
    order = samples.sort_values(["mse", "sample"])["sample"].tolist()
    return int(order[len(order) // 2])


def draw(
    responses: Mapping[str, NDArray[np.float64]],
    image: NDArray[np.float64],
    bounds: Bounds,
    title: str,
) -> Figure:
    """Draw a touch, beside it the responses to it, and below these the errors of the operators.

    Args:
        responses: (M,) [V/A] by operator; that of the exact model is `TRUTH`.
        image: conductivity (H, W) [S/m], within `bounds` (x_min, y_min, x_max, y_max) [m].
        title: of the figure.
    """
    figure = new_figure(9.6, 4.8)
    panels = figure.subplot_mosaic(
        [["touch", "responses"], ["touch", "errors"]],
        width_ratios=(1, 2.6), height_ratios=(2, 1),
    )  # fmt: skip
    above, below = panels["responses"], panels["errors"]
    below.sharex(above)
    above.tick_params(labelbottom=False)
    _draw_touch(panels["touch"], image, bounds)
    truth = responses[TRUTH]
    number = np.arange(len(truth))
    above.plot(number, 1e3 * truth, color="0.75", lw=3, label="exact model")
    operators = [name for name in responses if name != TRUTH]
    # The best operator is drawn last, on top of the others.
    for k, name in reversed(list(enumerate(operators))):
        line: dict[str, Any] = {"color": COLOURS[k % len(COLOURS)], "lw": 0.8}
        above.plot(number, 1e3 * responses[name], label=plain_label(name), **line)
        error = np.abs(responses[name] - truth) / np.sqrt(np.mean(truth**2))
        # An operator that is the model itself has no error that could be drawn.
        below.semilogy(number, np.where(error > _ROUNDING, error, np.nan), **line)
    figure.suptitle(title, fontsize=TITLE, weight="bold", x=0.01, ha="left")
    label_axes(above, "", "", "response to the touch [mV/A]")
    label_axes(below, "", "measurement", "|error| / rms response")
    above.legend(fontsize=NOTE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    figure.align_ylabels()
    return figure


def _draw_touch(axes: Axes, image: NDArray[np.float64], bounds: Bounds) -> None:
    x0, y0, x1, y1 = bounds
    shown = axes.imshow(image, origin="lower", extent=(x0, x1, y0, y1), cmap=CONDUCTIVITY_MAP)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    scale = axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.8)
    scale.set_label("conductivity [S/m]", fontsize=NOTE)
    scale.ax.tick_params(labelsize=NOTE)
