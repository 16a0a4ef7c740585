"""Where on a sensor methods err: the median error of the place by squares of the pressed area."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark import Similarity
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.place_errors import LEAST_PRESSES
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.kinds import METHOD_RUNS

MAPPED_METHODS = 3
"""The best ones, whose errors are mapped."""
_PRESSES_A_SQUARE = 12
_RIM = 128


def error_maps(
    methods: Mapping[str, tuple[Run, str]], cells: Mapping[str, pd.DataFrame], scenario: str
) -> dict[str, Any] | None:
    """Map the errors of the first `MAPPED_METHODS` methods; None with few places or all on a line.

    Args:
        methods: the run and the name of each method, by its label, the best first.
        cells: its samples, by label.
        scenario: its name.

    Returns:
        In the coordinates of the robot, all in mm: `outline` (k, 2) and `electrodes` (e, 2) of the
        nominal sensor; `edges`, x and y of the lower-left corner and the side of a square; and
        `maps`, of each method its `method`, its `median` error and its `error`, rows of squares
        from the lowest, None in those without a press.

    Raises:
        EitbenchError: the sensor of one's own recording is no longer there.
    """
    shown = {
        label: cells[label].sort_values("sample")
        for label in list(methods)[:MAPPED_METHODS]
        if cells[label]["expected_x_m"].notna().all()
    }
    if not shown or min(map(len, shown.values())) < LEAST_PRESSES:
        return None
    run, name = methods[next(iter(shown))]
    first = next(iter(shown.values()))
    places = 1e3 * np.stack([numbers(first, f"expected_{axis}_m") for axis in "xy"], axis=1)
    if run.kind == METHOD_RUNS:  # places in the image; methods of places have the robot's
        of = (run.cells["scenario"] == scenario) & (run.cells["method"] == name)
        register = Similarity.from_json(run.cells.loc[of, "registration"].iloc[0])
        places = 1e3 * register(places / 1e3)
    corner, size = places.min(axis=0), np.ptp(places, axis=0)
    if size.min() * len(places) < size.max():  # places on a line are no map
        return None
    side = float(np.sqrt(_PRESSES_A_SQUARE * size.prod() / len(places)))
    squares = np.ceil(size / side).astype(int)
    corner -= (squares * side - size) / 2
    # Rounding must put no press beside the outermost squares.
    column, row = np.clip(np.floor((places - corner) / side).astype(int), 0, squares - 1).T
    maps = []
    for label, cell in shown.items():
        if list(cell["sample"]) != list(first["sample"]):
            continue  # a part of the samples is no map of the same presses
        error = pd.Series(numbers(cell, "localisation_mm"))
        in_squares = error.groupby(row * squares[0] + column).median()
        image = np.full(int(squares.prod()), np.nan)
        image[in_squares.index] = in_squares.round(2)
        by_rows = image.reshape(squares[::-1]).tolist()
        maps.append({"method": label, "median": float(error.median()), "error": by_rows})
    scenarios = manifests.suite_of(run.manifest).scenarios
    sensor = next(s for s in scenarios if s.name == scenario).nominal_sensor
    outline, around = sensor.outline, np.linspace(0.0, sensor.outline.perimeter, _RIM)
    return {
        "outline": (1e3 * outline.point(around)).round(2).tolist(),
        "electrodes": (1e3 * outline.point([e.centre for e in sensor.electrodes]))
        .round(2)
        .tolist(),
        "edges": [float(corner[0]), float(corner[1]), side],
        "maps": maps,
    }
