"""A skin that drifts during a guided session: a reference for each touch, and one for all."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from tests.support.pressed_skin import SKIN

from eitbench.benchmark.metrics.evaluation import evaluate, fit_registration
from eitbench.hardware.board import Board, Frame
from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor, Touch
from eitbench.hardware.recording.exchange import write_recording
from eitbench.hardware.recording.guided import GuidedSession, StepDurations
from eitbench.hardware.recording.recorder import Recorder
from eitbench.methods import Problem, create
from eitbench.methods.method import reconstructed
from eitbench.scenarios import load
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.suites.scenario import RecordedScenario

TOUCHES = 20
STEP_S = 20.0  # from a press to its release, and to the next press, on the sensor's own clock


class SlowBoard(Board):
    """The emulated sensor on a clock of its own, so that minutes of drift take no time."""

    can_be_pressed: ClassVar[bool] = True

    def __init__(self, drift: float) -> None:
        super().__init__(SKIN, emulated=True)
        self._behind = EmulatedSensor(SKIN)
        worse = {"drift": drift}
        self._behind.imperfections = self._behind.imperfections.model_copy(update=worse)
        self._touches: list[Touch] = []
        self._count, self._time_s = 0, 0.0
        self._lock = threading.Lock()

    def press(self, x_m: float, y_m: float, radius_m: float, pressure_pa: float) -> None:
        with self._lock:
            self._touches = [Touch(x_m, y_m, radius_m, pressure_pa)]
            self._time_s += STEP_S

    def release(self) -> None:
        with self._lock:
            self._touches = []
            self._time_s += STEP_S

    def frames(self, wait_s: float) -> list[Frame]:
        with self._lock:
            self._count += 1
            values = self._behind.frame(self._time_s, self._touches)
            return [Frame(self._count, self._time_s, self._time_s, values)]

    def open(self) -> None: ...
    def start(self) -> None: ...
    def stop(self) -> None: ...
    def close(self) -> None: ...


def session(path: Path, drift: float) -> None:
    """A guided session of touches at random places, recorded at `path`."""
    places = np.random.default_rng(3).uniform([20, 20], [80, 60], (TOUCHES, 2))
    answers = iter(["", "1", "", *(f"{x:.3f} {y:.3f}" for x, y in places), ""])
    durations = StepDurations(reference_s=0.02, settle_s=0, hold_s=0, released_s=0)
    with SlowBoard(drift) as board, Recorder(path, SKIN, "emulator", emulated=True) as recorder:
        guided = GuidedSession(board, recorder, lambda _: next(answers), lambda _: None, durations)
        guided.run()


def error_mm(path: Path) -> float:
    """Median error of the place by NOSER [mm]."""
    scenario = RecordedScenario(name="touch", recording=str(path))
    test, validation = (load(scenario, split=split) for split in ("test", "validation"))
    method, problem = create("noser"), Problem(test.sensor, test.references[0], _no_training)
    method.fit(problem)
    registration = fit_registration(validation, reconstructed(method, problem, validation))
    found = evaluate(test, reconstructed(method, problem, test), registration)
    return float(found["localisation_mm"].median())


def _no_training(split: str, limit: int | None) -> Dataset:
    raise AssertionError("NOSER learns nothing")


@pytest.mark.nightly
def test_a_reference_for_each_touch_follows_the_drift(tmp_path: Path) -> None:
    """Of 10 % in a quarter of an hour; by one of 1 % neither is much better than the other."""
    session(tmp_path / "own.h5", drift=0.1)
    content, _ = read_file(tmp_path / "own.h5")
    assert (content.labels["reference_first"] != -1).all()
    one_for_all = content.labels.assign(reference_first=-1, reference_last=-1)
    write_recording(replace(content, labels=one_for_all), tmp_path / "one.h5")
    own, one = error_mm(tmp_path / "own.h5"), error_mm(tmp_path / "one.h5")
    assert own < 1.5
    assert one > 2 * own
