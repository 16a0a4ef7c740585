"""The threads of a live view, without a server: frames, references, methods, recordings, losses."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from eitbench.hardware.board import BoardError, BoardLostError
from eitbench.hardware.boards import make_board, make_emulator
from eitbench.hardware.guided import Timing
from eitbench.hardware.live.imaging import LEARN_FIRST
from eitbench.hardware.live.newest import Newest
from eitbench.hardware.live.picture import Picture
from eitbench.hardware.live.reference import NO_DATA, no_data
from eitbench.hardware.live.session import RETRY_S, Session
from eitbench.hardware.recorder import Recorder, RecorderError
from eitbench.methods import Method, Problem, create, register
from eitbench.scenarios.catalogue import foam16
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.checking import check
from eitbench.scenarios.recordings.recording_file import Content, read_file
from eitbench.scenarios.scenario import RecordedScenario
from eitbench.scenarios.suites import load_suite

PLACE = (0.03, 0.06)


class Watched:
    """A session with the pictures it has shown."""

    def __init__(self, board: Any, out: Path) -> None:
        self.pictures: list[Picture] = []
        self.show: Callable[[Picture], None] = self.pictures.append
        self.session = Session(
            board, "emulator", emulated=True, out=out, show=lambda picture: self.show(picture)
        )

    @property
    def recording(self) -> Any:
        """The state of the recording."""
        return self.session.state()["recording"]

    def recorded(self) -> Content:
        """End the recording, and read it."""
        self.session.stop_recording()
        content, condition = read_file(Path(self.recording["file"]))
        assert condition.complete
        assert len(content) == self.recording["frames"]
        return content

    @property
    def newest(self) -> Picture:
        return self.pictures[-1]


@pytest.fixture
def watched(board: Any, tmp_path: Path) -> Iterator[Watched]:
    watched = Watched(board, tmp_path)
    yield watched
    watched.session.stop()


@pytest.fixture
def running(watched: Watched, wait_for: Any) -> Watched:
    """A session that shows images."""
    watched.session.start("noser")
    wait_for(lambda: watched.pictures and watched.newest.image is not None)
    return watched


@register("test-moody")
class Moody(Method):
    """Fails on a frame of the touched sensor, and cannot be fitted on Mondays."""

    monday = False

    def fit(self, problem: Any) -> None:
        if self.monday:
            raise RuntimeError("it is Monday")
        self.problem = problem

    def reconstruct(self, voltages: Any) -> Any:
        if np.abs(self.problem.difference(voltages)).max() > 0.01:
            raise ValueError("too much for it")
        return np.ones((len(voltages), 80, 80))


def most_threads() -> int:
    """Threads that linear algebra may use."""
    return max(int(pool["num_threads"]) for pool in threadpool_info() if pool["user_api"] == "blas")


@register("test-curious")
class Curious(Method):
    """Notes how many threads it may use."""

    seen: ClassVar[list[int]] = []

    def fit(self, problem: Any) -> None:
        self.seen.append(most_threads())

    def reconstruct(self, voltages: Any) -> Any:
        self.seen.append(most_threads())
        return np.ones((len(voltages), 80, 80))


def test_a_slot_holds_the_newest_value_once() -> None:
    slot: Newest[int] = Newest()
    assert slot.take(0.0) is None
    slot.put(1)
    slot.put(2)
    assert slot.take(0.0) == 2
    assert slot.take(0.0) is None


def test_a_touch_appears_where_it_is_made(running: Watched, board: Any, wait_for: Any) -> None:
    assert list(running.newest.contacts) == []  # noise alone is no touch
    board.touch(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.contacts)
    contact = running.newest.contacts[0]
    assert np.hypot(contact.x_m - PLACE[0], contact.y_m - PLACE[1]) < 0.005
    board.release()
    wait_for(lambda: not running.newest.contacts)


@pytest.mark.parametrize("gain", [1.0, 3.7e-3])
def test_images_do_not_depend_on_the_units_of_the_board(
    watched: Watched, board: Any, wait_for: Any, gain: float
) -> None:
    board.gain = gain
    watched.session.start("noser")
    wait_for(lambda: watched.pictures and watched.newest.image is not None)
    board.touch(*PLACE, 0.008, 20e3)
    wait_for(lambda: watched.newest.contacts)
    assert 0.4 < watched.newest.image.min() < 0.8  # type: ignore[union-attr]


def test_a_new_reference_hides_what_lies_on_the_sensor(
    running: Watched, board: Any, wait_for: Any
) -> None:
    board.touch(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.contacts)
    running.session.take_reference()
    wait_for(lambda: not running.newest.contacts)
    assert running.session.state()["reference_left"] == 0


def test_a_reference_of_another_sensor_is_said(watched: Watched, board: Any, wait_for: Any) -> None:
    board.gain = -1.0
    watched.session.start("noser")
    wait_for(lambda: "drive pattern" in str(watched.session.state()["sentence"]))
    board.gain = 1.0
    watched.session.take_reference()
    wait_for(lambda: watched.newest.image is not None)
    assert watched.session.state()["sentence"] == ""


def test_the_old_method_shows_until_the_new_one_is_ready(
    running: Watched, board: Any, wait_for: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, fit = threading.Event(), Moody.fit

    def fit_later(self: Moody, problem: Any) -> None:
        go.wait()
        fit(self, problem)

    monkeypatch.setattr(Moody, "fit", fit_later)
    running.session.imaging.choose("test-moody")
    count = len(running.pictures)
    wait_for(lambda: len(running.pictures) > count + 5)
    assert running.newest.method == "noser"
    assert running.session.state()["fitting"] == "test-moody"
    go.set()
    wait_for(lambda: running.newest.method == "test-moody")
    assert running.session.state()["fitting"] == ""
    # One that raises costs that picture's image, and the voltages go on.
    board.touch(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.failed)
    assert running.newest.failed == "test-moody failed on this frame: ValueError: too much for it."
    assert running.newest.image is None
    board.release()
    wait_for(lambda: running.newest.image is not None)


def test_a_method_that_cannot_be_fitted_leaves_the_old_one(
    running: Watched, wait_for: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Moody, "monday", True)
    running.session.imaging.choose("test-moody")
    wait_for(lambda: running.session.state()["method_failed"])
    assert running.session.state()["method_failed"] == (
        "test-moody cannot be used: RuntimeError: it is Monday."
    )
    count = len(running.pictures)
    wait_for(lambda: len(running.pictures) > count + 3)
    assert running.newest.method == "noser"
    assert running.newest.image is not None
    with pytest.raises(InputError, match="did you mean 'noser'"):
        running.session.imaging.choose("nose")
    for name in LEARN_FIRST:
        with pytest.raises(InputError, match=f"^{name} cannot be used live: it learns from sim"):
            running.session.imaging.choose(name)


@pytest.mark.parametrize("name", sorted(LEARN_FIRST))
def test_methods_that_are_said_to_learn_first_do(name: str) -> None:
    model = forward_model(foam16())
    problem = Problem(foam16(), model.voltages(model.background), no_data)
    with pytest.raises(InputError, match=NO_DATA):
        create(name).fit(problem)


def test_methods_compute_without_helper_threads(watched: Watched, wait_for: Any) -> None:
    with threadpool_limits(2):
        watched.session.start("test-curious")
        wait_for(lambda: watched.pictures and watched.newest.image is not None)
        watched.session.stop()
        assert set(Curious.seen) == {1}
        assert len(Curious.seen) > 1
        assert most_threads() == 2


def test_a_slow_viewer_never_delays_the_recording(
    running: Watched, board: Any, wait_for: Any
) -> None:
    """Frames go on at the board's rate while one picture takes forever."""
    stuck = threading.Event()

    def show(picture: Picture) -> None:
        stuck.wait()
        running.pictures.append(picture)

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


