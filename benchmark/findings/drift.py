"""Error of a method over the time of a recording, and when it shows that a skin was cut.

The order of presses is time. A recorded set on the reference of its start beside the same set on
a renewed one tells what drift costs.

Alarms. A detector is the size of a change: of a method's image (rms over the sensor), or of the
raw frame (relative to the reference), against the start or against the frame `LAG` frames before.
What a cut changes for good is the mean of the `_AROUND` frames after it less that of those before
it. The threshold of each is the 99th percentile of the same quantity over the first half of the
frames before the first cut, so that 1 % of these are false alarms; the second half shows how many
really are.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run, cells_of, read_table
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, bootstrap, medians
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.benchmark.rundir.tables import wrong_kind
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.public.hydrogel import CUTS, FRAME_INTERVAL_S, Cut
from eitbench.scenarios.suites.scenario import RecordedScenario

PARTS = 5
"""Parts of the time of a recording."""
LAG = 20
"""Frames from a frame back to the one that it is compared with, as upstream did: 160 s."""
LAG_S = LAG * FRAME_INTERVAL_S
FALSE_ALARMS = 0.01
RAW = "raw voltages"
DAMAGE = "hydrogel-damage"
ALARMS_FILE = "alarms.parquet"
"""What `alarms` returns, of a record of the leaderboard: it has few images."""
_NUMBERS = ("false_start", "false_before", "delay_s", "lasting", "during_mm", "place_mm")
_TEXTS = ("scenario", "method", "cut")
_AROUND = 8
"""As many as lie between the first two cuts."""


def over_time(run: Run) -> pd.DataFrame:
    """Error of the place in each fifth of the presses; empty without presses in order of time.

    Returns:
        One row per recorded scenario, method and fifth: `scenario`, `method`, `part` (1 to 5), `n`,
        and `error_mm`, the median, with its interval `low` to `high` over presses.
    """
    recorded = {s["name"] for s in _declared(run) if s.get("kind") == "recorded"}
    rows = []
    for (scenario, method), cell in cells_of(run.samples).items():
        error = numbers(cell, "localisation_mm")
        single = "contacts" not in cell or cell["contacts"].isna().all()
        known = cell["expected_x_m"].notna().any()
        if scenario not in recorded or not single or not known:
            continue
        if len(error) < PARTS * MIN_CLUSTERS or np.isnan(error).any():
            continue
        for part, values in enumerate(np.array_split(error, PARTS), start=1):
            found = bootstrap(values[:, None], np.arange(len(values)), medians)[0]
            row = {"scenario": scenario, "method": method, "part": part, "n": len(values)}
            rows.append(row | {"error_mm": found.value, "low": found.low, "high": found.high})
    return pd.DataFrame(rows)


def alarms(run: Run) -> pd.DataFrame:
    """When images, and raw voltages, say that a skin was cut.

    Empty where no skin was, and where its recording is not here.

    Returns:
        One row per scenario, detector and cut: `scenario`, `method` (`RAW` for the voltages),
        `false_start` and `false_before`, the shares of false alarms in the second half of the
        frames before the first cut, of the change against the start and against the frame before;
        `cut` (its letter), `delay_s` from its first frame to the alarm of the latter (NaN without
        one while it lasted), `lasting` (size of the lasting change over its threshold), and
        `during_mm` and `place_mm`, the distances of the change while it was cut, and of the lasting
        one, in the image, unregistered, from the cut.

    Raises:
        DataCorruptError: the table that a record keeps of it is damaged.
    """
    rows: list[dict[str, object]] = []
    if not any(s.get("recording") == DAMAGE for s in _declared(run)):
        return pd.DataFrame()
    if (run.path / ALARMS_FILE).is_file():
        return _kept(run.path / ALARMS_FILE)
    for scenario in suite_of(run.manifest).scenarios:
        if not isinstance(scenario, RecordedScenario) or scenario.recording != DAMAGE:
            continue
        if scenario.name not in run.scenarios():
            continue
        try:
            data = load(scenario, "test", run.n(scenario.name))
        except (DataUnavailableError, DataCorruptError):
            continue
        if data.samples["cuts"].max() < len(CUTS):
            continue
        size = float(np.linalg.norm(data.references[0]))
        frames = (data.voltages - data.references) / size
        rows += _alarms_of(data, RAW, frames, None)
        for name, method in cells_of(run.samples):
            if name == scenario.name:
                images = run.estimates(name, method, data.samples["sample"].tolist())
                if images is not None and np.isfinite(images[:, data.sensor.mask]).all():
                    contrast = images.astype(np.float64) - data.sensor.background
                    inside = contrast[:, data.sensor.mask]
                    rows += _alarms_of(data, method, inside / np.sqrt(inside.shape[1]), contrast)
    return pd.DataFrame(rows)


def _kept(path: Path) -> pd.DataFrame:
    table = read_table(path)
    if not {*_TEXTS, *_NUMBERS} <= set(table) or wrong_kind(table, _TEXTS, _NUMBERS):
        raise DataCorruptError(f"{path} does not hold the alarms of a skin: make the record again.")
    return table


def _declared(run: Run) -> list[dict[str, Any]]:
    """The scenarios of a run of methods, as declared."""
    return run.manifest["plan"]["suite"]["scenarios"] if run.kind == METHOD_RUNS else []


def _alarms_of(
    data: Dataset, method: str, values: Array, contrast: Array | None
) -> list[dict[str, object]]:
    """Rows of one detector, from the `values` (n, k) whose norm it watches."""
    first = round(data.samples["time_s"].iloc[0] / FRAME_INTERVAL_S)
    quiet = CUTS[0].first - first
    half = quiet // 2
    start = np.linalg.norm(values, axis=1)
    before = np.linalg.norm(values[LAG:] - values[:-LAG], axis=1)
    gap = max(cut.after - cut.first for cut in CUTS)
    times = range(_AROUND, half - gap - _AROUND)
    usual = [float(np.linalg.norm(_lasting(values, t, t + gap))) for t in times]
    limits = [float(np.quantile(x, 1 - FALSE_ALARMS)) for x in (start[:half], before[:half], usual)]
    rows: list[dict[str, object]] = []
    for cut in CUTS:
        begin, end = cut.first - first, cut.after - first
        alarm = np.flatnonzero(before[begin - LAG : end - LAG] > limits[1])
        row = {
            "scenario": data.scenario,
            "method": method,
            "false_start": float(np.mean(start[half:quiet] > limits[0])),
            "false_before": float(np.mean(before[half : quiet - LAG] > limits[1])),
            "cut": cut.letter,
            "delay_s": FRAME_INTERVAL_S * alarm[0] if len(alarm) else np.nan,
            "lasting": float(np.linalg.norm(_lasting(values, begin, end))) / limits[2],
            "during_mm": np.nan,
            "place_mm": np.nan,
        }
        if contrast is not None:
            during = contrast[begin:end].mean(axis=0) - contrast[begin - _AROUND : begin].mean(
                axis=0
            )
            row["during_mm"] = _misplaced(during, cut, data)
            row["place_mm"] = _misplaced(_lasting(contrast, begin, end), cut, data)
        rows.append(row)
    return rows


def _lasting(values: Array, begin: int, end: int) -> Array:
    """Mean of the frames from `end` on less the mean of those up to `begin`."""
    after, before = values[end : end + _AROUND], values[begin - _AROUND : begin]
    return np.asarray(after.mean(axis=0) - before.mean(axis=0))


def _misplaced(change: Array, cut: Cut, data: Dataset) -> float:
    """Distance [mm] of a change (H, W) of the image from a cut; NaN where there is none."""
    place = locate(change[None], data.sensor)[0]
    return 1e3 * float(np.hypot(*(place - cut.place)))
