"""Boards on a serial port: unplugged, taken, at a wrong rate, with another protocol, too fast."""

import errno
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from eitbench.hardware.board import BoardError, BoardLostError, Frame
from eitbench.hardware.emulation.board_server import BoardServer
from eitbench.hardware.protocols import PROTOCOLS
from eitbench.hardware.serial import serial_board
from eitbench.hardware.serial.serial_board import SERIAL_BOARDS, SerialBoard, TeensyBoard
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.sensors.sensor import foam16

Serve = Callable[..., BoardServer]

DEADLINE_S = 30.0


def on(name: str, port: str) -> SerialBoard:
    board = SERIAL_BOARDS[name]
    return board(sensor(board.default_sensor), port)


def until(board: SerialBoard, count: int) -> list[Frame]:
    """At least `count` frames, however long they take."""
    frames: list[Frame] = []
    end = time.monotonic() + DEADLINE_S
    while len(frames) < count:
        assert time.monotonic() < end, "no frames came"
        frames += board.frames(0.1)
    return frames


def start_and_read(board: SerialBoard) -> None:
    board.start()
    until(board, 1)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board that sends nothing useful is looked into at once."""
    monkeypatch.setattr(serial_board, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(serial_board, "_ANSWER_S", 0.5)
    monkeypatch.setattr(serial_board, "_SILENCE_S", 0.5)


def test_a_port_that_goes_while_it_is_set_up_is_lost_in_a_sentence(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pyserial then lets the error of termios through, which is no OSError."""

    def gone(*arguments: object, **more: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    port = serve("teensy", 40.0).port
    with on("teensy", port) as board, monkeypatch.context() as patched:
        patched.setattr(board._serial, "reset_input_buffer", gone)
        with pytest.raises(BoardLostError, match="is gone"):
            board.start()
    monkeypatch.setattr("serial.Serial", gone)
    with pytest.raises(BoardError, match=r"cannot be opened \(Input/output error\)"):
        on("teensy", port).open()


def test_a_board_measures_while_it_is_told_to(name: str, serve: Serve, stream: Any) -> None:
    server = serve(name, 40.0)
    sent = stream(name, 1)
    with on(name, server.port) as board:
        assert board.frames(0.1) == []
        board.start()
        frames = until(board, 3)
        assert all(sent.holds(0, frame.values) for frame in frames)
        times = [frame.received_s for frame in frames]
        assert times == sorted(times)
        board.stop()
        assert board.frames(0.1) == []
        assert board.health.frames >= len(frames)  # one may arrive while it stops
        assert board.health.damaged == 0
        dropped = board.health.dropped
        board.start()
        until(board, 1)
        assert board.health.dropped == dropped  # what it sent before it paused is not lost


def test_frames_are_on_a_fixed_grid_of_time(serve: Serve) -> None:
    with on("teensy", serve("teensy", 40.0).port) as board:
        board.start()
        ticks = [40 * frame.time_s for frame in until(board, 5)]
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-3)


def test_a_wait_ends_in_time(serve: Serve) -> None:
    with on("teensy", serve("teensy", 0.01).port) as board:
        board.start()
        begin = time.monotonic()
        board.frames(0.0)
        assert time.monotonic() - begin < DEADLINE_S  # the next frame comes after 100 s


def test_unplugged_and_plugged_again(name: str, serve: Serve, tmp_path: Path) -> None:
    server, link = serve(name), tmp_path / "by-id"  # a name that stays, as udev gives
    link.symlink_to(server.port)
    board = on(name, str(link))
    board.open()
    board.start()
    until(board, 1)
    server.stop()
    with pytest.raises(BoardLostError, match=str(link)):
        until(board, 1000)
    board.close()
    link.unlink()
    with pytest.raises(BoardError, match=str(link)):
        board.open()
    link.symlink_to(serve(name).port)
    board.open()
    board.start()
    until(board, 1)
    board.close()


@pytest.mark.usefixtures("impatient")
def test_a_board_that_stops_sending_is_told(
    name: str, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    with on(name, serve(name, 40.0).port) as board:
        start_and_read(board)
        monkeypatch.setattr(board, "_read", lambda: b"")
        monkeypatch.setattr(board, "_send", lambda command: None)
        with pytest.raises(BoardError, match="has stopped sending: look at its cable"):
            until(board, 1)


def test_unplugged_before_a_command(serve: Serve) -> None:
    server = serve("teensy")
    board = on("teensy", server.port)
    board.open()
    server.stop()
    with pytest.raises(BoardLostError):
        board.start()
    board.close()


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("spoken", "expected"),
    [
        ("eit-kit", "sciospec"),  # sends by itself
        ("teensy", "eit-kit"),  # silent until it is started
        ("teensy", "sciospec"),
        ("sciospec", "eit-kit"),
    ],
)
def test_another_board_is_named(spoken: str, expected: str, serve: Serve) -> None:
    server = serve(spoken, 40.0)
    says = f"'{spoken}', not '{expected}'.*--board {spoken}"
    with on(expected, server.port) as board, pytest.raises(BoardError, match=says):
        start_and_read(board)
    assert not (PROTOCOLS[spoken].waking and server._device.running)  # it was told to stop


def test_a_board_that_can_says_its_firmware(name: str, serve: Serve) -> None:
    server = serve(name, 100.0)
    board = on(name, server.port)
    for _ in range(2):  # the second time it is measuring
        board.open()
        assert board.firmware == ("eitbench-teensy 1.0" if name == "teensy" else "")
        board.start()
        until(board, 1)
        assert board.health.damaged == 0
    board.close()


