"""Similarities of the plane, recovered from points."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eitbench.scenarios.similarity import fit_similarity, registered_in_parts


@given(
    angle=st.floats(0, 6.28),
    scale=st.floats(0.1, 10),
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    mirrored=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_similarity_is_recovered(
    angle: float, scale: float, shift: tuple[float, float], mirrored: bool, seed: int
) -> None:
    points = np.random.default_rng(seed).standard_normal((12, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if mirrored:
        turn = turn @ np.diag([1, -1])
    target = scale * points @ turn.T + shift
    lost = np.vstack([points, [np.nan, np.nan]])
    fitted = fit_similarity(lost, np.vstack([target, [0.0, 0.0]]))
    assert fitted is not None
    np.testing.assert_allclose(fitted(points), target, atol=1e-9)
    np.testing.assert_allclose(fitted.inverse(target), points, atol=1e-9)
    np.testing.assert_allclose(fitted.turn, turn, atol=1e-9)


def test_points_that_determine_no_similarity_give_none() -> None:
    target = np.random.default_rng(0).standard_normal((5, 2))
    line = np.linspace(0, 1, 5)[:, None] * [1.0, 2.0]
    assert fit_similarity(np.zeros((5, 2)), target) is None
    assert fit_similarity(line, target) is None
    assert fit_similarity(np.full((5, 2), np.nan), target) is None
    assert fit_similarity(target[:2], target[:2]) is None
    assert fit_similarity(target, np.ones((5, 2))) is None
    for place in ([0.03, 0.02], [0.0, 0.0]):  # always the same, but for rounding
        same = np.array(place) + 1e-17 * np.random.default_rng(1).standard_normal((5, 2))
        assert fit_similarity(same, target) is None
    for angle in np.linspace(0.1, 3, 30):  # of most, rounding leaves a little beside the line
        turned = np.linspace(0, 1, 5)[:, None] * [np.cos(angle), np.sin(angle)] + 0.3
        assert fit_similarity(turned, target) is None


def test_each_part_is_judged_by_the_similarity_of_the_others() -> None:
    found = np.random.default_rng(0).uniform(0, 0.1, (20, 2))
    places = 2 * found @ np.array([[0, 1], [-1, 0]]) + 0.3
    np.testing.assert_allclose(registered_in_parts(found, places), 0, atol=1e-9)
    wrong = places.copy()
    wrong[[0, 5, 10, 15]] += [0.03, 0.04]  # all of one part, which alone would fit itself
    distances = registered_in_parts(found, wrong, 5)
    np.testing.assert_allclose(distances[::5], 0.05, rtol=1e-6)
    lost = places.copy()
    lost[3] = np.nan
    assert np.isnan(registered_in_parts(found, lost)).sum() == 1
    assert np.isnan(registered_in_parts(found[:3], places[:3])).all()


def test_three_points_are_enough() -> None:
    points = np.random.default_rng(3).standard_normal((3, 2))
    fitted = fit_similarity(points, 2 * points + 1)
    assert fitted is not None
    np.testing.assert_allclose(fitted(points), 2 * points + 1, atol=1e-9)


def test_a_similarity_survives_contacts_that_were_found_elsewhere() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((60, 2))
    target = 2 * points[:, ::-1] + np.array([5.0, 1.0])
    points[:15] = rng.standard_normal((15, 2))
    fitted = fit_similarity(points, target)
    assert fitted is not None
    np.testing.assert_allclose(fitted(points[15:]), target[15:], atol=0.05)
