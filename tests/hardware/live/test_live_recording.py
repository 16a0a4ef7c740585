"""Recordings of a live view, without a server: frames, references, touched places, full disks."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from tests.support.waiting import wait_for

from eitbench.hardware.live import session
from eitbench.hardware.live.imaging import REFERENCE_FRAMES
from eitbench.hardware.live.viewer import LiveImage
from eitbench.hardware.recording.guided import StepDurations
from eitbench.hardware.recording.recorder import Recorder, RecorderError
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.suites.scenario import RecordedScenario
from eitbench.scenarios.suites.suite import load_suite

PLACES = [(0.03, 0.04), (0.07, 0.06)]
PLACE = (0.03, 0.06)


def test_a_slow_viewer_never_delays_the_recording(running: Any, board: Any) -> None:
    """Frames go on at the board's rate while one live_image takes forever."""
    stuck = threading.Event()

    def show(live_image: LiveImage) -> None:
        stuck.wait()
        running.images.append(live_image)

    running.show = show
    running.session.start_recording()
    try:
        wait_for(lambda: running.recording["frames"] > 60)
    finally:
        stuck.set()
    content = running.recorded()
    assert content.emulated
    assert (np.diff(content.number) == 1).all()
    for number, values in zip(content.number, content.values, strict=True):
        np.testing.assert_array_equal(values, board.sent[number].values)
    # What the viewer missed meanwhile is skipped, not shown late.
    wait_for(lambda: running.newest.frame.number > content.number[-1])


