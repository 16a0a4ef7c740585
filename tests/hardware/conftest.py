"""What the tests of hardware share: a small sensor and frames of it."""

from collections.abc import Callable

import numpy as np
import pytest

from eitbench.hardware.board import Frame
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
