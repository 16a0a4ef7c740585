"""The study of bounds on real skins, on skins whose noise, response and touches are known."""

from dataclasses import replace

import numpy as np
import pytest
from docs.studies.design.record import (
    MEDIAN,
    bound_of_response,
    covariance_of_noise,
    left_by_model,
    model_changes,
    most_likely,
)

from eitbench.scenarios import sensor


def test_noise_is_that_of_neighbours_whatever_the_response() -> None:
    rng = np.random.default_rng(2)
    mixed = np.eye(12) + 0.2 * rng.normal(size=(12, 12))
    places = np.repeat(0.04 * rng.uniform(-1, 1, (2000, 2)), 4, axis=0)
    places += 1e-5 * rng.normal(size=places.shape)
    depths = np.tile([10.0, 10.0, 15.0, 15.0], 2000)  # a neighbour of another depth does not count
    response = np.sin(places @ rng.normal(size=(2, 12)) / 0.02) + depths[:, None]
    changes = response + 0.1 * rng.normal(size=(8000, 12)) @ mixed
    found = covariance_of_noise(changes, places, depths)
    truth = 0.01 * mixed.T @ mixed
    # Outliers are left out, which takes a little of the noise as well.
    np.testing.assert_allclose(found, truth, atol=0.05 * truth.max())


def test_bound_of_a_response_is_what_a_fit_of_place_and_strength_scatters() -> None:
    rng = np.random.default_rng(3)
    slopes, mean = rng.normal(size=(2, 9)), rng.normal(size=9)
    mixed = np.eye(9) + 0.3 * rng.normal(size=(9, 9))
    places = np.array([[0.01, -0.02]])

    def response(at: np.ndarray) -> np.ndarray:
        return 1e3 * at @ slopes + 10 * mean

    bound = bound_of_response(response, mixed @ mixed.T, places)[0] / MEDIAN
    # d = q (slopes x + mean) is linear in q x, q y and q.
    design = np.linalg.solve(mixed, np.vstack([1e3 * slopes, 10 * mean]).T)
    frames = np.linalg.solve(mixed, response(places)[0]) + rng.normal(size=(20_000, 9))
    fits = frames @ np.linalg.pinv(design).T
    found = fits[:, :2] / fits[:, 2:]
    assert bound == pytest.approx(np.sqrt(np.var(found, axis=0).sum()), rel=0.05)


def test_the_most_likely_place_of_a_modelled_change_is_its_own() -> None:
    small = replace(sensor("ohmc8"), image_shape=(24, 24))
    rng = np.random.default_rng(4)
    mixed = np.eye(32) + 0.1 * rng.normal(size=(32, 32))
    places = np.array([[0.0, 0.0], [0.03, -0.02], [-0.05, 0.01]])
    changes = 3 * model_changes(small, places)
    np.testing.assert_allclose(left_by_model(changes, changes / 7), 0, atol=1e-9)
    found = most_likely(small, mixed @ mixed.T, changes)
    assert (np.abs(found - places) <= np.array(small.pixel_size)).all()
