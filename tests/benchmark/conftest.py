"""Fixtures of the tests of benchmark: a tiny suite, misbehaving methods, equal results."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest

from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.suites.suite import Suite, load_suite

DATA = Path(__file__).parent / "data"
MEASURED = [
    "setup_s", "first_frame_ms", "frame_ms_p50", "frame_ms_p95", "frame_ms_p99", "batch_fps",
    "forward_ms", "grad_ms", "memory_mb", "machine", "calibration_ms", "calibration_spread", "load",
    "cpu_mhz", "timed",
]  # fmt: skip


@pytest.fixture(scope="session")
def tiny() -> Suite:
    return load_suite(DATA / "tiny.toml")


@pytest.fixture(scope="session")
def data(tiny: Suite) -> Dataset:
    return load(tiny.scenarios[0])


@pytest.fixture(scope="session")
def toys() -> Path:
    return DATA / "toy_methods.py"


@pytest.fixture(scope="session")
def same_results() -> Callable[[Path, Path], None]:
    """Asserts that two runs are the same bit for bit, apart from times and memory."""

    def same(one: Path, other: Path) -> None:
        first, second = _results(one), _results(other)
        pd.testing.assert_frame_equal(first[0], second[0], check_exact=True)
        pd.testing.assert_frame_equal(first[1], second[1], check_exact=True)
        assert first[2].keys() == second[2].keys()
        for name, array in first[2].items():
            np.testing.assert_array_equal(array, second[2][name])

    return same


def _results(run: Path) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, Any]]:
    kind = "operator" if (run / "operators.parquet").is_file() else "method"
    order = ["scenario", kind]
    samples = pd.read_parquet(run / "samples.parquet").sort_values([*order, "sample"])
    table = pd.read_parquet(run / f"{kind}s.parquet").sort_values(order)
    arrays = "reconstructions.h5" if kind == "method" else "voltages.h5"
    with h5py.File(run / arrays) as file:
        images = {
            f"{scenario}/{name}/{array}": values[:]
            for scenario, groups in file.items()
            for name, group in groups.items()
            for array, values in group.items()
        }
    return (
        samples.drop(
            columns=["frame_ms", "uncertainty_ms", *MEASURED], errors="ignore"
        ).reset_index(drop=True),
        table.drop(columns=MEASURED, errors="ignore").reset_index(drop=True),
        images,
    )
