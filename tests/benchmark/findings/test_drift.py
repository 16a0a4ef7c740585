"""Errors over time, and alarms of a skin that was cut."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.findings.drift import (
    _AROUND,
    ALARMS_FILE,
    DAMAGE,
    PARTS,
    RAW,
    alarms,
    over_time,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.recordings.public.hydrogel import CUTS
from eitbench.scenarios.suites.suite import load_suite, scenario_by_name

N = 100


@dataclass(frozen=True, eq=False)
class MadeRun(Run):
    images: NDArray[np.float32] | None = None

    def estimates(
        self, scenario: str, method: str, samples: Sequence[int]
    ) -> NDArray[np.float32] | None:
        return self.images


def made(
    scenario: str, columns: Mapping[str, Any], n: int, images: NDArray[np.float32] | None = None
) -> Run:
    samples = pd.DataFrame(
        {"suite": "drift", "scenario": scenario, "method": "made", "sample": np.arange(n)}
    ).assign(status="ok", **columns)
    manifest = {
        "plan": {"suite": load_suite("drift").model_dump(mode="json")},
        "data": {scenario: {"n": n}},
    }
    return MadeRun(Path("run"), METHOD_RUNS, manifest, samples, pd.DataFrame(), {}, images=images)


def test_the_error_of_each_fifth_is_the_median_of_its_presses() -> None:
    error = np.repeat([4.0, 5.0, 9.0, 8.0, 30.0], N // PARTS) + np.tile(
        [-1.0, 0.0, 0.0, 1.0], N // 4
    )
    run = made("ohmc16-start", {"localisation_mm": error, "expected_x_m": 0.0}, N)
    # The number of a sample is its place in time, not its row.
    shuffled = replace(run, samples=run.samples.sample(frac=1, random_state=0))
    for found in (over_time(run), over_time(shuffled)):
        assert found["error_mm"].tolist() == [4.0, 5.0, 9.0, 8.0, 30.0]
        assert found["part"].tolist() == [1, 2, 3, 4, 5]
        assert found["n"].eq(N // PARTS).all()
        assert found["low"].le(found["error_mm"]).all()
        assert found["high"].sub(found["low"]).le(2).all()


def test_touches_of_two_contacts_and_few_presses_have_no_course() -> None:
    known = {"localisation_mm": 5.0, "expected_x_m": 0.0}
    assert over_time(made("ohmc16", known | {"contacts": 2}, N)).empty
    assert over_time(made("ohmc16", known, 40)).empty
    assert over_time(made("presses", known, N)).empty  # simulated, or of another suite


def test_alarms_of_the_raw_voltages_and_of_an_image_that_is_right(
    recorded_data: Path, tmp_path: Path
) -> None:
    """The made image shows a slow drift all over, each cut at its place, and a scar of it."""
    data = load(scenario_by_name(DAMAGE))
    first = round(data.samples["time_s"].iloc[0] / 8)
    number = first + np.arange(len(data))
    x, y = data.sensor.pixel_centres
    contrast = 1e-6 * number[:, None, None] * np.ones(data.sensor.image_shape)
    for cut in CUTS:
        spot = np.exp(-((x - cut.place[0]) ** 2 + (y - cut.place[1]) ** 2) / (2 * 0.005**2))
        during = (number >= cut.first) & (number < cut.after)
        scar = number >= cut.after
        contrast += (1.0 * during + 0.2 * scar)[:, None, None] * spot
    images = (data.sensor.background + contrast).astype(np.float32)
    run = made(DAMAGE, {}, len(data), images)
    found = alarms(run)
    assert found["false_start"].eq(1).all()  # drift
    assert found["delay_s"].eq(0).all()
    raw, shown = found[found["method"] == RAW], found[found["method"] == "made"]
    assert len(raw) == len(shown) == len(CUTS)
    # Of a steady drift all changes are alike, so that rounding decides on false alarms.
    assert raw["false_before"].le(0.02).all()
    assert raw["during_mm"].isna().all()
    assert shown["during_mm"].lt(2).all()
    assert shown["place_mm"].lt(2).all()
    assert shown["lasting"].gt(10).all()
    # A record keeps the table, and needs neither images nor the recording.
    record = replace(run, path=tmp_path, samples=run.samples[:0])
    found.to_parquet(tmp_path / ALARMS_FILE)
    pd.testing.assert_frame_equal(alarms(record), found)
    found.drop(columns="cut").to_parquet(tmp_path / ALARMS_FILE)
    with pytest.raises(DataCorruptError, match="does not hold the alarms"):
        alarms(record)


def test_the_delay_is_that_from_the_first_frame_of_a_cut_to_its_alarm(recorded_data: Path) -> None:
    data = load(scenario_by_name(DAMAGE))
    number = round(data.samples["time_s"].iloc[0] / 8) + np.arange(len(data))
    drift = 1e-6 * np.random.default_rng(0).standard_normal(len(data)).cumsum()
    longer = [cut for cut in CUTS if cut.after - cut.first > 1]
    assert longer
    for late in (0, 1):
        seen = np.zeros(len(data))
        for cut in CUTS:
            seen += (number >= cut.first + late) & (number < cut.after)
        contrast = (drift + seen)[:, None, None] * np.ones(data.sensor.image_shape)
        images = (data.sensor.background + contrast).astype(np.float32)
        found = alarms(made(DAMAGE, {}, len(data), images))
        delays = found[found["method"] == "made"].set_index("cut")["delay_s"]
        assert delays[[cut.letter for cut in longer]].eq(8.0 * late).all()


def test_no_window_around_a_cut_holds_another_one() -> None:
    for earlier, later in pairwise(CUTS):
        assert later.first - earlier.after >= _AROUND


def test_a_cut_without_a_change_gives_no_alarm(recorded_data: Path) -> None:
    data = load(scenario_by_name(DAMAGE))
    noise = np.random.default_rng(0).normal(0, 1e-3, (len(data), *data.sensor.image_shape))
    images = (data.sensor.background + noise).astype(np.float32)
    found = alarms(made(DAMAGE, {}, len(data), images))
    found = found[found["method"] == "made"]
    # Nine frames are cut in all; one in a hundred gives a false alarm.
    assert found["delay_s"].isna().sum() >= 2
    assert found["lasting"].lt(1.5).all()
    assert found["false_before"].lt(0.06).all()


def test_a_run_without_a_cut_skin_has_no_alarms() -> None:
    assert alarms(made("ohmc16", {}, N)).empty
    assert alarms(made(DAMAGE, {}, 10)).empty  # too short to hold a cut
