"""The commands `record` and `recordings`, as they are typed."""

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from eitbench.commands import hardware as hardware_commands
from eitbench.hardware import registry
from eitbench.hardware.board import Board, BoardError, Frame
from eitbench.hardware.recording import guided
from eitbench.hardware.recording.guided import StepDurations
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import forward_model, load_suite
from eitbench.scenarios.errors import DataCorruptError, UnreadableError
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.sensors.sensor import Sensor

Run = Callable[..., tuple[int, str, str]]
Frames = Callable[[int], list[Frame]]

SENSOR = """
name = "bench"
[outline]
rectangle_mm = [80, 60]
[electrodes]
count = 8
width_mm = 10
start_mm = 20
[pattern]
offset = 3
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, board: Callable[..., Board], frames: Frames) -> None:
    """`make_board` gives a board of ten frames."""

    def make(name: str, *, sensor: Sensor | None, **choices: object) -> Board:
        made = board(frames(10))
        made.sensor = sensor or made.sensor
        return made

    monkeypatch.setattr(registry, "make_board", make)


@pytest.fixture
def endless(monkeypatch: pytest.MonkeyPatch, board: Callable[..., Any], frames: Frames) -> None:
    """`make_board` gives a board that always has more frames; touches are short."""
    values = frames(1)[0].values

    def make(name: str, **choices: object) -> Board:
        made = board([Frame(k, k / 100, k / 100, values) for k in range(5000)])
        made.wait_s = 0.01
        return made  # type: ignore[no-any-return]

    monkeypatch.setattr(registry, "make_board", make)
    monkeypatch.setattr(guided, "StepDurations", lambda: StepDurations(0.05, 0.01, 0.02, 0.02))


@pytest.mark.usefixtures("fake")
def test_a_board_is_recorded(tmp_path: Path, eitbench: Run) -> None:
    out = tmp_path / "a.h5"
    code, said, _ = eitbench("record", "--board", "fake", "--seconds", "0.2", "--out", out)
    assert (code, said) == (0, f"10 frames are in {out}: eitbench recordings check {out}\n")
    assert len(read_file(out)[0]) == 10
    again = eitbench("record", "--board", "fake", "--seconds", "0.2", "--out", out)
    assert again == (
        2, "", f"eitbench: {out} exists already and is never overwritten: name another file.\n",
    )  # fmt: skip


@pytest.mark.usefixtures("fake")
def test_a_sensor_file_says_what_is_on_the_board(tmp_path: Path, eitbench: Run) -> None:
    (tmp_path / "bench.toml").write_text(SENSOR)
    out = tmp_path / "a.h5"
    command = ("record", "--board", "fake", "--seconds", "0.2", "--out", out, "--sensor")
    assert eitbench(*command, tmp_path / "bench.toml")[0] == 0
    assert read_file(out)[0].sensor.name == "bench"
    out.unlink()
    code, _, err = eitbench(*command, "foam61")
    assert (code, err) == (2, "eitbench: Unknown sensor 'foam61': did you mean 'foam16'?\n")
    code, _, err = eitbench(*command, "foam16")
    assert code == 2
    assert "'foam16' has 208 values, and a frame has 40: choose the sensor" in err


@pytest.mark.usefixtures("fake")
def test_guided_and_seconds_exclude_each_other(tmp_path: Path, eitbench: Run) -> None:
    code, _, err = eitbench(
        "record", "--board", "fake", "--guided", "--seconds", "3", "--out", tmp_path / "a.h5"
    )
    assert code == 2
    assert "--seconds" in err
    (tmp_path / "b.toml").write_text("")
    code, _, err = eitbench("record", "--board", "f", "--guided", "--out", tmp_path / "b.h5")
    assert code == 2
    assert "b.toml" in err
    assert not (tmp_path / "b.h5").exists()


def test_recordings_are_checked_and_exchanged(
    tmp_path: Path, eitbench: Run, skin: Sensor, frames: Frames
) -> None:
    path = tmp_path / "a.h5"
    with Recorder(path, skin, "fake") as recorder:
        model = forward_model(skin)
        values = model.voltages(model.background)
        for frame in frames(10):
            recorder.append(Frame(frame.number, frame.time_s, frame.received_s, values))
        recorder.mark_reference(0, 9)
    code, said, _ = eitbench("recordings", "check", path)
    assert code == 0
    assert said.splitlines()[-1] == f"{path} is sound."
    code, said, _ = eitbench("recordings", "check", path, "--sensor", path)
    assert code == 0
    assert said.count("against the model of sensor skin: correlation 1.00, misfit 0.0%") == 2
    code, _, err = eitbench("recordings", "check", path, "--sensor", "ohmc16")
    assert code == 2
    assert "holds 40 values a frame, and sensor 'ohmc16' has 192: name one of as many." in err
    code, said, _ = eitbench("recordings", "export", path, "--to", tmp_path / "a.csv")
    assert (code, said) == (0, f"10 frames are in {tmp_path / 'a.csv'}.\n")
    code, said, _ = eitbench("recordings", "import", tmp_path / "a.csv", "--out", tmp_path / "b.h5")
    assert code == 0
    assert said.splitlines()[0].endswith(f"of sensor 'skin' are in {tmp_path / 'b.h5'}.")
    (tmp_path / "c.h5").write_bytes(path.read_bytes()[:-3000])
    code, said, err = eitbench("recordings", "check", tmp_path / "c.h5")
    assert code == 1
    assert said == f"{tmp_path / 'c.h5'} is damaged: it was cut short.\n"
    assert err == f"eitbench: {tmp_path / 'c.h5'} has 1 problem.\n"
    for command in (
        ("recordings", "check", tmp_path / "none.h5"),
        ("recordings", "import", tmp_path / "none.csv", "--out", tmp_path / "d.h5"),
        ("record", "--board", "replay", "--file", "none.h5", "--out", tmp_path / "d.h5"),
        ("run", tmp_path / "none.toml"),
    ):
        code, _, err = eitbench(*command)
        assert code == 2
        assert "No such file" in err
    code, _, err = eitbench("recordings", "fetch", path)
    assert code == 2
    assert "has no labels, so that methods cannot be compared on it" in err


def recorded(path: Path) -> int:
    """Number of frames in the file that is being made at `path`."""
    try:
        return len(read_file(path)[0])
    except (UnreadableError, DataCorruptError):  # there is none yet, or only its beginning
        return 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "end", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.nightly)]
)
def test_an_emulated_board_is_recorded_until_a_signal(tmp_path: Path, end: signal.Signals) -> None:
    """The whole way: a serial device file, the live status line of a terminal, the signal."""
    out = tmp_path / "a.h5"
    command = [sys.executable, "-m", "eitbench.cli", "record", "--board", "emulator"]
    master, slave = pytest.importorskip("pty").openpty()
    with subprocess.Popen(
        [*command, "--out", str(out)], stdout=subprocess.PIPE, stderr=slave, text=True
    ) as process:
        os.close(slave)
        try:
            while recorded(out) < 8:
                assert process.poll() is None
                time.sleep(0.05)
            process.send_signal(end)
            said, _ = process.communicate(timeout=30)
        finally:
            process.kill()
    shown = os.read(master, 1 << 16).decode()
    os.close(master)
    content, condition = read_file(out)
    assert process.returncode == 0
    assert said == f"{len(content)} frames are in {out}: eitbench recordings check {out}\n"
    assert (condition.complete, content.emulated, content.board) == (True, True, "emulator")
    assert content.firmware == "eitbench-teensy 1.0"
    assert re.search(r"\d\.\d/s  SNR \d+ dB", shown)
    assert "Interrupted: the recording ends here." in shown


ANSWERS = ("", "", "", "30 30", "", "")  # one touch, and then nothing more


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
def test_a_terminal_that_is_closed_leaves_a_whole_recording(
    tmp_path: Path,
    eitbench: Run,
    monkeypatch: pytest.MonkeyPatch,
    board: Callable[..., Any],
    frames: Frames,
) -> None:
    """SIGHUP, after which nothing can be printed: file sealed, suite written, board stopped."""
    values = frames(1)[0].values
    made = board([Frame(k, k / 100, k / 100, values) for k in range(5000)])
    made.wait_s = 0.01
    monkeypatch.setattr(registry, "make_board", lambda name, **choices: made)
    monkeypatch.setattr(guided, "StepDurations", lambda: StepDurations(0.05, 0.01, 0.02, 0.02))
    left = list(ANSWERS)

    def gone(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def ask(question: str) -> str:
        if not left:
            monkeypatch.setattr(typer, "echo", gone)
            os.kill(os.getpid(), signal.SIGHUP)
        return left.pop(0)

    monkeypatch.setattr(hardware_commands, "_ask", ask)
    out = tmp_path / "a.h5"
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        eitbench("record", "--board", "fake", "--guided", "--out", out)
    content, condition = read_file(out)
    assert condition.sealed
    assert len(content.labels) == 1
    assert made.calls[-2:] == ["stop", "close"]


@pytest.mark.nightly
def test_a_terminal_that_is_closed_ends_a_guided_recording_cleanly(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(SENSOR)
    out = tmp_path / "a.h5"
    fcntl, termios = pytest.importorskip("fcntl"), pytest.importorskip("termios")
    command = [sys.executable, "-m", "eitbench.cli", "record", "--board", "emulator", "--guided"]
    master, slave = pytest.importorskip("pty").openpty()
    with subprocess.Popen(
        [*command, "--sensor", str(tmp_path / "bench.toml"), "--out", str(out)],
        stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    ) as process:  # fmt: skip
        os.close(slave)
        try:
            said = b""
            for wanted, answer in (
                (b"press Enter", b"\n"), (b"How often", b"\n"), (b"How deep", b"\n"),
                (b"Place x y", b"30 30\n"), (b"1 touch so far", b""),
            ):  # fmt: skip
                while wanted not in said:
                    said += os.read(master, 4096)
                said = said.partition(wanted)[2]
                os.write(master, answer)
            os.close(master)
            process.wait(60)
        finally:
            process.kill()
    content, condition = read_file(out)
    assert condition.sealed
    assert len(content.labels) == 1


def test_a_guided_session_that_is_interrupted_keeps_its_touches(
    tmp_path: Path, eitbench: Run, endless: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted_by(error: BaseException, out: Path) -> tuple[int, str, str]:
        left = list(ANSWERS)

        def ask(question: str) -> str:
            if not left:
                raise error
            return left.pop(0)

        monkeypatch.setattr(hardware_commands, "_ask", ask)
        return eitbench("record", "--board", "fake", "--guided", "--out", out)

    for k, (error, code, sentence) in enumerate(
        [
            (KeyboardInterrupt(), 130, "Interrupted."),  # Ctrl-C
            (typer.Abort(), 130, "Interrupted."),  # the end of what can be typed
            (BoardError("It is broken."), 1, "It is broken."),
        ]
    ):
        out = tmp_path / f"a{k}.h5"
        found, said, err = interrupted_by(error, out)
        content, condition = read_file(out)
        assert (found, err) == (code, f"eitbench: {sentence}\n")
        kept = f"{len(content)} frames are in {out}: eitbench recordings check {out}"
        assert said.splitlines()[-1] == kept  # one touch is too few to score methods on
        assert condition.sealed
        assert len(content.labels) == 1
        assert not out.with_suffix(".toml").exists()


def test_nothing_is_left_of_a_recording_without_frames(
    tmp_path: Path, eitbench: Run, board: Callable[..., Board], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "make_board", lambda name, **choices: board([]))
    out = tmp_path / "a.h5"
    code, said, err = eitbench("record", "--board", "fake", "--seconds", "0.1", "--out", out)
    assert (code, said) == (1, "")
    assert err.startswith(f"eitbench: Not one frame arrived, so that there is no recording {out}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_a_guided_session_with_an_emulated_board_is_ready_for_a_suite(tmp_path: Path) -> None:
    out = tmp_path / "touch.h5"
    answers = "\n4\n\n" + "30 30\n70 30\n50 60\n" + "\n"
    command = [sys.executable, "-m", "eitbench.cli", "record", "--board", "emulator", "--guided"]
    done = subprocess.run(
        [*command, "--out", str(out)], input=answers, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    suite_file = out.with_suffix(".toml")
    assert done.stdout.splitlines()[-1] == f"Score methods on them: eitbench run {suite_file}"
    content, _ = read_file(out)
    reference = content.values[content.reference].mean(axis=0)
    for first, last in zip(content.labels["first"], content.labels["last"], strict=True):
        # It was pressed while the frames of the label were taken.
        change = content.values[first : last + 1].mean(axis=0) - reference
        assert np.linalg.norm(change) > 0.01 * np.linalg.norm(reference)
    assert load_suite(suite_file).scenarios[0].name == "emulated-touch"
    moved = tmp_path / "moved"
    moved.mkdir()
    for file in (out, suite_file):
        shutil.move(file, moved)
    assert load_suite(moved / "touch.toml").scenarios[0].name == "emulated-touch"
