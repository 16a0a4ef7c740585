"""Recording: what is written can be read, whatever stops it."""

import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder, RecorderError
from eitbench.scenarios import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.files.recording_file import Condition, read_file
from eitbench.scenarios.sensors.sensor import Sensor

Frames = Callable[[int], list[Frame]]
WHOLE = Condition(complete=True, trimmed=0, unlabelled=0, damaged=(), sealed=True)


def record(path: Path, skin: Sensor, frames: list[Frame]) -> None:
    with Recorder(path, skin, "fake", firmware="1.2", emulated=True, started="2026") as recorder:
        for frame in frames:
            recorder.append(frame)
        recorder.mark_reference(0, 2)
        recorder.label(3, 4, x_m=0.01, y_m=0.02, depth_mm=3.0, state="a")
        recorder.label(5, 5)
        recorder.event("x" + "ü" * 200, 5.3)


def test_a_sensor_that_no_file_can_describe_is_refused_before_a_frame_is_lost(
    tmp_path: Path, skin: Sensor
) -> None:
    with pytest.raises(InputError, match="described wrongly: name"):
        Recorder(tmp_path / "a.h5", replace(skin, name="Skin wide"), "fake")
    assert not (tmp_path / "a.h5").exists()


def test_what_is_recorded_is_read_bit_by_bit(tmp_path: Path, skin: Sensor, frames: Frames) -> None:
    made = frames(500)
    record(tmp_path / "a.h5", skin, made)
    content, condition = read_file(tmp_path / "a.h5")
    assert condition == WHOLE
    assert (content.sensor, content.sensor.name) == (skin, "skin")
    assert (content.board, content.firmware, content.emulated) == ("fake", "1.2", True)
    assert content.started == "2026"
    assert np.array_equal(content.values, [frame.values for frame in made])
    assert np.array_equal(content.number, [frame.number for frame in made])
    assert np.array_equal(content.time_s, [frame.time_s for frame in made])
    assert np.array_equal(content.received_s, [frame.received_s for frame in made])
    assert content.reference.tolist() == [0, 1, 2]
    first, second = content.labels.to_dict("records")
    assert {name: value for name, value in first.items() if value == value} == {
        "first": 3, "last": 4, "x_m": 0.01, "y_m": 0.02, "depth_mm": 3.0, "state": "a",
        "reference_first": -1, "reference_last": -1,
    }  # fmt: skip
    assert np.isnan(second["x_m"])
    (event,) = content.events.to_dict("records")
    assert event["time_s"] == 5.3
    assert event["text"] == "x" + "ü" * 127  # 255 bytes: whole characters only


def test_any_program_can_read_a_closed_file(tmp_path: Path, skin: Sensor, frames: Frames) -> None:
    record(tmp_path / "a.h5", skin, frames(7))
    with h5py.File(tmp_path / "a.h5", "r") as file:
        assert file["frames/values"].shape == (7, 40)
        assert bytes(file["frames/time_s"].attrs["units"]) == b"s"
        assert np.array_equal(file["pattern"], skin.pattern.table)
    assert (tmp_path / "a.h5").stat().st_size < 200_000  # the room that was taken is given back


def test_a_file_can_be_read_while_it_is_written(
    tmp_path: Path, skin: Sensor, frames: Frames
) -> None:
    path = tmp_path / "a.h5"
    with Recorder(path, skin, "fake") as recorder:
        for frame in frames(30):
            recorder.append(frame)
        while len(read_file(path)[0]) < 30:
            time.sleep(0.05)
        assert not read_file(path)[1].complete
    assert read_file(path)[1] == WHOLE


def test_nothing_is_overwritten(tmp_path: Path, skin: Sensor, frames: Frames) -> None:
    record(tmp_path / "a.h5", skin, frames(7))
    before = (tmp_path / "a.h5").read_bytes()
    with pytest.raises(InputError, match="exists already and is never overwritten"):
        Recorder(tmp_path / "a.h5", skin, "fake")
    assert (tmp_path / "a.h5").read_bytes() == before
    with pytest.raises(InputError, match=r"ends in \.h5"):
        Recorder(tmp_path / "a.csv", skin, "fake")
    with pytest.raises(RecorderError, match="Cannot write the recording"):
        Recorder(tmp_path / "none" / "a.h5", skin, "fake")


def test_frames_of_another_sensor_are_refused(tmp_path: Path, skin: Sensor) -> None:
    with (
        pytest.raises(InputError, match=r"'skin' has 40 values, and a frame has 208"),
        Recorder(tmp_path / "a.h5", skin, "fake") as recorder,
    ):
        recorder.append(Frame(0, 0.0, 0.0, np.zeros(208)))
    assert list(tmp_path.iterdir()) == []  # another attempt may take the name


