"""100 frames of the default sensor through each parser, single-threaded. Run with `make bench`."""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from eitbench.hardware.protocols import PROTOCOLS
from eitbench.scenarios.catalogue import sensor

FRAMES = 100
READ = 4096  # bytes; what a port gives at once


@pytest.mark.benchmark(group="100 frames from bytes, 192 or 208 values each", min_rounds=10)
@pytest.mark.parametrize("name", PROTOCOLS)
def test_frames(benchmark: BenchmarkFixture, name: str) -> None:
    nominal = sensor(PROTOCOLS[name].default_sensor)
    device, parser = PROTOCOLS[name].device(nominal), PROTOCOLS[name](nominal)
    for command in parser.starting():
        device.obey(command)
    values = np.random.default_rng(0).normal(size=(FRAMES, nominal.n_measurements))
    data = b"".join(device.encode(k, k / 10, frame) for k, frame in enumerate(values))
    pieces = [data[at : at + READ] for at in range(0, len(data), READ)]

    def parse() -> int:
        return sum(len(parser.feed(piece, 0.0)) for piece in pieces)

    assert benchmark(parse) == FRAMES
    benchmark.extra_info["samples"] = FRAMES
    if benchmark.stats is not None:
        benchmark.extra_info["frames_per_s"] = FRAMES / benchmark.stats.stats.median
