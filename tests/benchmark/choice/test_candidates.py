"""What is tried on which sensor."""

from pathlib import Path

import pytest

from eitbench.benchmark.choice.candidates import (
    CANDIDATES,
    DRIFT,
    LEFT_OUT,
    TOUCHES,
    candidates,
    scenarios_of,
)
from eitbench.methods.registry import methods
from eitbench.scenarios.sensors.sensor import foam16
from eitbench.scenarios.suites.scenario import RecordedScenario, SimulatedScenario


def test_every_built_in_method_is_tried_or_left_out_for_a_reason() -> None:
    own = {name for name, cls in methods().items() if cls.__module__.startswith("eitbench.")}
    assert own == {*CANDIDATES, *LEFT_OUT}
    assert not {*CANDIDATES} & {*LEFT_OUT}


def test_methods_without_weights_are_named_and_cheap_ones_come_first() -> None:
    names, unusable = candidates([], foam16())
    assert names == [name for name in CANDIDATES if name != "tank-unet"]
    assert list(unusable) == ["tank-unet"]
    assert candidates(["tv", "noser"], foam16()) == (["noser", "tv"], {})


def test_a_sensor_is_touched_in_simulation_from_another_mesh() -> None:
    suite, note = scenarios_of("foam16", 60.0)
    touches, drift = suite.scenarios
    assert (touches.name, drift.name, note) == (TOUCHES, DRIFT, "")
    assert isinstance(touches, SimulatedScenario)
    assert isinstance(drift, SimulatedScenario)
    assert not touches.inverse_crime
    # They differ in nothing but the age of the reference frame.
    fresh = drift.imperfections.model_copy(
        update={"reference_age_s": touches.imperfections.reference_age_s}
    )
    assert drift.model_copy(update={"name": TOUCHES, "imperfections": fresh}) == touches
    assert drift.imperfections != touches.imperfections


def test_labelled_frames_of_a_set_come_first(recorded_data: Path) -> None:
    suite, note = scenarios_of("ohmc16", 60.0)
    assert [scenario.name for scenario in suite.scenarios] == ["frames", TOUCHES, DRIFT]
    frames, touches, drift = suite.scenarios
    assert isinstance(frames, RecordedScenario)
    assert isinstance(drift, RecordedScenario)
    assert drift.recording == "ohmc16-start"
    assert scenarios_of("ohmc8", 60.0)[0].scenarios[-1].kind == "simulated"
    assert frames.nominal_sensor == touches.nominal_sensor
    assert note == ""


@pytest.mark.slow
def test_too_few_objects_leave_the_simulation(recorded_data: Path) -> None:
    suite, note = scenarios_of("ktc2023-level7", 60.0)
    assert [scenario.name for scenario in suite.scenarios] == [TOUCHES, DRIFT]
    assert "fewer than 10, too few to tell methods apart" in note


def test_frames_that_cannot_be_had_leave_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path))
    suite, note = scenarios_of("ohmc8", 60.0)
    assert [scenario.name for scenario in suite.scenarios] == [TOUCHES, DRIFT]
    assert note.startswith("Its labelled frames are left out: ")
