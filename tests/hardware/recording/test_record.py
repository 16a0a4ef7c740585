"""Recording a board: status, unplugging, guided sessions."""

import re
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.waiting import wait_for

from eitbench.hardware.board import BoardError, Frame
from eitbench.hardware.emulation.emulator import Emulator
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording import loop
from eitbench.hardware.recording.guided import (
    SUITE_METHODS,
    GuidedSession,
    StepDurations,
    registration_lacks,
    suite_path,
    write_suite,
)
from eitbench.hardware.recording.loop import FrameRenumbering, Monitor, Status, record
from eitbench.hardware.recording.recorder import Recorder, RecorderError
from eitbench.methods.registry import methods
from eitbench.scenarios import forward_model, load_suite, sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import RecordedScenario

Frames = Callable[[int], list[Frame]]
Make = Callable[[Sequence[Frame]], Any]


def of_foam(n: int, snr_db: float, *, first: int = 0, noisy: int | None = None) -> list[Frame]:
    """Frames of the untouched default sensor, ten a second."""
    foam = sensor("foam16")
    clean = forward_model(foam).voltages(np.ones(foam.image_shape))
    src, _, a, b = foam.pattern.table.T
    draws = np.random.default_rng(first)
    size = np.sqrt(np.mean(clean**2)) * 10 ** (-snr_db / 20)
    values = clean + size * draws.normal(size=(n, len(clean)))
    if noisy is not None:
        extra = 10 * size * draws.normal(size=(n, 16))
        values += extra[:, src] * ((a == noisy).astype(float) - (b == noisy))
    return [Frame(first + k, k / 10, 100 + k / 10, v) for k, v in enumerate(values)]


def test_status_says_what_is_seen() -> None:
    monitor = Monitor(sensor("foam16"))
    assert monitor.status(0, 104.3).line() == (
        "0 frames -/s  SNR - dB  0 lost  0 bad  recip. -%  suspect -"
    )
    monitor.add(of_foam(40, 60))
    monitor.add([Frame(43, 4.3, 104.3, of_foam(1, 60)[0].values)])
    status = monitor.status(damaged=2, now_s=104.3)
    assert (status.frames, status.dropped, status.damaged, status.suspects) == (41, 3, 2, ())
    assert status.rate_hz == pytest.approx(40 / 4.3)
    assert status.snr_db == pytest.approx(60, abs=0.5)
    assert status.reciprocity < 1e-3
    assert "SNR 60 dB  3 lost  2 bad  recip. 0.0%" in status.line()


def test_the_rate_falls_where_no_more_frames_come() -> None:
    monitor = Monitor(sensor("foam16"))
    monitor.add(of_foam(40, 60))
    assert monitor.status(0, 103.9).rate_hz == pytest.approx(10)
    assert monitor.status(0, 104.0).rate_hz == pytest.approx(10)  # the next one is due
    assert monitor.status(0, 113.9).rate_hz == pytest.approx(39 / 13.8)


def test_few_frames_tell_the_noise_as_many_do() -> None:
    for n in (5, 10, 50):
        monitor = Monitor(sensor("foam16"))
        monitor.add(of_foam(n, 60))
        assert monitor.status(0, 105.0).snr_db == pytest.approx(60, abs=0.6), n


def test_a_board_that_starts_anew_by_itself_is_numbered_on() -> None:
    renumber = FrameRenumbering()
    sent = [(5, 9.0, 100.0), (6, 9.1, 100.1), (0, 0.0, 103.0), (1, 0.1, 103.1), (1, 0.2, 103.2)]
    found = [renumber(Frame(number, at, got, np.zeros(1))) for number, at, got in sent]
    assert [frame.number for frame in found] == [5, 6, 7, 8, 8]
    np.testing.assert_allclose([f.time_s for f in found], [9.0, 9.1, 12.0, 12.1, 12.2])


def test_status_names_a_noisy_electrode() -> None:
    monitor = Monitor(sensor("foam16"))
    monitor.add(of_foam(50, 60, noisy=7))
    assert monitor.status(0, 104.3).suspects == (7,)
    assert monitor.status(0, 104.3).line().endswith("suspect 7")


def test_a_long_status_fits_in_a_terminal() -> None:
    status = Status(99_999, 100.0, 60.2, 999, 9, 0.123, tuple(range(15, -1, -1)))
    assert len(status.line()) <= 80
    assert status.line().endswith("recip. 12.3%  suspect 15,14+14")


