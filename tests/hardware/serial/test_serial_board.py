"""Boards on a serial port: unplugged, taken, at a wrong rate, with another protocol, too fast."""

import contextlib
import os
import random
import threading
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
from eitbench.scenarios.sensors.foam16 import foam16

Serve = Callable[..., BoardServer]


def on(name: str, port: str) -> SerialBoard:
    board = SERIAL_BOARDS[name]
    return board(sensor(board.default_sensor), port)


def collect(board: SerialBoard, seconds: float) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        frames += board.frames(0.1)
    return frames


def start_and_collect(board: SerialBoard) -> None:
    board.start()
    collect(board, 5.0)


def listen(board: SerialBoard, board_end: int, text: bytes) -> None:
    """Read what a board sends that sends nothing but `text`."""
    for _ in range(100):
        os.write(board_end, text)
        board.frames(0.02)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_board, "_PATIENCE_S", 0.3)
    monkeypatch.setattr(serial_board, "_ANSWER_S", 0.3)
    monkeypatch.setattr(serial_board, "_LISTEN_S", 0.4)


def test_a_board_measures_while_it_is_told_to(name: str, serve: Serve, stream: Any) -> None:
    server = serve(name, 40.0)
    sent = stream(name, 1)
    with on(name, server.port) as board:
        assert board.frames(0.1) == []
        board.start()
        frames = collect(board, 0.5)
        assert len(frames) > 2
        assert all(sent.holds(0, frame.values) for frame in frames)
        times = [frame.received_s for frame in frames]
        assert times == sorted(times)
        board.stop()
        assert collect(board, 0.2) == []
        assert (board.health.frames, board.health.dropped) == (len(frames), 0)
        board.start()
        assert board.frames(2.0)
        assert board.health.dropped == 0


def test_frames_are_on_a_fixed_grid_of_time(serve: Serve) -> None:
    with on("teensy", serve("teensy", 40.0).port) as board:
        board.start()
        ticks = [40 * frame.time_s for frame in collect(board, 0.5)]
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-3)


def test_a_wait_ends_in_time(serve: Serve) -> None:
    with on("teensy", serve("teensy", 1.0).port) as board:
        board.start()
        begin = time.monotonic()
        board.frames(0.0)
        assert time.monotonic() - begin < 0.9  # before the next frame


def test_unplugged_in_the_middle_of_a_frame_and_plugged_again(
    name: str, serve: Serve, tmp_path: Path
) -> None:
    server, link = serve(name), tmp_path / "by-id"  # a name that stays, as udev gives
    link.symlink_to(server.port)
    board = on(name, str(link))
    board.open()
    board.start()
    assert board.frames(2.0)
    server.cut()
    with pytest.raises(BoardLostError, match=f"{link} is gone: it was unplugged"):
        collect(board, 2.0)
    board.close()
    link.unlink()
    with pytest.raises(BoardError, match=f"There is no serial port {link}"):
        board.open()
    link.symlink_to(serve(name).port)
    board.open()
    board.start()
    assert board.frames(2.0)
    board.close()


def test_the_plug_is_pulled_in_the_middle_of_a_frame(serve: Serve) -> None:
    server = serve("openeit", 40.0)
    port = os.open(server.port, os.O_RDWR | os.O_NOCTTY)
    os.read(port, 1)
    heard, cutting = b"", threading.Thread(target=server.cut)
    cutting.start()
    with contextlib.suppress(OSError):
        while more := os.read(port, 4096):
            heard += more
    os.close(port)
    cutting.join()
    last = heard.rpartition(b"magnitudes: ")[2]
    assert 100 < len(last) < 32 * 14  # as many bytes as a mode of 8 electrodes has


def test_unplugged_before_a_command(serve: Serve) -> None:
    server = serve("teensy")
    board = on("teensy", server.port)
    board.open()
    server.cut()
    with pytest.raises(BoardLostError):
        board.start()
    board.close()


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("text_board", ["eit-kit", "openeit"])
@pytest.mark.parametrize("baud", [9600, 57_600, 230_400])
def test_a_wrong_baud_rate_is_named(
    text_board: str, baud: int, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = serve(text_board, 40.0)
    monkeypatch.setattr(PROTOCOLS[text_board], "baud", baud)  # the host's; the board has its own
    with on(text_board, server.port) as board:
        board.start()
        with pytest.raises(
            BoardError,
            match=f"has the wrong baud rate: it is set to 115200 bit/s; set it to {baud}",
        ):
            collect(board, 5.0)


@pytest.mark.usefixtures("impatient")
def test_noise_is_most_likely_a_wrong_baud_rate(terminal: tuple[int, str]) -> None:
    board_end, port = terminal
    with on("eit-kit", port) as board:
        board.start()
        with pytest.raises(BoardError, match="most likely the board has a wrong baud rate"):
            listen(board, board_end, random.Random(0).randbytes(100))


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("spoken", "expected"),
    [
        ("openeit", "eit-kit"),
        ("eit-kit", "openeit"),
        ("openeit", "teensy"),
        ("eit-kit", "sciospec"),
    ],
)
def test_another_boards_protocol_is_named(spoken: str, expected: str, serve: Serve) -> None:
    server = serve(spoken, 40.0)
    with (
        on(expected, server.port) as board,
        pytest.raises(BoardError, match=f"looks like board '{spoken}', not '{expected}'"),
    ):
        start_and_collect(board)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("spoken", "expected"),
    [
        ("teensy", "eit-kit"),
        ("teensy", "openeit"),
        ("teensy", "sciospec"),
        ("sciospec", "teensy"),
        ("sciospec", "eit-kit"),
    ],
)
def test_another_board_that_is_silent_is_woken_and_named(
    spoken: str, expected: str, serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_board, "_SILENCE_S", 0.2)
    monkeypatch.setattr(serial_board, "_LISTEN_S", 0.3)
    server = serve(spoken, 40.0)
    with (
        on(expected, server.port) as board,
        pytest.raises(BoardError, match=f"looks like board '{spoken}', not '{expected}': give"),
    ):
        start_and_collect(board)
    assert not server._device.running  # it was told to stop


