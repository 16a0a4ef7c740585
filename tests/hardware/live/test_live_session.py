"""The threads of a live view, without a server: frames, references, methods, recordings, losses."""

import threading
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest
from tests.support.waiting import wait_for
from threadpoolctl import threadpool_info, threadpool_limits

from eitbench.hardware.board import BoardError, BoardLostError, Frame
from eitbench.hardware.live import session
from eitbench.hardware.live.imaging import (
    NEED_TRAINING_DATA,
    NO_DATA,
    ImageMaker,
    no_data,
    reference_of,
)
from eitbench.methods import Method, Problem, create, register
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import foam16

PLACE = (0.03, 0.06)


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


def test_a_touch_appears_where_it_is_made(running: Any, board: Any) -> None:
    assert list(running.newest.contacts) == []  # noise alone is no touch
    board.press(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.contacts)
    contact = running.newest.contacts[0]
    assert np.hypot(contact.x_m - PLACE[0], contact.y_m - PLACE[1]) < 0.005
    board.release()
    wait_for(lambda: not running.newest.contacts)


def test_methods_are_made_with_the_parameters_that_were_chosen(watch: Any, board: Any) -> None:
    """A heavier prior of NOSER makes a fainter image of the same touch."""

    def depth(weight: float) -> float:
        watched = watch(board, {"noser": {"weight": weight}})
        watched.session.start("noser")
        wait_for(lambda: watched.images and watched.newest.image is not None)
        board.press(*PLACE, 0.008, 20e3)
        wait_for(lambda: watched.newest.contacts)
        found = 1 - watched.newest.image.min()
        board.release()
        watched.session.stop()
        return float(found)

    assert depth(10.0) < 0.7 * depth(0.01)


@pytest.mark.parametrize("gain", [1.0, 3.7e-3])
def test_images_do_not_depend_on_the_units_of_the_board(
    watched: Any, board: Any, gain: float
) -> None:
    board.gain = gain
    watched.session.start("noser")
    wait_for(lambda: watched.images and watched.newest.image is not None)
    board.press(*PLACE, 0.008, 20e3)
    wait_for(lambda: watched.newest.contacts)
    assert 0.4 < watched.newest.image.min() < 0.8


def test_images_of_an_uneven_board_with_a_dead_electrode_are_those_of_a_run() -> None:
    sensor = replace(foam16(), image_shape=(20, 20))
    model = forward_model(sensor)
    touched = np.full(sensor.image_shape, model.background)
    touched[4:8, 4:8] *= 0.5
    gains = np.exp(0.3 * np.random.default_rng(0).standard_normal(sensor.n_measurements))
    gains *= 7.0 * ~(sensor.pattern.table == 5).any(axis=1)
    reference, frame = gains * model.voltages(model.background), gains * model.voltages(touched)

    parameters = {"gain_power": 1.0}
    in_a_run = create("noser", **parameters)
    in_a_run.fit(Problem(sensor, reference, no_data))
    maker = ImageMaker(sensor, {"noser": parameters})
    maker.fit("noser")
    maker.reference = reference_of(sensor, [reference, reference])
    live = maker.live_image(Frame(0, 0.0, 0.0, frame)).image
    assert live is not None
    np.testing.assert_allclose(live, in_a_run.reconstruct(frame[None])[0], rtol=1e-12)
    even = create("noser")
    even.fit(Problem(sensor, reference, no_data))
    assert np.abs(live - even.reconstruct(frame[None])[0]).max() > 0.01


def test_a_new_reference_hides_what_lies_on_the_sensor(running: Any, board: Any) -> None:
    board.press(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.contacts)
    running.session.take_reference()
    wait_for(lambda: not running.newest.contacts)
    assert running.session.state()["reference_left"] == 0


def test_a_reference_of_another_sensor_is_said(watched: Any, board: Any) -> None:
    board.gain = -1.0
    watched.session.start("noser")
    wait_for(lambda: "drive pattern" in str(watched.session.state()["sentence"]))
    board.gain = 1.0
    watched.session.take_reference()
    wait_for(lambda: watched.newest.image is not None)
    assert watched.session.state()["sentence"] == ""