def test_frames_without_numbers_do_not_stop_the_status(skin: Sensor) -> None:
    monitor = Monitor(skin)
    monitor.add([Frame(k, k, k, np.full(40, np.nan)) for k in range(5)])
    assert monitor.status(0, 104.3).frames == 5
    assert np.isnan(monitor.status(0, 104.3).snr_db)


def test_everything_a_board_sends_is_recorded(
    tmp_path: Path, skin: Sensor, frames: Frames, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, shown = board(frames(60)), list[Status]()
    monkeypatch.setattr(loop, "STATUS_S", 0.0)
    with Recorder(tmp_path / "a.h5", skin, "fake") as recorder:
        last = record(made, recorder, show=shown.append)
    content, _ = read_file(tmp_path / "a.h5")
    assert np.array_equal(content.values, [f.values for f in frames(60)])
    assert last.frames == 60
    # Later, no more frames have come.
    assert replace(shown[-1], rate_hz=last.rate_hz) == last
    assert last.rate_hz < shown[-1].rate_hz
    assert made.calls == ["start", "stop"]


def test_a_board_that_is_back_and_cannot_be_used_says_why_once(
    tmp_path: Path, skin: Sensor, frames: Frames, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "RETRY_S", 0.01)
    made, said = board(frames(7)), list[str]()
    made.lost_after, made.refusals = 2, 3
    made.refusal = BoardError("The port is in use by another program.")
    with Recorder(tmp_path / "a.h5", skin, "fake") as recorder:
        record(made, recorder, say=said.append)
    assert said[1:] == ["The port is in use by another program.", "The board is back."]


def test_a_board_that_goes_away_is_waited_for(
    tmp_path: Path, skin: Sensor, frames: Frames, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "RETRY_S", 0.01)
    before = frames(4)
    # It counts from zero again, seven seconds later.
    after = [Frame(k, k / 10, 12.5 + k / 10, f.values) for k, f in enumerate(frames(3))]
    made, said = board([*before, *after]), list[str]()
    made.lost_after, made.refusals, made.health.damaged = 2, 3, 4
    with Recorder(tmp_path / "a.h5", skin, "fake") as recorder:
        assert record(made, recorder, say=said.append).damaged == 4
    content, _ = read_file(tmp_path / "a.h5")
    assert said == ["The board is gone. Waiting for it to return.", "The board is back."]
    assert content.events["text"].tolist() == said
    assert made.calls.count("open") == 4
    assert content.number.tolist() == list(range(7))
    # The clock goes on as that of this machine did: 5.3 s was the last, 12.5 s the next.
    assert content.time_s.tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 7.5, 7.6, 7.7])
    assert not any("goes back" in problem for problem in check(tmp_path / "a.h5")[0])


def test_a_board_that_stays_away_does_not_outlast_the_time(
    tmp_path: Path, skin: Sensor, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "RETRY_S", 0.01)
    made = board([])
    made.lost_after, made.refusals, made.endless = 0, 10**6, True
    made.health.damaged = 3
    seen = list[Status]()
    with (
        pytest.raises(RecorderError, match="Not one frame arrived"),
        Recorder(tmp_path / "a.h5", skin, "fake") as recorder,
    ):
        seen.append(record(made, recorder, seconds=0.1))
    assert [(status.frames, status.damaged) for status in seen] == [(0, 3)]
    assert made.calls.count("open") >= 1


def another_protocol(wait_s: float) -> list[Frame]:
    raise BoardError("It speaks another protocol.")


def test_a_board_of_another_kind_ends_the_recording(
    tmp_path: Path, skin: Sensor, frames: Frames, board: Make
) -> None:
    made = board(frames(2))
    made.frames = another_protocol
    with (
        pytest.raises(BoardError, match="another protocol"),
        Recorder(tmp_path / "a.h5", skin, "fake") as recorder,
    ):
        record(made, recorder)
    assert made.calls == ["start", "stop"]


def endless() -> Iterator[Frame]:
    made = of_foam(50, 60)
    k = 0
    while True:
        yield Frame(k, k / 100, time.monotonic(), made[k % 50].values)
        k += 1


