"""A recorded set played back."""

import dataclasses
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.hardware.board import BoardError, Frame
from eitbench.hardware.emulation import replay
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import RecordedFrames, fetch
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.sensors.sensor import foam16

N = 20


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> RecordedFrames:
    values = np.arange(N * 192.0).reshape(N, 192)
    recording = RecordedFrames(values, np.full(192, -1.0), pd.DataFrame({"split": ["test"] * N}))
    monkeypatch.setattr(replay, "read_recording", lambda name: recording)
    return recording


def collect(board: Replay, seconds: float) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and not board.ended:
        frames += board.frames(0.05)
    return frames


def test_frames_come_in_order_and_in_time_after_the_reference(
    recorded: RecordedFrames,
) -> None:
    with Replay("ohmc16", speed=20) as board:
        begin = time.monotonic()
        board.start()
        frames = collect(board, 5.0)
    assert all(frame.received_s - begin >= frame.time_s - 1e-6 for frame in frames)
    assert [frame.number for frame in frames] == list(range(10 + N))
    assert all((frame.values == recorded.reference).all() for frame in frames[:10])
    np.testing.assert_array_equal([f.values for f in frames[10:]], recorded.voltages)
    np.testing.assert_allclose(np.diff([f.time_s for f in frames]), 0.1 / 20)
    assert board.health.frames == 10 + N
    assert board.ended


def test_a_clock_that_goes_back_or_stops_does_not(tmp_path: Path) -> None:
    """A board that started anew, and one without a time."""
    sensor = foam16()
    with Recorder(tmp_path / "a.h5", sensor, "fake") as recorder:
        for k, time_s in enumerate((100.0, 100.1, 0.0, 0.1, np.nan, 0.3, 0.4)):
            received = 50 + 0.1 * k + (2.0 if k > 1 else 0.0)
            recorder.append(Frame(k, time_s, received, np.ones(sensor.n_measurements)))
    board = Replay(tmp_path / "a.h5", speed=20)
    with board:
        board.start()
        times = [frame.time_s for frame in collect(board, 5.0)]
    assert board.ended
    np.testing.assert_allclose(np.array(times) * 20, [0, 0.1, 2.2, 2.3, 2.4, 2.5, 2.6])


def test_a_recording_begins_with_its_untouched_sensor(tmp_path: Path) -> None:
    """As a live view takes the first frames for it, even if they were taken later."""
    sensor = foam16()
    values = np.ones((4, sensor.n_measurements)) * [[5.0], [1.0], [3.0], [5.0]]
    with Recorder(tmp_path / "a.h5", sensor, "fake") as recorder:
        for k, frame in enumerate(values):
            recorder.append(Frame(k, 0.1 * k, 0.1 * k, frame))
        recorder.mark_reference(1, 2)
    with Replay(tmp_path / "a.h5", speed=20) as board:
        board.start()
        frames = collect(board, 5.0)
    assert [frame.values[0] for frame in frames] == [2.0] * 10 + [5.0, 1.0, 3.0, 5.0]
    assert [frame.number for frame in frames] == list(range(14))
    np.testing.assert_allclose(np.diff([f.time_s for f in frames]), 0.1 / 20)


def test_lost_frames_stay_lost(tmp_path: Path) -> None:
    """Of a recording that began at 5, lost four frames, and went on from 0 after a restart."""
    sensor = foam16()
    with Recorder(tmp_path / "a.h5", sensor, "fake") as recorder:
        for k, number in enumerate((5, 6, 7, 12, 13, 0, 1)):
            recorder.append(Frame(number, 0.1 * k, 0.1 * k, np.ones(sensor.n_measurements)))
    with Replay(tmp_path / "a.h5", speed=20) as board:
        board.start()
        numbers = [frame.number for frame in collect(board, 5.0)]
    assert numbers == [0, 1, 2, 7, 8, 9, 10]


def test_differences_on_a_modelled_reference_are_no_frames(
    recorded: RecordedFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    modelled = dataclasses.replace(recorded, modelled_reference=True)
    for module in (replay, fetch):
        monkeypatch.setattr(module, "read_recording", lambda name: modelled)
    with pytest.raises(InputError, match="holds differences only"):
        Replay("cam09-04")
    with pytest.raises(InputError, match="holds differences only"):
        fetch.reference_frames("cam09-04")


def test_it_pauses_and_goes_on_where_it_was(recorded: RecordedFrames) -> None:
    with Replay("ohmc16", speed=20) as board:
        board.start()
        frames = collect(board, 0.05)
        board.stop()
        assert board.frames(0.1) == []
        board.start()
        frames += collect(board, 5.0)
    assert [frame.number for frame in frames] == list(range(10 + N))


def test_it_must_be_open(recorded: RecordedFrames) -> None:
    with pytest.raises(BoardError, match="open it first"):
        Replay("ohmc16").start()


def test_after_the_last_frame_no_more_come(recorded: RecordedFrames) -> None:
    with Replay("ohmc16", speed=1000) as board:
        board.start()
        collect(board, 5.0)
        assert board.frames(0.05) == []
        board.stop()
        board.start()
        assert board.frames(0.05) == []


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_a_speed_is_above_0(speed: float) -> None:
    with pytest.raises(InputError, match="speed above 0"):
        Replay("ohmc16", speed)


def test_another_sensor_is_refused(recorded: RecordedFrames) -> None:
    with pytest.raises(InputError, match="on sensor 'ohmc16', not on 'foam16'"):
        Replay("ohmc16", sensor=foam16())
    assert Replay("ohmc16", sensor=sensor("ohmc16")).sensor == sensor("ohmc16")


def test_a_real_set_is_played(recorded_data: Path) -> None:
    recording = read_recording("sciospec-tank")
    with Replay("sciospec-tank", speed=1000) as board:
        board.start()
        frames = collect(board, 10.0)
    np.testing.assert_array_equal([f.values for f in frames[10:]], recording.voltages)