def test_the_old_method_shows_until_the_new_one_is_ready(
    running: Any, board: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, fit = threading.Event(), Moody.fit

    def fit_later(self: Moody, problem: Any) -> None:
        go.wait()
        fit(self, problem)

    monkeypatch.setattr(Moody, "fit", fit_later)
    running.session.imaging.choose("test-moody")
    count = len(running.images)
    wait_for(lambda: len(running.images) > count + 5)
    assert running.newest.method == "noser"
    assert running.session.state()["fitting"] == "test-moody"
    go.set()
    wait_for(lambda: running.newest.method == "test-moody")
    assert running.session.state()["fitting"] == ""
    # One that raises costs the image of that frame, and the voltages go on.
    board.press(*PLACE, 0.008, 20e3)
    wait_for(lambda: running.newest.failed)
    assert running.newest.failed == "test-moody failed on this frame: ValueError: too much for it."
    assert running.newest.image is None
    board.release()
    wait_for(lambda: running.newest.image is not None)


def test_a_method_that_cannot_be_fitted_leaves_the_old_one(
    running: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Moody, "monday", True)
    running.session.imaging.choose("test-moody")
    wait_for(lambda: running.session.state()["method_failed"])
    assert running.session.state()["method_failed"] == (
        "test-moody cannot be used: RuntimeError: it is Monday."
    )
    count = len(running.images)
    wait_for(lambda: len(running.images) > count + 3)
    assert running.newest.method == "noser"
    assert running.newest.image is not None
    with pytest.raises(InputError, match="did you mean 'noser'"):
        running.session.imaging.choose("nose")
    for name in NEED_TRAINING_DATA:
        with pytest.raises(InputError, match=f"^{name} cannot be used live: it learns from sim"):
            running.session.imaging.choose(name)


@pytest.mark.parametrize("name", sorted(NEED_TRAINING_DATA))
def test_methods_that_are_said_to_learn_first_do(name: str) -> None:
    model = forward_model(foam16())
    problem = Problem(foam16(), model.voltages(model.background), no_data)
    with pytest.raises(InputError, match=NO_DATA):
        create(name).fit(problem)


def test_methods_compute_without_helper_threads(watched: Any) -> None:
    with threadpool_limits(2):
        watched.session.start("test-curious")
        wait_for(lambda: watched.images and watched.newest.image is not None)
        watched.session.stop()
        assert set(Curious.seen) == {1}
        assert len(Curious.seen) > 1
        assert most_threads() == 2


def test_a_board_that_is_lost_is_opened_again(
    running: Any, board: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "RETRY_S", 0.1)
    running.session.start_recording()
    wait_for(lambda: running.recording["frames"] > 2)
    board.unplug()
    wait_for(lambda: running.session.state()["board"] == "lost")
    assert running.session.state()["rate_hz"] == 0
    wait_for(lambda: running.session.state()["sentence"] == "There is no port.")
    board.plug()
    count = len(running.images)
    wait_for(lambda: len(running.images) > count + 3)
    assert running.session.state()["board"] == "running"
    assert running.newest.image is not None
    assert board.opened == 2
    content = running.recorded()
    assert list(content.events["text"]) == [
        "The board was lost: The board was unplugged.",
        "The board is back.",
    ]
    assert (np.diff(content.number) == 1).all()


@pytest.mark.parametrize("error", [BoardError("It speaks openeit."), RuntimeError("a bug")])
def test_no_error_of_a_board_stops_the_view(running: Any, board: Any, error: Exception) -> None:
    board.faulty = error
    wait_for(lambda: str(error) in str(running.session.state()["sentence"]))
    wait_for(lambda: running.session.state()["board"] == "running")
    count = len(running.images)
    wait_for(lambda: len(running.images) > count + 3)


def test_what_cannot_start_is_said_at_once(watched: Any, board: Any) -> None:
    with pytest.raises(InputError, match="Unknown method"):
        watched.session.start("nothing-like-it")
    assert board.opened == 0
    board.unplug()
    with pytest.raises(BoardLostError, match="no port"):
        watched.session.start("noser")


def test_rate_and_noise_are_measured(running: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "STATUS_S", 0.0)  # a figure of all frames so far
    wait_for(lambda: len(running.images) > 60)
    state: Any = running.session.state()
    assert state["snr_db"] == pytest.approx(60, abs=1)
    assert state["rate_hz"] > 0  # how it is computed: tests of recording
    assert state["reciprocity"] < 0.01
    assert state["suspects"] == []