def test_without_a_frame_there_is_no_recording(tmp_path: Path, skin: Sensor) -> None:
    def empty() -> None:
        with Recorder(tmp_path / "a.h5", skin, "fake") as recorder:
            recorder.event("nothing came", 0.0)

    with pytest.raises(RecorderError, match="Not one frame arrived, so that there is no recording"):
        empty()
    assert list(tmp_path.iterdir()) == []


def test_what_fails_later_is_kept(tmp_path: Path, skin: Sensor, frames: Frames) -> None:
    def interrupted() -> None:
        with Recorder(tmp_path / "a.h5", skin, "fake") as recorder:
            recorder.append(frames(1)[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    content, condition = read_file(tmp_path / "a.h5")
    assert (len(content), condition) == (1, WHOLE)


WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import sensor

recorder = Recorder(Path(sys.argv[1]), sensor("foam16"), "fake")
k = 0
while True:
    # Now and then nothing arrives for longer than a second: what came before must be there.
    time.sleep(1.5 if k % 400 == 399 else 0.004)
    recorder.append(Frame(k, k / 200, time.monotonic(), np.full(208, float(k))))
    k += 1
    print(k, recorder.written, time.monotonic(), flush=True)
"""


def kill_a_recorder(path: Path, after: int) -> tuple[int, list[tuple[int, int, float]], float]:
    """Frames in the file of a recorder that was killed after so many frames.

    Also what it has said, (frames appended, frames written, when) each time, and when it was
    killed. The file must be readable.
    """
    said: list[tuple[int, int, float]] = []
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        killed = 0.0
        for line in process.stdout:
            if line.count(" ") == 2 and line.endswith("\n"):
                count, written, at = line.split()
                said.append((int(count), int(written), float(at)))
            if not killed and len(said) >= after and said[-1][1]:
                killed = time.monotonic()
                process.kill()
    content, condition = read_file(path)
    assert not condition.complete
    assert not condition.damaged
    assert np.array_equal(content.number, np.arange(len(content)))
    assert np.array_equal(content.values, np.repeat(content.number[:, None], 208, axis=1))
    return len(content), said, killed


@pytest.mark.slow
def test_a_kill_loses_nothing_that_was_written(tmp_path: Path) -> None:
    frames, said, _ = kill_a_recorder(tmp_path / "a.h5", 50)
    assert frames >= said[-1][1] > 0


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(100))
def test_no_kill_of_many_loses_more_than_the_last_second(tmp_path: Path, seed: int) -> None:
    after = random.Random(seed).randrange(1, 600)
    frames, said, killed = kill_a_recorder(tmp_path / "a.h5", after)
    assert frames >= max((count for count, _, at in said if at < killed - 1), default=0)


@contextmanager
def room(size: int) -> Iterator[None]:
    """A disk that is full where a file has `size` bytes."""
    resource = pytest.importorskip("resource")  # not on Windows
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_one_sentence_and_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"

    def fill(recorder: Recorder) -> None:
        for k in range(10_000):
            recorder.append(Frame(k, k / 200, k / 200, np.full(208, float(k))))
            while k % 150 == 149 and recorder.written < k and recorder._failure is None:
                time.sleep(0.01)

    with room(3 << 20):
        recorder = Recorder(path, sensor("foam16"), "fake")
        with pytest.raises(RecorderError) as met:
            fill(recorder)
        with pytest.raises(RecorderError, match="the disk is full") as again:
            recorder.close()
    content, condition = read_file(path)
    assert str(met.value) == str(again.value)
    assert f"the {len(content)} frames" in str(met.value)
    assert len(content) >= 150
    assert (condition.complete, condition.trimmed, condition.damaged) == (False, 0, ())


def test_no_frame_follows_one_that_was_lost(
    tmp_path: Path, skin: Sensor, frames: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever error it was lost by: labels count rows."""
    made = frames(6)
    recorder = Recorder(tmp_path / "a.h5", skin, "fake")
    for frame in made[:2]:
        recorder.append(frame)
    recorder._take_and_write()

    def fail(*_: object) -> None:
        raise MemoryError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(recorder, "_append", fail)
        recorder.append(made[2])
        recorder._take_and_write()
    with pytest.raises(RecorderError, match=r"a MemoryError \(no room\): the 2 frames until then"):
        recorder.append(made[3])
    with pytest.raises(RecorderError, match="MemoryError"):
        recorder.close()
    content, condition = read_file(tmp_path / "a.h5")
    assert np.array_equal(content.values, [frame.values for frame in made[:2]])
    assert not condition.complete


@pytest.mark.parametrize("size", [100, 100_000])
def test_a_disk_that_is_full_from_the_start_leaves_nothing(
    tmp_path: Path, skin: Sensor, size: int
) -> None:
    with room(size), pytest.raises(RecorderError, match="the disk is full"):
        Recorder(tmp_path / "a.h5", skin, "fake")
    assert list(tmp_path.iterdir()) == []