def test_a_recording_runs_until_its_file_is_whole(
    running: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who sees that it has ended opens its file."""
    states = []
    close = Recorder.close

    def closing(self: Recorder) -> None:
        states.append(running.recording["running"])
        close(self)

    monkeypatch.setattr(Recorder, "close", closing)
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    running.session.stop_recording()
    assert states[0]
    assert not running.recording["running"]


def test_a_full_disk_ends_the_recording_only(
    running: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Recorder, frame: Any) -> None:
        raise RecorderError("The recording was stopped, since the disk is full.")

    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "append", full)
        wait_for(lambda: running.recording["failed"])
    assert running.recording["failed"].endswith("the disk is full.")
    assert not running.recording["running"]
    count = len(running.images)
    wait_for(lambda: len(running.images) > count + 3)
    running.session._out = tmp_path / "again"  # files are named by the second
    running.session._out.mkdir()
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    assert len(running.recorded()) > 2


def test_a_reference_that_is_taken_while_recording_is_marked_in_the_file(running: Any) -> None:
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    before = running.session.imaging.reference
    running.session.take_reference()
    wait_for(lambda: running.session.imaging.reference is not before)
    content = running.recorded()
    assert running.session.imaging.reference is not None
    np.testing.assert_allclose(
        content.values[content.reference].mean(axis=0), running.session.imaging.reference.values
    )
    assert not check(Path(running.recording["file"]))[0]


@pytest.mark.parametrize("better", [False, True])
def test_a_refused_reference_is_marked_if_no_other_is(
    better: bool, running: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a reversed sign, say, it shows no touch; beside a better one it would spoil it."""

    def refuse(*_: object) -> NoReturn:
        raise InputError("All signs are reversed.")

    with monkeypatch.context() as patch:
        patch.setattr(session, "reference_of", refuse)
        running.session.start_recording()
        wait_for(lambda: running.session.state()["sentence"])
        first = running.recording["frames"]
    assert first >= REFERENCE_FRAMES
    if better:
        before = running.session.imaging.reference
        running.session.take_reference()
        wait_for(lambda: running.session.imaging.reference is not before)
    content = running.recorded()
    assert len(content.reference) == REFERENCE_FRAMES
    assert (content.reference.min() >= first - 1) == better


def test_no_reference_is_taken_from_a_touch(running: Any) -> None:
    running.session.start_recording()
    wait_for(lambda: running.session._reference_frames is None)
    running.session.touch(0.05, 0.05, 0.005, 2e4)
    with pytest.raises(InputError, match="Let go first"):
        running.session.take_reference()
    running.session.release()
    running.session.take_reference()


def test_only_one_recording_at_a_time(running: Any) -> None:
    running.session.start_recording()
    with pytest.raises(InputError, match="under way"):
        running.session.start_recording()


@pytest.fixture
def hold(running: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Hold a touch until it has settled, here after 0.1 s, and for so many frames more."""
    monkeypatch.setattr(StepDurations, "settle_s", 0.1)

    def wait(count: int) -> None:
        time.sleep(0.1)
        frames = running.recording["frames"]
        wait_for(lambda: running.recording["frames"] > frames + count)

    return wait


def test_touched_places_become_labels_and_the_recording_a_suite(
    running: Any, hold: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A touch counts once it has settled; its label holds the place that was pressed."""
    running.session.start_recording()
    wait_for(lambda: not running.session.state()["reference_left"])
    for x, y in PLACES:
        running.session.touch(x, y, 0.008, 30e3)
        hold(10)
        running.session.touch(x + 1e-4, y, 0.008, 30e3)  # a hand trembles
        running.session.release()
    monkeypatch.setattr(StepDurations, "settle_s", 100.0)
    running.session.touch(0.05, 0.05, 0.008, 30e3)  # too short to settle
    hold(3)
    running.session.release()
    assert running.recording["touches"] == 2
    content = running.recorded()
    found = content.labels[["x_m", "y_m"]].to_numpy()
    np.testing.assert_allclose(found, PLACES)
    untouched = content.values[content.reference].mean(axis=0)
    noise = np.linalg.norm(content.values[content.reference][0] - untouched)
    for first, last in zip(content.labels["first"], content.labels["last"], strict=True):
        assert last - first >= 5
        shown = np.linalg.norm(content.values[first : last + 1] - untouched, axis=1)
        assert (shown > 5 * noise).all()
    assert running.recording["suite"] == ""  # two touches do not say how images map to places
    suite = load_suite(Path(running.recording["file"]).with_suffix(".toml"))
    (own, _) = suite.scenarios
    assert isinstance(own, RecordedScenario)
    assert own.recorded_set.truth == "position"


def test_nothing_is_touched_while_a_recording_takes_its_reference(running: Any, board: Any) -> None:
    untouched = board._clean
    running.session.start_recording()
    with pytest.raises(InputError, match="Do not touch it yet"):
        running.session.touch(*PLACE, 0.008, 30e3)
    assert board._clean is untouched
    wait_for(lambda: not running.session.state()["reference_left"])
    running.session.touch(*PLACE, 0.008, 30e3)
    assert board._clean is not untouched


def test_a_touch_that_leaves_the_sensor_ends_and_has_no_label(
    running: Any, board: Any, hold: Any
) -> None:
    untouched = board._clean
    running.session.start_recording()
    wait_for(lambda: not running.session.state()["reference_left"])
    running.session.touch(*PLACE, 0.008, 30e3)
    hold(3)
    with pytest.raises(InputError, match=r"\(130, 60\) mm is outside the sensor, which reaches"):
        running.session.touch(0.13, 0.06, 0.008, 30e3)
    assert board._clean is untouched
    assert running.recorded().labels[["x_m", "y_m"]].to_numpy().tolist() == [list(PLACE)]


def test_an_impossible_frame_is_named_and_blamed_on_no_method(running: Any, board: Any) -> None:
    board.gain = 3e38
    wait_for(lambda: running.newest.failed)
    assert running.newest.failed.startswith("The frame holds ")
    assert running.newest.failed.endswith("where less than 1e+10 is possible.")
    running.session.take_reference()
    wait_for(lambda: running.session.state()["sentence"])
    assert running.session.state()["sentence"].startswith("A reference frame holds ")


def test_on_a_real_board_places_go_into_a_recording_alone(
    running: Any, board: Any, hold: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(board), "can_be_pressed", False)
    with pytest.raises(InputError, match="Start a recording first"):
        running.session.touch(*PLACES[0], 0.008, None)
    running.session.start_recording()
    wait_for(lambda: not running.session.state()["reference_left"])
    running.session.touch(*PLACES[0], 0.008, None)
    hold(3)
    running.session.release()
    assert running.recording["touches"] == 1
