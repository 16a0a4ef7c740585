"""The figure of voltages: what it shows is what the run holds."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark import DataCorruptError
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.run_arrays import TRUTH, read_responses, read_touch
from eitbench.reports.figures.voltages import draw, voltage_figures, write_voltages

M, N = 12, 4


@pytest.fixture
def run(build_operators: Callable[..., Path]) -> Path:
    """Two operators; in the samples of the worse one the errors are 1, 2, 3 and 4."""
    path = build_operators({"fem": 1e-9, "jacobian": 1e-3})
    table = pd.read_parquet(path / "samples.parquet")
    table.loc[table["operator"] == "jacobian", "mse"] = [3.0, 1.0, 4.0, 2.0]
    table.to_parquet(path / "samples.parquet")
    voltages = np.arange(N * M, dtype=float).reshape(N, M)
    with h5py.File(path / "voltages.h5", "w") as file:
        for name, off in ((TRUTH, 0.0), ("fem", 1e-6), ("jacobian", 0.5)):
            group = file.create_group(f"paper/{name}")
            group["sample"] = np.arange(N)
            group["voltages"] = voltages + off
        truth = file[f"paper/{TRUTH}"]
        truth["reference"] = np.full(M, 2.0)
        truth["conductivity"] = np.arange(N, dtype=np.float32)[:, None, None] * np.ones((N, 3, 5))
        truth.attrs["bounds"] = (0.0, 0.0, 0.5, 0.3)
    return path


def test_responses_are_voltages_minus_the_reference(run: Path) -> None:
    found = read_responses(run / "voltages.h5", "paper", ["jacobian"], 2, 4)
    np.testing.assert_array_equal(found[TRUTH], np.arange(24, 36) - 2.0)
    np.testing.assert_array_equal(found["jacobian"], np.arange(24, 36) - 1.5)
    with pytest.raises(DataCorruptError, match=r"voltages.h5"):
        read_responses(run / "voltages.h5", "paper", ["surrogate"], 2, 4)


def test_a_typical_sample_of_the_last_operator_is_drawn(run: Path) -> None:
    ((scenario, figure),) = voltage_figures(read_run(run))
    assert scenario == "paper"
    assert figure.get_suptitle() == "paper, sample 0"  # of errors 3, 1, 4 and 2 the upper median
    written = write_voltages(run)
    assert [path.name for path in written] == ["voltages-paper.png", "voltages-paper.pdf"]
    assert all(path.stat().st_size > 5000 for path in written)


def test_lines_hold_responses_and_relative_errors(run: Path) -> None:
    responses = read_responses(run / "voltages.h5", "paper", ["fem", "jacobian"], 0, 4)
    image, bounds = read_touch(run / "voltages.h5", "paper", 2, 4)
    figure = draw(responses, image, bounds, "paper, sample 2")
    touch, above, below = figure.axes[:3]
    (shown,) = touch.images
    np.testing.assert_array_equal(np.asarray(shown.get_array()), np.full((3, 5), 2.0))
    assert tuple(shown.get_extent()) == (0.0, 0.5, 0.0, 0.3)
    lines = {str(line.get_label()).strip(): line for line in above.get_lines()}
    assert list(lines) == ["exact model", "jacobian", "fem"]  # the best one on top
    response = np.asarray(lines["jacobian"].get_ydata(), float)
    np.testing.assert_allclose(response, 1e3 * responses["jacobian"])
    rms = np.sqrt(np.mean(responses[TRUTH] ** 2))
    worse, better = (np.asarray(line.get_ydata(), float) for line in below.get_lines())
    np.testing.assert_allclose(worse, 0.5 / rms)
    np.testing.assert_allclose(better, 1e-6 / rms, rtol=1e-6)


def test_runs_of_methods_have_none(full_run: Path) -> None:
    assert write_voltages(full_run) == []