@pytest.mark.usefixtures("impatient")
def test_a_board_of_which_nothing_is_known_is_opened_all_the_same(
    terminal: tuple[int, str],
) -> None:
    with on("teensy", terminal[1]) as board:
        assert board.firmware == ""


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", ["sciospec", "teensy"])
def test_a_board_that_was_started_and_sends_nothing_is_named(
    name: str, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_board, "_LISTEN_S", 0.05)
    with on(name, terminal[1]) as board:
        assert board.frames(0.2) == []  # nothing is awaited before it is started
        with pytest.raises(BoardError, match=name):
            start_and_read(board)


@pytest.mark.parametrize("name", ["teensy", "openeit"])
def test_a_board_that_missed_its_start_is_told_again(
    name: str, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One is silent then, the other sends another number of values."""
    monkeypatch.setattr(serial_board, "_SILENCE_S", 1.0)
    server = serve(name, 40.0)
    obey, missed = server._device.obey, list[bytes]()
    with on(name, server.port) as board:
        start = board._parser.starting()[-1].strip()

        def deaf(data: bytes) -> bytes:
            if not missed and start in data:
                missed.append(data)
                return b""
            return obey(data)

        monkeypatch.setattr(server._device, "obey", deaf)
        board.start()
        assert until(board, 1)
    assert missed


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("sent", "says"),
    [
        # A new firmware may have another checksum.
        (lambda frame: frame[:-1] + b"?", "all are damaged: its firmware makes another checksum"),
        (lambda frame: b"alive\n", "sends text that no known board sends, such as 'alive'"),
    ],
)
def test_bytes_that_never_make_a_frame_are_told(
    sent: Callable[[bytes], bytes], says: str, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve("teensy", 100.0)
    encode = server._device.encode
    monkeypatch.setattr(server._device, "encode", lambda *frame: sent(encode(*frame)))
    with on("teensy", server.port) as board, pytest.raises(BoardError, match=says):
        start_and_read(board)


@pytest.mark.usefixtures("impatient")
def test_frames_that_are_damaged_for_a_while_end_nothing(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve("teensy", 100.0)
    encode = server._device.encode
    with on("teensy", server.port) as board:
        start_and_read(board)
        with monkeypatch.context() as patch:
            patch.setattr(server._device, "encode", lambda *frame: encode(*frame)[:-1] + b"?")
            end = time.monotonic() + DEADLINE_S
            while board.health.damaged < 200:  # four times the patience
                assert time.monotonic() < end
                board.frames(0.1)
        assert until(board, 1)


def test_a_command_that_is_refused_is_named(serve: Serve) -> None:
    server = serve("sciospec", nominal=sensor("jku-tank-adjacent"))
    with (
        on("sciospec", server.port) as board,
        pytest.raises(BoardError, match="b0 03 06 01 04 b0"),
    ):
        board.start()


def test_another_pattern_is_refused(serve: Serve) -> None:
    with on("teensy", serve("teensy", 40.0, sensor("foam16", offset=4)).port) as board:
        board.start()
        with pytest.raises(BoardError, match="0x944d"):
            until(board, 1)


def test_a_board_that_is_not_open_says_so() -> None:
    with pytest.raises(BoardError, match="open it first"):
        TeensyBoard(foam16(), "/dev/ttyACM0").start()


def test_a_host_that_does_not_read_loses_frames_and_the_numbers_show_it(serve: Serve) -> None:
    server = serve("teensy", 400.0)
    with on("teensy", server.port) as board:
        board.start()
        while server._number < 40:  # more than a terminal holds
            time.sleep(0.01)
        assert len(server._unsent) < 2 * 860
        frames = until(board, 1)
        while not board.health.dropped:
            frames += until(board, 1)
        assert board.health.damaged == 0
        assert frames[-1].number + 1 == len(frames) + board.health.dropped


def fast(serve: Serve, seconds: float) -> None:
    """A board at ten times its rate: its frames add up, and memory does not grow."""
    process = psutil.Process()
    with on("teensy", serve("teensy", 100.0).port) as board:
        board.start()
        numbers = [frame.number for frame in until(board, 1)]
        before, end = process.memory_info().rss, time.monotonic() + seconds
        while time.monotonic() < end:
            numbers += [frame.number for frame in board.frames(0.1)]
        health = board.health
        assert health.damaged == 0
        assert health.frames == len(numbers) > 0
        assert health.frames + health.dropped == numbers[-1] + 1
        assert process.memory_info().rss - before < 8 << 20
        assert len(board._unread) < 1 << 16


def test_ten_times_the_rate(serve: Serve) -> None:
    fast(serve, 0.5)


@pytest.mark.nightly
def test_ten_times_the_rate_for_a_minute(serve: Serve) -> None:
    fast(serve, 60.0)


@pytest.mark.parametrize(
    ("port", "emulated"),
    [
        ("/dev/pts/4", True), ("/dev/ttys004", True),
        ("/dev/ttyS4", False), ("/dev/ttyACM0", False), ("/dev/cu.usbmodem1", False),
        ("COM3", False),
    ],
)  # fmt: skip
def test_boards_on_pseudo_terminals_are_emulated(port: str, emulated: bool) -> None:
    """Those of macOS, too."""
    assert TeensyBoard(foam16(), port).emulated == emulated
