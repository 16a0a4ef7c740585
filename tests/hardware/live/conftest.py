"""A board without hardware, and a live view of it that is served."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.waiting import wait_for

from eitbench.hardware.board import Board, BoardLostError, Frame
from eitbench.hardware.live.run import LiveView, live_view
from eitbench.hardware.live.server import Access
from eitbench.hardware.live.session import Session
from eitbench.hardware.live.viewer import LiveImage
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.files.recording_file import Content, read_file
from eitbench.scenarios.sensors.sensor import foam16

Array = NDArray[np.float64]


class FoamBoard(Board):
    """Simulated foam that can be pressed and unplugged; 60 dB of noise.

    Attributes:
        sent: the frames it has handed out.
        faulty: the error that `frames` raises next.
    """

    can_be_pressed = True

    def __init__(self, rate_hz: float = 50.0, gain: float = 1.0) -> None:
        super().__init__(foam16(), emulated=True)
        self.rate_hz = rate_hz
        self.gain = gain
        self.sent: list[Frame] = []
        self.faulty: Exception | None = None
        self.opened = 0
        self._model = forward_model(self.sensor)
        self._untouched = self._clean = self._model.voltages(self._model.background)
        self._rng = np.random.default_rng(0)
        self._plugged = threading.Event()
        self._plugged.set()
        self._next_s = 0.0

    def open(self) -> None:
        if not self._plugged.is_set():
            raise BoardLostError("There is no port.")
        self.opened += 1

    def start(self) -> None:
        self._next_s = time.monotonic()

    def frames(self, wait_s: float) -> list[Frame]:
        if self.faulty is not None:
            error, self.faulty = self.faulty, None
            raise error
        if not self._plugged.is_set():
            raise BoardLostError("The board was unplugged.")
        time.sleep(max(0.0, min(wait_s, self._next_s - time.monotonic())))
        now = time.monotonic()
        if now < self._next_s:
            return []
        self._next_s += 1 / self.rate_hz
        noise = 1e-3 * np.sqrt(np.mean(self._clean**2)) * self._rng.standard_normal(208)
        values = self.gain * (self._clean + noise)
        self.sent.append(Frame(len(self.sent), now, now, values))
        return self.sent[-1:]

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass

    def press(self, x_m: float, y_m: float, radius_m: float, pressure_pa: float) -> None:
        x, y = self.sensor.pixel_centres
        distance = np.maximum(np.hypot(x - x_m, y - y_m) - radius_m, 0.0)
        self._clean = self._model.voltages(FOAM.pressed(pressure_pa, distance))

    def release(self) -> None:
        self._clean = self._untouched

    def unplug(self) -> None:
        self._plugged.clear()

    def plug(self) -> None:
        self._plugged.set()


class Watched:
    """A session with the images it has shown."""

    def __init__(self, board: Any, out: Path, parameters: Any) -> None:
        self.images: list[LiveImage] = []
        self.show: Callable[[LiveImage], None] = self.images.append
        self.session = Session(
            board,
            "emulator",
            out=out,
            show=lambda live_image: self.show(live_image),
            parameters=parameters,
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
    def newest(self) -> LiveImage:
        return self.images[-1]


@pytest.fixture
def board() -> FoamBoard:
    return FoamBoard()


@pytest.fixture
def watch(tmp_path: Path) -> Iterator[Callable[..., Watched]]:
    """Makes a session of a board, without a server."""
    with ExitStack() as running:

        def make(board: Board, parameters: Any = MappingProxyType({})) -> Watched:
            watched = Watched(board, tmp_path, parameters)
            running.callback(watched.session.stop)
            return watched

        yield make


@pytest.fixture
def watched(watch: Callable[..., Watched], board: FoamBoard) -> Watched:
    return watch(board)


@pytest.fixture
def running(watched: Watched) -> Watched:
    """A session that shows images."""
    watched.session.start("noser")
    wait_for(lambda: watched.images and watched.newest.image is not None)
    return watched


@pytest.fixture
def served(board: FoamBoard, tmp_path: Path) -> Iterator[Callable[..., LiveView]]:
    """Serves a live view of `board`, or of another one, on a free port."""
    with ExitStack() as running:

        def serve(access: Access | None = None, other: Board | None = None) -> LiveView:
            view = running.enter_context(
                live_view(
                    other or board,
                    "emulator",
                    "noser",
                    access=access or Access(),
                    port=0,
                    out=tmp_path,
                )
            )
            thread = threading.Thread(target=view.serve, daemon=True)
            thread.start()
            running.callback(thread.join)
            running.callback(setattr, view.server, "should_exit", True)
            return view

        yield serve
