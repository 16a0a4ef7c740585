"""Fixtures of all tests of hardware: a small sensor and its frames, and byte streams of boards."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame, Health
from eitbench.hardware.emulation.board_server import BoardServer
from eitbench.hardware.protocols import PROTOCOLS, Protocol
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Frames = Callable[[int], list[Frame]]


@pytest.fixture(scope="session")
def skin() -> Sensor:
    """Eight electrodes, 40 values."""
    outline = rectangle(0.08, 0.06)
    electrodes = even_electrodes(outline, 8, 0.01, 1e-3, start=0.02)
    return Sensor("skin", outline, electrodes, offset_pattern(8, 3), image_shape=(12, 16))


@pytest.fixture
def frames(skin: Sensor) -> Frames:
    """The first n frames, ten a second."""

    def make(n: int) -> list[Frame]:
        draws = np.random.default_rng(3).normal(size=(n, skin.n_measurements))
        return [Frame(k, k / 10, 5 + k / 10, values) for k, values in enumerate(draws)]

    return make


class FakeBoard(Board):
    """A board that sends the frames of a list, some at a time, and may go away and come back.

    Attributes:
        lost_after: calls of `frames` until it is lost; None for never.
        refusals: attempts to open it that fail.
        refusal: the error of those.
        wait_s: how long each call of `frames` takes [s].
        endless: it does not end with its last frame.
    """

    def __init__(self, sensor: Sensor, frames: Sequence[Frame]) -> None:
        super().__init__(sensor)
        self.left = list(frames)
        self.calls: list[str] = []
        self.lost_after: int | None = None
        self.refusals = 0
        self.refusal: BoardError = BoardLostError("There is no such port.")
        self.wait_s = 0.0
        self.endless = False

    @property
    def ended(self) -> bool:
        return not (self.left or self.endless)

    def open(self) -> None:
        self.calls.append("open")
        if self.refusals:
            self.refusals -= 1
            raise self.refusal
        self.health = Health()

    def start(self) -> None:
        self.calls.append("start")

    def frames(self, wait_s: float) -> list[Frame]:
        if self.lost_after == 0:
            self.lost_after = None
            raise BoardLostError("The board is gone.")
        if self.lost_after is not None:
            self.lost_after -= 1
        time.sleep(self.wait_s)
        now, self.left = self.left[:2], self.left[2:]
        if not now:
            time.sleep(min(wait_s, 0.01))
        return now

    def stop(self) -> None:
        self.calls.append("stop")

    def close(self) -> None:
        self.calls.append("close")


@pytest.fixture
def board(skin: Sensor) -> Callable[[Sequence[Frame]], FakeBoard]:
    """A fake board with the given frames."""
    return lambda frames: FakeBoard(skin, frames)


# V/A of one unit of a board's values, and what it rounds to [V/A], where it sends text.
UNITS = {"openeit": 1e-3}
STEPS = {"openeit": 1e-7, "eit-kit": 1e-4}


@dataclass
class Stream:
    """Bytes of a board: `messages[k]` holds the frame `values[k]` (M,) [V/A]."""

    sensor: Sensor
    protocol: type[Protocol]
    values: NDArray[np.float64]
    messages: list[bytes]

    def parser(self) -> Protocol:
        return self.protocol(self.sensor)

    def holds(self, k: int, received: NDArray[np.float64]) -> bool:
        """True if `received` is frame `k`, to what the protocol rounds to."""
        name = self.protocol.name
        error = np.abs(received * UNITS.get(name, 1.0) - self.values[k]).max()
        return bool(error <= STEPS.get(name, 1e-5))


def make_stream(name: str, count: int, nominal: Sensor | None = None) -> Stream:
    protocol = PROTOCOLS[name]
    nominal = nominal or sensor(protocol.default_sensor)
    # Differences of potentials, so that a board that sends potentials can send them, too.
    shape = (count, nominal.n_electrodes, nominal.n_electrodes)
    potentials = np.random.default_rng(1).normal(size=shape)
    src, _, a, b = nominal.pattern.table.T
    values = potentials[:, src, a] - potentials[:, src, b]
    if nominal.pattern.magnitudes:
        values = np.abs(values)
    device = protocol.device(nominal)
    for command in protocol(nominal).starting():
        device.obey(command)
    assert device.running
    messages = [device.encode(k, 0.1 * k, frame) for k, frame in enumerate(values)]
    return Stream(nominal, protocol, values, messages)


@pytest.fixture
def stream() -> Callable[..., Stream]:
    """Make a stream: name of the protocol, number of frames, sensor (default: the board's)."""
    return make_stream


@pytest.fixture(params=sorted(PROTOCOLS))
def name(request: pytest.FixtureRequest) -> str:
    """The name of each protocol."""
    return str(request.param)


@pytest.fixture
def serve() -> Iterator[Callable[..., BoardServer]]:
    """Switch on a board whose frames are all the same; it is switched off after the test."""
    servers = []

    def switch_on(name: str, rate_hz: float = 10.0, nominal: Sensor | None = None) -> BoardServer:
        chosen = nominal or sensor(PROTOCOLS[name].default_sensor)
        values = make_stream(name, 1, chosen).values[0]
        server = BoardServer(PROTOCOLS[name], chosen, lambda time_s: values, rate_hz)
        server.start()
        servers.append(server)
        return server

    yield switch_on
    for server in servers:
        server.stop()


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """A bare pseudo-terminal: the end of the board, and the port."""
    pty = pytest.importorskip("pty")  # not on Windows
    board_end, host_end = pty.openpty()
    port = os.ttyname(host_end)
    os.close(host_end)
    yield board_end, port
    os.close(board_end)
