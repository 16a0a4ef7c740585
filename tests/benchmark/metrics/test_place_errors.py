"""Errors of places over the skin, against values that can be counted or derived."""

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from eitbench.benchmark.metrics.aggregation import aggregate, figure_of
from eitbench.benchmark.metrics.place_errors import LEAST_PRESSES, local_errors
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import quantile

Array = NDArray[np.float64]


def disc(n: int, seed: int = 0) -> Array:
    """Places (n, 2) all over the unit disc."""
    rng = np.random.default_rng(seed)
    radius, angle = np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    return np.asarray(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def cell(error: Array, places: Array) -> pd.DataFrame:
    columns = {"localisation_mm": error, "expected_x_m": places[:, 0], "expected_y_m": places[:, 1]}
    return pd.DataFrame(columns)


def figures(error: Array, places: Array) -> dict[str, float]:
    names = ("localisation_p90_mm", "within_5_mm", "within_10_mm", "unevenness", "worst_tenth_mm")
    return {name: figure_of(cell(error, places), METRICS[name]) for name in names}


def test_quantiles_are_those_of_the_values_as_often_as_they_were_drawn() -> None:
    rng = np.random.default_rng(0)
    values, counts = rng.normal(size=50), rng.integers(0, 4, (20, 50)).astype(float)
    expected = [
        np.quantile(np.repeat(values, drawn.astype(int)), 0.9, method="inverted_cdf")
        for drawn in counts
    ]
    np.testing.assert_array_equal(quantile(counts, values, 0.9), expected)
    assert np.isnan(quantile(np.zeros((1, 50)), values, 0.9)).all()


def test_shares_and_the_ninetieth_percentile_are_counted() -> None:
    found = figures(np.arange(1.0, 201.0) / 10, disc(200))
    assert found["localisation_p90_mm"] == 18.0
    assert found["within_5_mm"] == 0.25  # 5.0 mm itself counts
    assert found["within_10_mm"] == 0.5


def test_a_blind_quarter_of_the_skin_is_uneven_and_is_the_worst_tenth() -> None:
    places = disc(4000)
    blind = (places > 0).all(axis=1)
    found = figures(np.where(blind, 20.0, 2.0), places)
    # A quarter of the presses has 20 mm and the rest 2 mm: mean 6.5, standard deviation 7.79.
    assert found["unevenness"] == pytest.approx(7.79 / 6.5, rel=0.03)
    assert found["worst_tenth_mm"] == 20.0
    mixed = np.random.default_rng(0).permutation(blind)  # as many, but everywhere
    spread = figures(np.where(mixed, 20.0, 2.0), places)
    assert spread["worst_tenth_mm"] == 2.0
    assert spread["localisation_p90_mm"] == found["localisation_p90_mm"]


def test_errors_that_do_not_depend_on_the_place_have_the_unevenness_that_the_card_tells() -> None:
    error = np.hypot(*np.random.default_rng(1).normal(size=(2, 2000)))
    assert figures(error, disc(2000))["unevenness"] == pytest.approx(0.15, abs=0.02)
    assert "0.15" in METRICS["unevenness"].traps


def test_neighbours_are_the_same_in_a_turned_mirrored_and_scaled_picture() -> None:
    places, error = disc(300), np.random.default_rng(2).exponential(size=300)
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])
    moved = 3 * places @ turn + [5, -2]
    np.testing.assert_array_equal(local_errors(error, moved), local_errors(error, places))


def test_few_presses_several_contacts_or_no_places_have_no_such_figures() -> None:
    few = figures(np.ones(LEAST_PRESSES - 1), disc(LEAST_PRESSES - 1))
    assert np.isnan([few["unevenness"], few["worst_tenth_mm"]]).all()
    assert few["within_5_mm"] == 1
    several = cell(np.ones(200), disc(200)).assign(farthest_contact_mm=1.0)
    without = pd.DataFrame({"localisation_mm": np.ones(200)})
    specs = [METRICS[name] for name in few]
    for rows in (several, without):
        assert np.isnan(aggregate(rows, specs, np.ones((2, 200)))).all()