def guided(
    path: Path, board: Make, answers: Sequence[str], *, n: int = 4000
) -> tuple[int, list[str], list[str]]:
    """Touches, what was asked and what was said in a session with these answers."""
    stream = endless()
    made = board([next(stream) for _ in range(n)])
    made.sensor, made.wait_s = sensor("foam16"), 0.01
    asked, said, left = list[str](), list[str](), list(answers)

    def ask(question: str) -> str:
        asked.append(question)
        return left.pop(0)

    timing = StepDurations(0.05, settle_s=0.01, hold_s=0.02, released_s=0.02)
    with Recorder(path, made.sensor, "fake") as recorder:
        guide = GuidedSession(made, recorder, ask, said.append, timing)
        guide.run()
    assert not left
    return guide.touches, asked, [sentence for sentence in said if "SNR" not in sentence]


def test_a_guided_session_ends_in_a_set(tmp_path: Path, board: Make) -> None:
    path = tmp_path / "touch.h5"
    places = [(20, 30), (50.5, 30), (80, 30), (20, 70), (50, 70), (80, 70)]
    answers = ["", "2", "4"]
    for x, y in places:
        answers += [f"{x}, {y}", "", "", "", ""]
    touches, asked, said = guided(path, board, [*answers, ""])
    assert touches == 12
    assert asked[0] == "Leave the sensor untouched, and press Enter"
    assert asked[4] == "Touch (20, 30) mm, hold still, and press Enter"
    assert said[-1] == "12 touches so far."
    content, condition = read_file(path)
    assert condition.complete
    assert len(content.reference) >= 1
    labels = content.labels
    assert labels["x_m"].tolist() == pytest.approx(np.repeat([p[0] / 1e3 for p in places], 2))
    assert labels["state"].tolist()[2:4] == ["50.5 30", "50.5 30"]
    assert set(labels["depth_mm"]) == {4.0}
    assert (labels["last"] >= labels["first"]).all()
    # Each touch has a reference of its own, after the touch before and before its own.
    assert (labels["reference_last"] >= labels["reference_first"]).all()
    assert (labels["reference_last"] < labels["first"]).all()
    assert (labels["reference_first"].to_numpy()[1:] > labels["last"].to_numpy()[:-1]).all()
    assert (labels["first"].to_numpy()[1:] > labels["last"].to_numpy()[:-1]).all()
    assert check(path)[0] == []

    write_suite(suite_path(path), path, sensor("foam16"), "fake", emulated=False)
    suite = load_suite(tmp_path / "touch.toml")
    own, public = suite.scenarios
    assert isinstance(own, RecordedScenario)
    assert (own.name, own.recording, public.name) == ("touch", str(path.resolve()), "ohmc16")
    assert own.recorded_set.truth == "position"
    assert set(SUITE_METHODS) <= set(methods())
    with pytest.raises(InputError, match="exists already"):
        suite_path(path)


def test_touches_of_one_place_do_not_say_how_images_map(tmp_path: Path, board: Make) -> None:
    answers = ["", "1", ""]
    for newtons in range(1, 12):  # harder and harder
        answers += [f"30 30 {newtons}", "", ""]
    touches, _, said = guided(tmp_path / "a.h5", board, [*answers, ""])
    assert touches == 11
    assert said[-1].startswith("No suite is written: touches 1, 6, 11, ... are at 1 place")
    assert "touches 1, 6, 11, ... are at 1 place, and 3 are needed" in said[-1]


@pytest.mark.parametrize(
    ("places", "says"),
    [
        ([(0.01 * k, 0.02) for k in range(11)], "are on one line"),
        ([(0.01, 0.02)] * 10 + [(0.05, 0.06)], "are at 2 places"),
        ([(0.01 * k, 1e-3 * k**2) for k in range(10)], "only 10 touches so far"),
        ([(0.01 * k, 1e-3 * k**2) for k in range(11)], ""),
    ],
)
def test_what_the_places_of_touches_lack(places: list[tuple[float, float]], says: str) -> None:
    lacks = registration_lacks(places)
    assert says in lacks
    assert bool(lacks) == bool(says)


def test_a_suite_of_a_recording_of_any_name_is_read(tmp_path: Path) -> None:
    recording = tmp_path / "Fläche 😀.h5"
    write_suite(suite_path(recording), recording, sensor("foam16"), "fake", emulated=False)
    own, _ = tomllib.loads(recording.with_suffix(".toml").read_text("utf-8"))["scenarios"]
    assert (own["name"], own["recording"]) == ("fl-che", recording.name)


