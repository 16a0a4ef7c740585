"""Cost of recording 10,000 frames of 208 values, a second of the fastest board.

`pytest tests/speed/test_speed_recorder.py --benchmark-only` prints the times.
"""

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.loop import Monitor
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import sensor
from eitbench.scenarios.recordings.files.recording_file import read_file


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    draws = np.random.default_rng(0).normal(size=(10_000, 208))
    return [Frame(k, k / 1e4, k / 1e4, values) for k, values in enumerate(draws)]


def write(path: Path, frames: list[Frame]) -> None:
    with Recorder(path, sensor("foam16"), "fake") as recorder:
        for frame in frames:
            recorder.append(frame)


@pytest.mark.benchmark(group="10,000 frames of 208 values")
def test_recording(benchmark: Any, frames: list[Frame], tmp_path: Path) -> None:
    numbers = count()
    benchmark(lambda: write(tmp_path / f"{next(numbers)}.h5", frames))


@pytest.mark.benchmark(group="10,000 frames of 208 values")
def test_reading(benchmark: Any, frames: list[Frame], tmp_path: Path) -> None:
    write(tmp_path / "a.h5", frames)
    content, _ = benchmark(lambda: read_file(tmp_path / "a.h5"))
    assert len(content) == len(frames)


@pytest.mark.benchmark(group="one status line")
def test_status(benchmark: Any, frames: list[Frame]) -> None:
    monitor = Monitor(sensor("foam16"))
    monitor.add(frames[:50])
    benchmark(lambda: monitor.status(0).line())
