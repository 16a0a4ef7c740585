"""Figures of stated uncertainty, beside formulas and draws of which the answer is known."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from eitbench.benchmark.metrics.uncertainty import (
    LEVELS,
    REMOVED,
    UNCERTAINTY,
    coverages,
    figures_of_draws,
    kept_of_draws,
    left_over,
    normal_draws,
    place_figures,
    root_mean_square,
    sample_figures,
    summary,
)
from eitbench.methods.method import DRAWS
from eitbench.scenarios import sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import locate

PIXELS = 40_000


def normal(width: float = 1.0, shift: float = 0.0) -> tuple[Array, Array]:
    """A standard normal truth (P,), and draws (K, P) of another width and place."""
    rng = np.random.default_rng(1)
    truth = rng.standard_normal(PIXELS)
    return truth, shift + width * rng.standard_normal((DRAWS, PIXELS))


def figures(truth: Array, draws: Array, image: Array, data_range: float) -> dict[str, Array]:
    """Figures of one frame, whose pixels all count."""
    found = figures_of_draws(truth[None], draws[None], image[None], data_range)
    return {name: values[0] for name, values in found.items()}


def test_figures_of_several_frames_are_those_of_each_inside_the_sensor() -> None:
    """Also of frames with equal deviations, or without a pixel that is ranked."""
    rng = np.random.default_rng(12)
    truth, draws = rng.random((3, 500)), rng.random((3, 7, 500))
    draws[1], draws[2] = draws[1].round(1), truth[2]
    images, inside = draws.mean(axis=1), rng.random(500) < 0.7
    together = figures_of_draws(truth, draws, images, 1.0, inside)
    draws[..., ~inside] = np.nan
    for n in range(3):
        alone = figures(truth[n, inside], draws[n][:, inside], images[n, inside], 1.0)
        for name, values in alone.items():
            np.testing.assert_allclose(together[name][n], values, rtol=1e-12)
    assert np.isnan(together["ranks"][2]).all()
    assert np.isfinite(together["ranks"][:2]).all()


def ranks(truth: Array, draws: Array) -> Array:
    """Shares of pixels by rank, of those that span more than 0.01."""
    return figures(truth, draws, truth, 1.0)["ranks"]


@pytest.mark.parametrize("width", [0.5, 1.0, 2.0])
def test_crps_is_that_of_the_normal_distribution(width: float) -> None:
    """Gneiting and Raftery (2007), eq. 21."""
    truth, draws = normal(width)
    z = truth / width
    exact = width * (z * (2 * stats.norm.cdf(z) - 1) + 2 * stats.norm.pdf(z) - 1 / np.sqrt(np.pi))
    found = figures(truth, draws, 0 * truth, 1.0)
    assert found["crps"] == pytest.approx(exact.mean(), rel=0.01)


def test_the_true_posterior_has_the_least_crps() -> None:
    right = figures(*normal(), np.zeros(PIXELS), 1.0)["crps"]
    for wrong in (normal(0.7), normal(1.4), normal(1.0, 0.4)):
        assert figures(*wrong, np.zeros(PIXELS), 1.0)["crps"] > 1.01 * right


@pytest.mark.parametrize("count", [2, 3, 8, DRAWS])
def test_crps_is_its_formula_for_draws_of_few_values(count: int) -> None:
    rng = np.random.default_rng(11)
    draws, truth = rng.integers(-2, 3, (count, 3000)) / 8, rng.integers(-2, 3, 3000) / 8
    apart = np.abs(draws[:, None] - draws[None]).sum(axis=(0, 1)) / (2 * count * (count - 1))
    exact = np.abs(draws - truth).mean(axis=0) - apart
    found = figures(truth, draws, truth, 1.0)
    assert found["crps"] == pytest.approx(exact.mean(), rel=1e-12)


def test_draws_of_one_image_have_the_absolute_error() -> None:
    truth, _ = normal()
    draws = np.full((DRAWS, PIXELS), 0.25)
    found = figures(truth, draws, draws[0], 1.0)
    assert found["crps"] == pytest.approx(np.abs(truth - 0.25).mean())
    assert found["sharpness"] == 0
    assert np.isnan(found["error_over_spread"])


def test_error_over_spread_of_a_right_posterior_is_1_even_of_few_degrees_of_freedom() -> None:
    """Of images that vary as wholes each frame has one: the mean of its ratio would be 0.8."""
    rng = np.random.default_rng(10)
    together = rng.standard_normal((4000, DRAWS + 1, 1)) * np.ones(4)
    ratios = figures_of_draws(together[:, 0], together[:, 1:], together[:, 1], 1.0)[
        "error_over_spread"
    ]
    rows = pd.DataFrame({"error_over_spread": ratios})
    (found,) = root_mean_square(rows, np.ones((1, len(rows))))
    few = np.sqrt((DRAWS - 1) / (DRAWS - 3))  # the mean of 1 / s^2 of as many draws
    assert found == pytest.approx(few, abs=0.03)


def test_sharpness_and_error_are_those_stated() -> None:
    for width in (0.5, 1.0):
        found = figures(*normal(width), np.zeros(PIXELS), 1.0)
        assert found["sharpness"] == pytest.approx(width, rel=0.01)
        expected = np.sqrt((1 + width**2 / DRAWS) / (width**2 * (1 + 1 / DRAWS)))
        assert found["error_over_spread"] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("kind", ["normal", "edges", "rare"])
def test_ranks_of_one_more_draw_are_uniform(kind: str) -> None:
    """Of pixels of two values, too, of which most draws are equal, and all may be."""
    rng = np.random.default_rng(2)
    values = rng.standard_normal((DRAWS + 1, PIXELS))
    if kind != "normal":
        likely = rng.random(PIXELS) ** (1 if kind == "edges" else 8)
        values = (rng.random((DRAWS + 1, PIXELS)) < likely).astype(float)
    shares = ranks(values[0], values[1:])
    assert shares.sum() == pytest.approx(1)
    np.testing.assert_allclose(shares, 1 / (DRAWS + 1), rtol=0.15)
    for level, name in zip(LEVELS, coverages(shares), strict=True):
        assert coverages(shares)[name] == pytest.approx(level / 100, abs=0.01)


@pytest.mark.parametrize(("width", "level"), [(0.5, 95), (0.5, 50), (2.0, 80)])
def test_coverage_of_wrong_widths_is_that_of_the_normal_distribution(
    width: float, level: int
) -> None:
    truth, draws = normal(width)
    shares = ranks(truth, draws)
    first = round((DRAWS + 1) * (1 - level / 100) / 2)  # of the draws that end the interval
    ends = (stats.beta(k, DRAWS + 1 - k) for k in (DRAWS + 1 - first, first))
    high, low = (end.expect(lambda u: stats.norm.cdf(width * stats.norm.ppf(u))) for end in ends)
    assert coverages(shares)[f"coverage_{level}"] == pytest.approx(high - low, abs=0.01)


def test_pixels_that_say_nothing_are_left_out() -> None:
    truth, draws = normal()
    quiet = np.ones(PIXELS)
    more = ranks(np.append(truth, quiet), np.hstack([draws, np.ones((DRAWS, PIXELS))]))
    np.testing.assert_allclose(more, ranks(truth, draws))
    assert np.isnan(ranks(quiet, np.ones((DRAWS, PIXELS)))).all()


def test_sparsification_of_the_right_order_and_of_none() -> None:
    errors = np.abs(normal()[0])
    chance = np.random.default_rng(3).random(PIXELS)
    equal = np.zeros(PIXELS)  # in whatever order pixels lie
    rising = np.sort(errors)
    right, none, alike = left_over(
        np.stack([errors, errors, rising]), np.stack([errors, chance, equal])
    )
    np.testing.assert_allclose(right[10], rising[: PIXELS // 2].mean())
    np.testing.assert_allclose(none, errors.mean(), rtol=0.05)
    np.testing.assert_allclose(alike, errors.mean())
    assert left_over(np.ones((1, 3)), np.ones((1, 3))).shape == (1, len(REMOVED))


def test_ause_is_the_error_that_a_wrong_order_leaves_over_that_of_all() -> None:
    """With draws 0 and 0, and +s and -s, deviations are in the order of s, whatever is true."""
    errors = np.linspace(0.01, 1, 200)
    image = np.zeros(200)

    def of(spread: Array) -> float:
        draws = np.outer([0, 0, 1, -1], spread)
        return float(figures(errors, draws, image, 1.0)["ause"])

    assert of(errors) == pytest.approx(0, abs=1e-9)
    left = np.round(200 * (1 - np.array(REMOVED))).astype(int)
    kept = [errors[-n:].mean() - errors[:n].mean() for n in left]  # those with the largest stay
    assert of(errors[::-1]) == pytest.approx(np.mean(kept) / errors.mean(), rel=1e-3)


def test_pixels_that_say_nothing_are_those_of_a_share_of_the_range() -> None:
    truth, draws = normal()
    narrow = np.where(np.arange(PIXELS) % 2, 1e-3, 1.0)  # half of them vary by 0.5 % of the range
    one = figures(truth * narrow, draws * narrow, truth, 1.0)["ranks"]
    seven = figures(7 * truth * narrow, 7 * draws * narrow, truth, 7.0)["ranks"]
    np.testing.assert_allclose(one, seven)
    every = figures(7 * truth * narrow, 7 * draws * narrow, truth, 1.0)["ranks"]
    assert np.abs(every - one).max() > 1e-4


def test_the_radius_of_places_holds_95_percent_of_those_drawn_in_mm() -> None:
    away = np.repeat(np.arange(1, 20), 2) * np.tile([1e-3, -1e-3], 19)  # and one in the middle
    places = np.stack([np.append(away, 0), np.zeros(39)], axis=1)
    found = place_figures(places[None], np.zeros((1, 2)))
    assert found["place_radius_mm"][0] == pytest.approx(19)  # 38 of 39 would be 18.1 between


def test_places_of_one_more_draw_are_covered_as_stated() -> None:
    rng = np.random.default_rng(4)
    together = rng.standard_normal((4000, DRAWS + 1, 2)) * [0.003, 0.001]
    found = place_figures(together[:, 1:], together[:, 0])
    for level in LEVELS:
        assert found[f"place_coverage_{level}"].mean() == pytest.approx(level / 100, abs=0.02)
    sure = place_figures(together[:, 1:] / 3, together[:, 0])
    assert sure["place_coverage_95"].mean() < 0.7
    assert np.median(sure["place_radius_mm"]) == pytest.approx(
        np.median(found["place_radius_mm"]) / 3
    )


def test_draws_without_a_contact_are_left_out_and_none_is_a_miss() -> None:
    rng = np.random.default_rng(9)
    together = rng.standard_normal((4000, DRAWS + 1, 2))
    empty = rng.random((4000, DRAWS)) < 0.9  # about four are left, of some frames none
    places = np.where(empty[..., None], np.nan, together[:, 1:])
    found = place_figures(places, together[:, 0])
    some = ~empty.all(axis=1)
    assert not some.all()
    for level in LEVELS:
        coverage = found[f"place_coverage_{level}"]
        assert coverage[some].mean() == pytest.approx(level / 100, abs=0.025)
        assert (coverage[~some] == 0).all()
    assert (np.isinf(found["place_radius_mm"]) == ~some).all()
    unknown = place_figures(places[:1], np.full((1, 2), np.nan))
    assert all(np.isnan(values).all() for values in unknown.values())


def test_normal_draws_have_the_stated_deviation_about_the_image() -> None:
    images, deviations = np.full((2, 100, 100), 0.7), np.full((2, 100, 100), 0.1)
    deviations[1] = 0.02
    draws = normal_draws(images, deviations)
    assert draws.shape == (2, DRAWS, 100, 100)
    np.testing.assert_allclose(draws.mean(axis=(1, 2, 3)), 0.7, atol=1e-3)
    np.testing.assert_allclose(draws.std(axis=(1, 2, 3)), [0.1, 0.02], rtol=0.01)


def test_a_deviation_that_does_not_fit_is_infinite_and_says_nothing(
    recwarn: pytest.WarningsRecorder,
) -> None:
    draws = normal_draws(np.zeros((1, 4, 4), np.float32), np.full((1, 4, 4), 3e38))
    assert not np.isfinite(draws).all()
    assert not recwarn.list


def test_what_is_kept_of_frames_becomes_columns() -> None:
    """Two discs whose depth varies as stated, one a frame; outside the sensor nothing counts.

    The truth and all draws have the same place, so that its rank is any of theirs.
    """
    foam = sensor("foam16")
    y, x = np.indices(foam.image_shape) / np.array(foam.image_shape)[:, None, None]
    discs = np.stack([np.hypot(x - 0.3, y - 0.5) < 0.15, np.hypot(x - 0.7, y - 0.4) < 0.1])
    depth = np.random.default_rng(5).uniform(0.3, 0.5, (2, DRAWS + 1, 1, 1))
    values = 1 - depth * discs[:, None]
    truth, draws = values[:, 0], values[:, 1:].astype(np.float32)
    images = draws.mean(axis=1)
    kept = kept_of_draws(truth, draws, images, foam, placed=True)
    true = locate(truth - 1, foam)
    columns = sample_figures(kept, kept["places"], true)
    assert columns.keys() == UNCERTAINTY.keys()
    for level in LEVELS:
        assert columns[f"place_coverage_{level}"] == pytest.approx(level / 100)
    np.testing.assert_allclose(kept["places"], np.repeat(true[:, None], DRAWS, 1), atol=1e-9)
    ranks = (depth[:, 1:] > depth[:, :1]).sum(axis=(1, 2, 3))  # the deeper, the lower
    np.testing.assert_allclose(kept["ranks"][[0, 1], ranks], 1)
    assert set(json.loads(summary(kept))) == {"ranks", "sparsified"}
    # A method that draws some frames alone would choose whose places count.
    kept["placed"][0] = 0
    some = sample_figures(kept, kept["places"], true)
    assert np.isnan(some["place_coverage_95"]).all()
    assert np.isfinite(columns["place_coverage_95"]).all()
    np.testing.assert_array_equal(some["crps"], columns["crps"])
    alone = kept_of_draws(None, draws, images, foam, placed=False)
    assert (alone.pop("placed") == 0).all()
    np.testing.assert_allclose(alone.pop("sharpness"), kept["sharpness"])
    assert all(np.isnan(values).all() for values in alone.values())
    assert summary(alone) == ""