def test_a_board_that_can_be_pressed_is_pressed_by_the_session(
    tmp_path: Path, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame holds 2 while it is pressed, else 1; the file shows where."""
    made, left, pressed = board([]), ["", "", "", "30 30", "70 60", ""], list[tuple[float, ...]]()
    made.sensor = sensor("foam16")
    made.can_be_pressed, made.endless = True, True
    values = [1.0]

    def press(*touch: float) -> None:
        pressed.append(touch[:2])
        values[0] = 2.0

    def frame(wait_s: float) -> list[Frame]:
        time.sleep(0.01)
        now = time.monotonic()
        return [Frame(len(pressed), now, now, np.full(208, values[0]))]

    made.press, made.frames = press, frame
    made.release = lambda: values.__setitem__(0, 1.0)
    timing = StepDurations(0.05, settle_s=0.1, hold_s=0.05, released_s=0.05)
    with Recorder(tmp_path / "a.h5", made.sensor, "fake") as recorder:
        session = GuidedSession(made, recorder, lambda _: left.pop(0), lambda _: None, timing)
        session.run()
        assert session.touches == 2
    content, _ = read_file(tmp_path / "a.h5")
    assert pressed == [(0.03, 0.03), (0.07, 0.06)]
    assert (content.values[content.reference] == 1).all()
    for last in content.labels["last"]:
        assert (content.values[last] == 2).all()
    for first, last in content.labels[["reference_first", "reference_last"]].to_numpy():
        assert (content.values[first : last + 1] == 1).all()
    assert read_recording(str(tmp_path / "a.h5")).voltages.mean() == 2


def test_touches_of_several_contacts_and_forces_are_labelled(tmp_path: Path, board: Make) -> None:
    answers = ["", "", "", "30 30 1.5; 70, 60 2", "", "", "50 50", "", "", ""]
    touches, asked, _ = guided(tmp_path / "a.h5", board, answers)
    assert touches == 2
    assert asked[4] == (
        "Touch (30, 30) mm with 1.5 N and (70, 60) mm with 2 N, hold still, and press Enter"
    )
    labels = read_file(tmp_path / "a.h5")[0].labels
    assert labels["force_N"].tolist()[:2] == [1.5, 2.0]
    assert np.isnan(labels["force_N"][2])
    assert labels["state"].tolist() == ["30 30 1.5 N; 70 60 2 N"] * 2 + ["50 50"]
    first = labels["first"].tolist()
    assert first[0] == first[1] < first[2]
    samples = read_recording(str(tmp_path / "a.h5")).samples
    assert samples["contacts"].tolist() == [2, 1]
    np.testing.assert_allclose(samples[["x2_m", "y2_m"]], [[0.07, 0.06], [np.nan, np.nan]])
    assert samples["force_N"].tolist()[0] == 3.5


def test_typing_errors_are_asked_again(tmp_path: Path, board: Make) -> None:
    answers = [
        "",
        "many",
        "2.5",
        "0",
        "1",
        "-3",
        "",
        "30",
        "30 x",
        "1e999 3",
        "30 20; 30 20 nan 1",
        "30,5 55",
        "30 55,5",
        "30, 55,5",
        "; ".join(["30 20"] * 11),
        "30 20 -2",
        "500 20",
        "30 20",
        "",
        "",
        "",
    ]
    touches, _, said = guided(tmp_path / "a.h5", board, answers)
    assert touches == 1
    assert said[5].endswith(
        "are used to find how images map to places: at least 3 such places are needed, far apart "
        "and not on a line, as a line does not tell an image from its mirror image, such as 30 30, "
        "then 70 35, then 45 70."
    )
    assert [said[1], said[2], said[3], said[4], said[5].split(" Touches 1")[0]] == [
        "Type a whole number from 1 to 1000; got 'many'.",
        "Type a whole number from 1 to 1000; got '2.5'.",
        "Type a whole number from 1 to 1000; got '0'.",
        "Type a number from 0 to 1000; got '-3'.",
        "Type a place as 30 55, or with a force in N as 30 55 2.5. Places that "
        "are touched at the same time: 30 55; 70 20.",
    ]
    wrong = (
        "A place is two numbers in mm, such as 30 55; a force in N may follow, such as 30 55 2.5. "
        "Got"
    )
    assert said[6:-2] == [
        *(f"{wrong} {typed!r}." for typed in ("30", "30 x", "1e999 3", "30 20 nan 1")),
        *(
            "Put spaces between numbers, and write decimals with a point, such as 30.5 55; got "
            f"{typed!r}."
            for typed in ("30,5 55", "30 55,5", "30, 55,5")
        ),
        "A touch has at most 10 places.",
        "A force has to be above 0 N, got -2.",
        "(500, 20) mm is outside the sensor, which reaches from (0, 0) to (100, 100) mm.",
    ]
    assert said[-2] == "1 touch so far."
    assert said[-1].startswith("No suite is written: only 1 touch so far.")


def test_a_session_says_how_it_goes(
    tmp_path: Path, board: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, left, said = board(of_foam(400, 60)), ["", "", "", "30 20", "", "", ""], list[str]()
    made.sensor, made.wait_s = sensor("foam16"), 0.01
    monkeypatch.setattr(loop, "STATUS_S", 0.0)
    timing = StepDurations(0.1, settle_s=0.0, hold_s=0.1, released_s=0.1)

    def ask(_: str) -> str:
        wait_for(lambda: session._status is not None and session._status.frames >= 5)
        return left.pop(0)

    with Recorder(tmp_path / "a.h5", made.sensor, "fake") as recorder:
        session = GuidedSession(made, recorder, ask, said.append, timing)
        session.run()
    assert re.search(r"SNR \d\d dB", said[0])
    assert said[1].startswith("Reference: ")
    assert re.search(r"SNR \d\d dB", said[3])
    assert said[4] == "1 touch so far."


def test_a_board_that_fails_ends_the_session(tmp_path: Path, board: Make) -> None:
    made = board([])
    made.sensor, made.endless = sensor("foam16"), True
    made.frames = another_protocol
    with (
        pytest.raises(BoardError, match="another protocol"),
        Recorder(tmp_path / "a.h5", made.sensor, "fake") as recorder,
    ):
        GuidedSession(made, recorder, lambda question: "", lambda sentence: None).run()
    assert not any(thread.name == "guided recording" for thread in threading.enumerate())


def test_a_board_that_ends_ends_the_session(tmp_path: Path, board: Make) -> None:
    with pytest.raises(BoardError, match="The board stopped sending"):
        guided(tmp_path / "a.h5", board, ["", "", "", "30 20", ""], n=4)


def test_an_emulated_recording_never_counts_as_real(tmp_path: Path, frames: Frames) -> None:
    assert Emulator(sensor("foam16")).emulated
    path = tmp_path / "touch.h5"
    with Recorder(path, sensor("foam16"), "emulator", emulated=True) as recorder:
        for frame in of_foam(6, 60):
            recorder.append(frame)
        recorder.mark_reference(0, 2)
        recorder.label(3, 5, x_m=0.05, y_m=0.05)
    replay = Replay(path)
    assert replay.emulated
    assert recorded_set(str(path)).title == "own recording with an emulated board, touches: 1"
    write_suite(suite_path(path), path, sensor("foam16"), "emulator", emulated=True)
    suite = load_suite(tmp_path / "touch.toml")
    assert suite.scenarios[0].name == "emulated-touch"
    assert suite.title == "Touches on foam16, recorded with an emulated board"
    written = tmp_path / "touch.toml"
    written.write_text(written.read_text().replace('"emulated-touch"', '"touch"'))
    with pytest.raises(InputError, match="'emulated-touch'"):
        load_suite(written)


def test_a_recording_is_played_and_recorded_again(tmp_path: Path) -> None:
    made = of_foam(12, 60)
    with Recorder(tmp_path / "a.h5", sensor("foam16"), "fake") as recorder:
        for frame in made:
            recorder.append(frame)
    replay = Replay(tmp_path / "a.h5", speed=20)
    with replay, Recorder(tmp_path / "b.h5", replay.sensor, "replay") as recorder:
        record(replay, recorder)
    content, _ = read_file(tmp_path / "b.h5")
    assert np.array_equal(content.values, [frame.values for frame in made])
    assert not replay.emulated
