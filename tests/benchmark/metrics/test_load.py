"""The line from strength to load, and what is refused of a stored one."""

import json

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.metrics.load import LoadCalibration, fit_load


def test_a_line_is_stored_without_loss() -> None:
    samples = pd.DataFrame({"force_N": [1.0, 2.0, 4.0]})
    line = fit_load(samples, [0.1, 0.2, 0.31])
    assert line is not None
    assert LoadCalibration.from_json(line.to_json()) == line
    a, b = np.polynomial.polynomial.polyfit([0.1, 0.2, 0.31], samples["force_N"], 1)
    np.testing.assert_allclose([line.offset, line.slope], [a, b])
    np.testing.assert_allclose(line.error([0.2], samples[1:2]), abs(a + 0.2 * b - 2))


def test_images_that_weaken_with_the_load_get_its_mean() -> None:
    line = fit_load(pd.DataFrame({"force_N": [1.0, 2.0, 3.0]}), [3.0, 2.0, 1.0])
    assert line == LoadCalibration("force_N", 2.0, 0.0, 3.0)


def test_a_force_counts_before_a_pressure() -> None:
    both = pd.DataFrame({"force_N": [1.0, 2.0, 3.0], "pressure_pa": [1.0, 2.0, 3.0]})
    assert fit_load(both, [1, 2, 3]).quantity == "force_N"  # type: ignore[union-attr]
    few = both.assign(force_N=[1.0, np.nan, np.nan])
    assert fit_load(few, [1, 2, 3]).quantity == "pressure_pa"  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "stored",
    [
        ["x_m", 0, 1, 1], ["force_N", 0, -1, 1], ["force_N", 0, 1, 0], ["force_N", 0, 1],
        ["force_N", float("nan"), 1, 1], ["force_N", 0, 1, float("inf")], [], 3,
    ],
)  # fmt: skip
def test_what_is_no_line_is_refused(stored: object) -> None:
    with pytest.raises((ValueError, TypeError)):
        LoadCalibration.from_json(json.dumps(stored))
