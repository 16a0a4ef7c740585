"""One warm frame of each method on foam16, single-threaded. Run with `make bench`."""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create, methods
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.suite import load_suite, scenarios

METHODS = load_suite("paper").names


@pytest.mark.benchmark(group="one warm frame, foam16 at 50 dB", min_rounds=10)
@pytest.mark.parametrize("name", METHODS)
def test_one_frame(benchmark: BenchmarkFixture, name: str) -> None:
    data = load("paper-50db", limit=1)
    if why := methods()[name].unusable(data.sensor):
        pytest.skip(why)
    parameters = selected_parameters(scenarios()["paper-50db"], name) or {}
    method = create(name, **parameters)
    method.fit(Problem(data.sensor, data.reference, lambda split, n: load("paper-50db", split, n)))
    benchmark(method.reconstruct, data.voltages)
