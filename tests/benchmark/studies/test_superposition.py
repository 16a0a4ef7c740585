"""The fit of two presses: exact where the sensor is linear, and what it says of the real skin."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.benchmark.studies.superposition import (
    explained,
    fitted_pairs,
    learned_directions,
    superposition,
)

Array = NDArray[np.float64]


def changes(places: Array) -> Array:
    """Smooth changes (n, 60) of 60 values by presses at `places` (n, 2) [m] of a made sensor."""
    rng = np.random.default_rng(3)
    centres, scale = rng.uniform(-0.06, 0.06, (60, 2)), rng.uniform(0.5, 2, 60)
    apart = np.linalg.norm(places[:, None] - centres, axis=2)
    return np.asarray(scale * np.exp(-(apart**2) / (2 * 0.025**2)))


@pytest.fixture(scope="module")
def known() -> Array:
    places = np.random.default_rng(1).uniform(-0.06, 0.06, (400, 2))
    return np.asarray(places[np.linalg.norm(places, axis=1) < 0.06])


def test_a_sum_is_explained_by_its_places_and_by_no_others(known: Array) -> None:
    directions = learned_directions(known, changes(known))
    pairs = np.array([[[0.03, 0.0], [-0.03, 0.01]], [[0.0, 0.04], [0.02, -0.02]]])
    total = 3 * changes(pairs[:, 0]) + changes(pairs[:, 1])
    assert (explained(directions, total, pairs) > 0.98).all()
    assert (explained(directions, total, pairs[:, :1]) < 0.97).all()
    assert (explained(directions, total, pairs @ np.array([[0.0, 1.0], [-1.0, 0.0]])) < 0.9).all()
    # A gain is no less than 0.
    assert explained(directions, -total, pairs) == pytest.approx(0, abs=1e-9)
    one = np.array([[[0.01, 0.02], [np.nan, np.nan]]])
    assert explained(directions, changes(one[:, 0]), one) == pytest.approx(1, abs=0.02)


def test_two_presses_are_found_on_the_grid(known: Array) -> None:
    directions = learned_directions(known, changes(known))
    pairs = np.array([[[0.032, 0.001], [-0.028, 0.011]], [[-0.003, 0.041], [0.021, -0.018]]])
    found = fitted_pairs(directions, changes(pairs[:, 0]) + 2 * changes(pairs[:, 1]))
    for true, at in zip(pairs, found, strict=True):
        apart = np.linalg.norm(true[:, None] - at, axis=2)
        # Both orders are right; the grid is 5 mm wide.
        assert min(np.trace(apart), np.trace(apart[::-1])) < 2 * 0.006


def test_real_pairs_are_sums_in_part(recorded_data: Path) -> None:
    """More than by turned places, and less than superposed pairs."""
    found = superposition().set_index(["kind", "distance_mm"])["median"]
    for distance in (20.0, 75.0, 108.0):
        real = found["real pairs", distance]
        assert found["real pairs, turned places", distance] + 0.2 < real
        assert real + 0.1 < found["superposed pairs", distance]
        assert real > 0.5
