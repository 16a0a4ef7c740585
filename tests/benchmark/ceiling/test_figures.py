"""Figures of draws whose posterior is known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tests.support.small_sensors import foam, touch

from eitbench.benchmark.ceiling.figures import TRACES, rhat, summary, traces

SENSOR = foam((80, 80))


def test_traces_of_a_disc_are_its_place_strength_and_area() -> None:
    (found,) = traces(touch(SENSOR, at=(0.06, 0.04), radius=0.02, factor=0.4)[None], SENSOR)
    area = np.pi * 0.02**2
    np.testing.assert_allclose(found, [0.06, 0.04, 0.6 * area, area], rtol=0.03)


def test_traces_do_not_depend_on_the_background() -> None:
    grey = replace(SENSOR, background=0.4)
    one, other = (traces(touch(sensor)[None], sensor) for sensor in (SENSOR, grey))
    np.testing.assert_allclose(one, other)


def test_rhat_is_one_of_chains_that_agree_and_grows_with_their_distance() -> None:
    rng = np.random.default_rng(0)
    chains, even = rng.standard_normal((2, 4000)), np.full(4000, 1 / 4000)
    assert rhat(list(chains), [even, even]) < 1.002
    apart = [chains[0], chains[1] + 1]
    # The variance between means one deviation apart is 1 / 2.
    assert rhat(apart, [even, even]) == pytest.approx(np.sqrt(1.5), rel=0.03)
    stuck = [np.zeros(5), np.ones(5)]
    assert rhat(stuck, [np.full(5, 0.2)] * 2) == np.inf
    assert rhat([np.zeros(5)] * 2, [np.full(5, 0.2)] * 2) == 1
    # Weights of equal values sum to them but for rounding.
    uneven = [rng.dirichlet(np.ones(7)) for _ in range(2)]
    assert rhat([np.full(7, 0.1 / 3)] * 2, uneven) == 1


def frames(n: int, ranks: np.random.Generator, width: float) -> pd.DataFrame:
    """Frames whose ranks are uniform, or lie about the middle where `width` is below 1."""
    error = ranks.exponential(1e-3, n)
    return pd.DataFrame({
        "scenario": "x", "snr_db": 40.0, "cluster": range(n), "mse": error, "mse_walk": 1.1 * error,
        "mse_differences": error, "expected_mse": error, "rhat": 1.0, "effective": 0.5,
        **dict.fromkeys(("psnr", "ssim", "cc", "rie", "localisation_mm"), 1.0),
        **{f"rank_{name}": 0.5 + width * (ranks.random(n) - 0.5) for name in TRACES},
    })  # fmt: skip


def test_a_calibrated_posterior_has_uniform_ranks_and_others_do_not() -> None:
    (right,) = summary(frames(300, np.random.default_rng(1), 1.0)).to_dict("records")
    (wide,) = summary(frames(300, np.random.default_rng(1), 0.7)).to_dict("records")
    assert right["uniform_p"] > 0.01
    assert wide["uniform_p"] < 1e-4
    assert right["within_80"] == pytest.approx(0.8, abs=0.03)
    assert wide["within_80"] == 1


def test_samplers_that_differ_are_said_to() -> None:
    (row,) = summary(frames(100, np.random.default_rng(2), 1.0)).to_dict("records")
    assert row["apart_db"] == pytest.approx(-10 * np.log10(1.1))
    assert row["low"] < row["psnr_of_mse"] < row["high"]
    assert row["agreed"] == row["exact"] == 1
