"""The emulated board: touched by script and by hand, unplugged, opened by another program."""

import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.hardware.board import BoardError, BoardLostError, Frame
from eitbench.hardware.emulation import emulator
from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor, Touch, read_script
from eitbench.hardware.emulation.emulator import Emulator
from eitbench.hardware.serial.serial_board import TeensyBoard
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import FRAME_S
from eitbench.scenarios.sensors.sensor import Sensor, foam16

SCRIPT = """
[[touches]]
start_s = 0.5
end_s = 1.0
x_mm = 30.0
y_mm = 60.0
radius_mm = 6.0
pressure_kpa = 20.0
"""


class Sensed(EmulatedSensor):
    """Stands for the emulated sensor: its frames count touches."""

    def __init__(self, sensor: Sensor, unit: int = 0) -> None:
        self.touched: list[tuple[float, list[Touch]]] = []
        self.frame_s = set[float]()

    def frame(
        self, time_s: float, touches: Sequence[Touch], frame_s: float = FRAME_S
    ) -> np.ndarray:
        self.touched.append((time_s, list(touches)))
        self.frame_s.add(frame_s)
        return np.full(208, 1.0 + len(touches))


@pytest.fixture
def sensed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emulator, "EmulatedSensor", Sensed)


@pytest.fixture
def fast() -> Iterator[Emulator]:
    board = Emulator(foam16(), rate_hz=50.0)
    yield board
    board.close()


def collect(board: Emulator, seconds: float) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        frames += board.frames(0.05)
    return frames


def until(board: Emulator, value: float) -> list[Frame]:
    """Frames up to the first that is `value`, however long they take."""
    frames: list[Frame] = []
    end = time.monotonic() + 60
    while not frames or frames[-1].values[0] != value:
        assert time.monotonic() < end, f"no frame of {value} came"
        for frame in board.frames(0.05):
            frames.append(frame)
            if frame.values[0] == value:
                break
    return frames


def test_a_script_presses_at_its_time(sensed: None, tmp_path: Path) -> None:
    path = tmp_path / "touches.toml"
    path.write_text(SCRIPT)
    with Emulator(foam16(), script=path, rate_hz=50.0) as board:
        board.start()
        until(board, 2.0)
        until(board, 1.0)
        assert isinstance(board._emulated, Sensed)
        touched = {t: touches for t, touches in board._emulated.touched if touches}
    assert 0.5 <= min(touched) <= max(touched) < 1.0
    assert touched[min(touched)] == [Touch(0.03, 0.06, 0.006, 20e3)]


def test_a_hand_presses_until_it_is_taken_off(sensed: None, fast: Emulator) -> None:
    fast.open()
    fast.start()
    until(fast, 1.0)
    assert isinstance(fast._emulated, Sensed)
    # The first is made before the board is open. None begins before the one before it ends.
    assert fast._emulated.frame_s == {FRAME_S, 1 / 50.0}
    fast.press(0.05, 0.05, 0.01, 10e3)
    until(fast, 2.0)
    assert {f.values[0] for f in collect(fast, 0.2)} <= {2.0}  # none goes back
    fast.release()
    until(fast, 1.0)
    assert {f.values[0] for f in collect(fast, 0.2)} <= {1.0}


def test_switched_off_and_on_again_it_is_the_same_sensor(sensed: None, fast: Emulator) -> None:
    fast.open()
    fast.start()
    until(fast, 1.0)
    before = fast._emulated
    assert isinstance(before, Sensed)
    fast.switch_off()
    with pytest.raises(BoardLostError):
        collect(fast, 30.0)
    fast.open()
    fast.start()
    assert until(fast, 1.0)[0].number == 0
    assert fast._emulated is before
    times = [t for t, _ in before.touched]
    assert times == sorted(times)  # the sensor has aged meanwhile


def test_it_has_a_port_while_it_is_switched_on(sensed: None, fast: Emulator) -> None:
    fast.open()
    assert Path(fast.port).exists()
    fast.close()
    with pytest.raises(BoardError, match="is switched off"):
        _ = fast.port


def test_it_does_not_measure_while_nobody_listens(sensed: None) -> None:
    board = Emulator(sensor("ohmc16"), "openeit", rate_hz=50.0)  # sends without being told
    board.switch_on()
    time.sleep(0.2)
    board.switch_off()
    assert isinstance(board._emulated, Sensed)
    assert len(board._emulated.touched) == 1  # when it was made


def test_closing_it_leaves_no_thread_and_no_file(sensed: None) -> None:
    def held() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    before = held()
    for _ in range(3):
        with Emulator(foam16(), rate_hz=50.0) as board:
            board.start()
            board.frames(0.5)
            board.open()  # once more
            board.start()
            assert board.frames(2.0)
    assert held() == before


def test_the_command_emulates_until_ctrl_c(
    sensed: None, tmp_path: Path, eitbench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "touches.toml"
    path.write_text(SCRIPT)
    opened = []

    def read_and_interrupt(self: Emulator) -> None:
        with TeensyBoard(foam16(), self.port) as board:
            board.start()
            while not board.frames(1.0):
                pass
        opened.append(self.port)
        raise KeyboardInterrupt

    monkeypatch.setattr(Emulator, "serve", read_and_interrupt)
    code, out, err = eitbench("emulate", "--script", path)
    assert code == 130
    assert opened[0] in out
    assert not Path(opened[0]).exists()
    assert err.splitlines()[-1] == "eitbench: Interrupted."


# Scripts


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("x_mm = 30.0", "x_mm = 'left'"), "field 'touches[0].x_mm': Input should be a"),
        (("end_s = 1.0", "end_s = 0.5"), "field 'touches[0].end_s': end_s has to be later"),
        (("radius_mm = 6.0", "radius_mm = 0"), "field 'touches[0].radius_mm'"),
        (("pressure_kpa = 20.0", "pressure_kpa = inf"), "pressure_kpa'"),
    ],
)
def test_a_mistake_in_a_script_is_named_with_the_field(
    change: tuple[str, str], says: str, tmp_path: Path
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(SCRIPT.replace(*change))
    with pytest.raises(InputError) as caught:
        read_script(path, foam16())
    assert says in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_scripted_touch_off_the_sensor_is_named(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text(SCRIPT.replace("x_mm = 30", "x_mm = 300"))
    sentence = r"touch 0 at \(300, 60\) mm is outside the sensor, .* \(0, 0\) to \(100, 100\) mm"
    with pytest.raises(InputError, match=sentence):
        Emulator(foam16(), script=path)


def test_the_documented_script_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "docs/boards.md").read_text()
    path = tmp_path / "touches.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0])
    script = read_script(path, foam16())
    assert script.at(19.9) == script.at(30.0) == []
    assert script.at(20.0) == [Touch(0.03, 0.06, 0.006, 20e3)]