def test_a_full_disk_ends_the_recording_only(
    running: Watched, wait_for: Any, monkeypatch: pytest.MonkeyPatch
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
    count = len(running.pictures)
    wait_for(lambda: len(running.pictures) > count + 3)
    time.sleep(1.1)  # files are named by the second
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    assert len(running.recorded()) > 2


def test_a_reference_that_is_taken_while_recording_is_marked_in_the_file(
    running: Watched, wait_for: Any
) -> None:
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


def test_a_board_that_is_lost_is_opened_again(running: Watched, board: Any, wait_for: Any) -> None:
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    board.unplug()
    wait_for(lambda: running.session.state()["board"] == "lost")
    assert running.session.state()["sentence"] in ("The board was unplugged.", "There is no port.")
    assert running.session.state()["rate_hz"] == 0
    time.sleep(RETRY_S)
    board.plug()
    count = len(running.pictures)
    wait_for(lambda: len(running.pictures) > count + 3)
    assert running.session.state()["board"] == "running"
    assert running.newest.image is not None
    assert board.opened == 2
    content = running.recorded()
    assert list(content.events["text"]) == [
        "The board was lost: The board was unplugged.",
        "The board is back.",
    ]
    assert (np.diff(content.number) == 1).all()


def test_a_serial_port_that_is_gone_is_an_unplugged_board(tmp_path: Path, wait_for: Any) -> None:
    emulator = make_emulator(None, "teensy", None, 2.0)
    emulator.switch_on()
    port = emulator.port
    watched = Watched(make_board("teensy", port=port), tmp_path)
    try:
        watched.session.start("noser")
        wait_for(lambda: watched.pictures)
        emulator.switch_off()
        wait_for(lambda: "plug it in. (" in str(watched.session.state()["sentence"]))
        sentence = str(watched.session.state()["sentence"])
        assert sentence.startswith("The board is unplugged: plug it in. (There is no serial port")
    finally:
        watched.session.stop()
        emulator.switch_off()


@pytest.mark.parametrize("error", [BoardError("It speaks openeit."), RuntimeError("a bug")])
def test_no_error_of_a_board_stops_the_view(
    running: Watched, board: Any, wait_for: Any, error: Exception
) -> None:
    board.faulty = error
    wait_for(lambda: str(error) in str(running.session.state()["sentence"]))
    wait_for(lambda: running.session.state()["board"] == "running")
    count = len(running.pictures)
    wait_for(lambda: len(running.pictures) > count + 3)


def test_what_cannot_start_is_said_at_once(watched: Watched, board: Any) -> None:
    with pytest.raises(InputError, match="Unknown method"):
        watched.session.start("nothing-like-it")
    assert board.opened == 0
    board.unplug()
    with pytest.raises(BoardLostError, match="no port"):
        watched.session.start("noser")


def test_only_one_recording_at_a_time(running: Watched) -> None:
    running.session.start_recording()
    with pytest.raises(InputError, match="under way"):
        running.session.start_recording()


def test_rate_and_noise_are_measured(running: Watched, wait_for: Any) -> None:
    wait_for(lambda: len(running.pictures) > 60)
    state: Any = running.session.state()
    assert state["snr_db"] == pytest.approx(60, abs=1)
    assert 10 < state["rate_hz"] < 55
    assert state["reciprocity"] < 0.01
    assert state["suspects"] == []


PLACES = [(0.03, 0.04), (0.07, 0.06)]


def test_touched_places_become_labels_and_the_recording_a_suite(
    running: Watched, wait_for: Any
) -> None:
    """A touch counts once it has settled; what the page marks is what the board was pressed at."""
    running.session.start_recording()
    wait_for(lambda: not running.session.state()["reference_left"])
    for x, y in PLACES:
        running.session.touch(x, y, 0.008, 30e3)
        time.sleep(Timing.settle_s + 0.3)
        running.session.touch(x + 1e-4, y, 0.008, 30e3)  # a hand trembles
        running.session.release()
        time.sleep(0.1)
    running.session.touch(0.05, 0.05, 0.008, 30e3)  # too short to settle
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
    suite = load_suite(Path(running.recording["suite"]))
    (own, _) = suite.scenarios
    assert isinstance(own, RecordedScenario)
    assert own.recorded_set.truth == "position"


def test_nothing_is_touched_while_a_recording_takes_its_reference(
    running: Watched, board: Any, wait_for: Any
) -> None:
    untouched = board._clean
    running.session.start_recording()
    with pytest.raises(InputError, match="Do not touch it yet"):
        running.session.touch(*PLACE, 0.008, 30e3)
    assert board._clean is untouched
    wait_for(lambda: not running.session.state()["reference_left"])
    running.session.touch(*PLACE, 0.008, 30e3)
    assert board._clean is not untouched


def test_on_a_real_board_places_go_into_a_recording_alone(
    running: Watched, board: Any, wait_for: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(type(board), "touch")
    with pytest.raises(InputError, match="Start a recording first"):
        running.session.touch(*PLACES[0], 0.008, None)
    running.session.start_recording()
    wait_for(lambda: not running.session.state()["reference_left"])
    running.session.touch(*PLACES[0], 0.008, None)
    time.sleep(Timing.settle_s + 0.2)
    running.session.release()
    assert running.recording["touches"] == 1