@pytest.mark.usefixtures("impatient")
def test_another_programs_text_is_quoted(terminal: tuple[int, str]) -> None:
    board_end, port = terminal
    with on("eit-kit", port) as board:
        board.start()
        with pytest.raises(BoardError, match="sends text that no known board sends, such as 'GPS"):
            listen(board, board_end, b"GPS fix lost, searching\n")


def test_a_board_that_can_says_its_firmware(name: str, serve: Serve) -> None:
    server = serve(name, 100.0)
    board = on(name, server.port)
    for _ in range(2):  # the second time it is measuring
        board.open()
        assert board.firmware == ("eitbench-teensy 1.0" if name == "teensy" else "")
        board.start()
        assert board.frames(2.0)
        assert board.health.damaged == 0
    board.close()


def test_a_board_of_which_nothing_is_known_is_opened_all_the_same(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_board, "_ANSWER_S", 0.1)
    with on("teensy", terminal[1]) as board:
        assert board.firmware == ""


@pytest.mark.usefixtures("impatient")
def test_a_silent_instrument_does_not_answer(terminal: tuple[int, str]) -> None:
    with (
        on("sciospec", terminal[1]) as board,
        pytest.raises(BoardError, match="does not answer as 'sciospec' does"),
    ):
        board.start()


def test_a_board_that_was_started_and_sends_nothing_is_named(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_board, "_SILENCE_S", 0.2)
    with on("teensy", terminal[1]) as board:
        assert collect(board, 0.4) == []  # nothing is awaited before it is started
        board.start()
        with pytest.raises(BoardError, match="sends nothing: see whether it is switched on"):
            collect(board, 2.0)


def test_a_board_that_was_deaf_when_it_was_started_is_told_again(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("teensy", "openeit"):  # one is silent, the other sends another number of values
        monkeypatch.setattr(serial_board, "_SILENCE_S", 0.3)
        server = serve(name, 40.0)
        obey, begin = server._device.obey, time.monotonic()

        def deaf(data: bytes, obey: Callable[[bytes], bytes] = obey, begin: float = begin) -> bytes:
            return obey(data) if time.monotonic() > begin + 0.1 else b""

        monkeypatch.setattr(server._device, "obey", deaf)
        with on(name, server.port) as board:
            board.start()
            assert board.frames(0.5) or board.frames(3.0), name


def test_a_command_that_is_refused_is_named(serve: Serve) -> None:
    server = serve("sciospec", nominal=sensor("jku-tank-adjacent"))
    with (
        on("sciospec", server.port) as board,
        pytest.raises(BoardError, match="refuses the command b0 03 06 01 04 b0"),
    ):
        board.start()


def test_another_pattern_is_refused(serve: Serve) -> None:
    with on("teensy", serve("teensy", 40.0, sensor("foam16", offset=4)).port) as board:
        board.start()
        with pytest.raises(BoardError, match="is set to drive pattern 0x944d"):
            collect(board, 2.0)


def test_a_board_that_is_not_open_says_so() -> None:
    with pytest.raises(BoardError, match="is not open: open it first"):
        TeensyBoard(foam16(), "/dev/ttyACM0").start()


def test_a_host_that_does_not_read_loses_frames_and_the_numbers_show_it(serve: Serve) -> None:
    server = serve("teensy", 400.0)
    with on("teensy", server.port) as board:
        board.start()
        time.sleep(1.0)
        assert len(server._unsent) < 2 * 860
        frames = collect(board, 0.5)
        assert board.health.dropped > 0
        assert board.health.damaged == 0
        assert frames[-1].number + 1 == len(frames) + board.health.dropped


def fast(serve: Serve, seconds: float) -> None:
    """A board at ten times its rate: its frames add up, and memory does not grow."""
    process = psutil.Process()
    with on("teensy", serve("teensy", 100.0).port) as board:
        board.start()
        numbers = [frame.number for frame in board.frames(2.0)]
        before, end = process.memory_info().rss, time.monotonic() + seconds
        while time.monotonic() < end:
            numbers += [frame.number for frame in board.frames(0.1)]
        health = board.health
        assert (health.damaged, health.skipped_bytes) == (0, 0)
        assert health.frames == len(numbers) > 0
        assert health.frames + health.dropped == numbers[-1] + 1
        assert process.memory_info().rss - before < 8 << 20
        assert len(board._unread) < 1 << 16


def test_ten_times_the_rate(serve: Serve) -> None:
    fast(serve, 1.5)


@pytest.mark.slow
def test_ten_times_the_rate_for_a_minute(serve: Serve) -> None:
    fast(serve, 60.0)
