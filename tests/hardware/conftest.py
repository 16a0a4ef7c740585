"""What the tests of hardware share: a small sensor and frames of it."""

import time
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
from eitbench.scenarios.outlines import rectangle
from eitbench.scenarios.patterns import offset_pattern
from eitbench.scenarios.sensors import Sensor, even_electrodes

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
    """A board that sends frames of a list, some at a time, and may go away and come back."""

    def __init__(self, sensor: Sensor, frames: Sequence[Frame]) -> None:
        super().__init__(sensor)
        self.left = list(frames)
        self.calls: list[str] = []
        self.lost_after: int | None = None
        self.refusals = 0
        self.wait_s = 0.0

    def open(self) -> None:
        self.calls.append("open")
        if self.refusals:
            self.refusals -= 1
            raise BoardError("There is no such port.")

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
