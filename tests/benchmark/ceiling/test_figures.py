"""Figures of draws whose posterior is known."""

from dataclasses import replace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from tests.support.small_sensors import foam, touch

from eitbench.benchmark.ceiling.agreement import TRACES, rhat, traces
from eitbench.benchmark.ceiling.drawing import priors_of
from eitbench.benchmark.ceiling.figures import _frame, summary
from eitbench.benchmark.ceiling.models import images
from eitbench.benchmark.ceiling.moves import PROPOSALS
from eitbench.benchmark.ceiling.sampler import Draws
from eitbench.scenarios import load
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.suites.scenario import SimulatedScenario

SENSOR = foam((80, 80))
SCENARIO = SimulatedScenario(
    name="tiny", image_shape=(16, 16), families=("circle",), train=0, validation=0, test=3
)


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


def test_rhat_is_of_the_mean_variance_within_chains() -> None:
    rng = np.random.default_rng(0)
    narrow, wide = rng.standard_normal(4000), 3 * rng.standard_normal(4000) + 1
    even = np.full(4000, 1 / 4000)
    assert rhat([narrow, wide], [even, even]) == pytest.approx(np.sqrt(1 + 0.5 / 5), rel=0.01)


def test_the_squared_error_is_the_product_of_the_errors_of_two_samplers() -> None:
    """The square of the error of their mean would hold what chance does to their draws."""
    data = load(SCENARIO, "test", 1)
    assert data.conductivity is not None
    priors = priors_of(SCENARIO)
    drawn = {
        name: Draws(
            np.zeros(2, int),
            priors[0].draw(2, np.random.default_rng(k)),
            weights,
            np.zeros(2),
            effective=0.4 + 0.5 * k,
            log_evidence=0.0,
        )
        for k, (name, weights) in enumerate(
            zip(PROPOSALS, np.array([[0.3, 0.7], [0.6, 0.4]]), strict=True)
        )
    }
    families = [prior.parameters for prior in priors]
    row, mean = _frame(data, 0, data.conductivity[0], drawn, families)
    alone = [
        np.tensordot(of.weights, images(families, of.families, of.vectors), axes=1)
        for of in drawn.values()
    ]
    first, second = (image - data.conductivity[0] for image in alone)  # background and range are 1
    assert row["mse"] == pytest.approx(np.mean(first * second))
    assert row["mse"] != pytest.approx(np.mean(((first + second) / 2) ** 2), rel=0.05)
    assert row["mse_walk"] == pytest.approx(np.mean(first**2))
    assert row["mse_differences"] == pytest.approx(np.mean(second**2))
    np.testing.assert_allclose(mean, (alone[0] + alone[1]) / 2)
    # The variance of all draws, by their weights, about the mean of both.
    weights = np.concatenate([of.weights for of in drawn.values()]) / 2
    painted = np.concatenate([images(families, of.families, of.vectors) for of in drawn.values()])
    assert row["expected_mse"] == pytest.approx(
        weights @ ((painted - mean) ** 2).mean(axis=(1, 2)), rel=1e-6
    )
    traced = traces(painted, data.sensor)
    away = np.sqrt(weights @ (traced - weights @ traced) ** 2)
    assert [row[f"sd_{name}"] for name in TRACES] == pytest.approx(away.tolist())
    chains = [(traced[:2], drawn["walk"]), (traced[2:], drawn["differences"])]
    of_traces = [
        rhat([of[:, t] for of, _ in chains], [d.weights for _, d in chains])
        for t in range(len(TRACES))
    ]
    assert row["rhat"] == max(of_traces) > 1.1 * min(of_traces)
    assert row["effective"] == 0.4  # of the sampler that has less
    (true,) = traces(data.conductivity[:1], data.sensor)
    ranks = [row[f"rank_{name}"] for name in TRACES]
    assert ranks == pytest.approx((weights @ (traced < true)).tolist())
    assert len({*ranks}) > 1
    # Of what is not touched all traces are 0; of what is touched everywhere, area and strength.
    for truth, rank, names in ((1.0, 0, TRACES), (0.1, 1, TRACES[2:])):
        row, _ = _frame(data, 0, np.full_like(data.conductivity[0], truth), drawn, families)
        assert [row[f"rank_{name}"] for name in names] == pytest.approx([rank] * len(names))


def test_a_truth_that_all_draws_have_is_at_any_rank_and_families_weigh_as_their_draws() -> None:
    both = SCENARIO.model_copy(update={"families": ("circle", "ring"), "test": 12})
    data, priors = load(both, "test"), priors_of(both)
    longest = max(prior.draw(1, np.random.default_rng(0)).shape[1] for prior in priors)
    vectors = np.zeros((3, longest))
    for k, prior in enumerate((priors[0], priors[1], priors[1])):
        (one,) = prior.draw(1, np.random.default_rng(k))
        vectors[k, : len(one)] = one
    which, weights = np.array([0, 1, 1]), np.array([0.5, 0.2, 0.3])
    drawn = {name: Draws(which, vectors, weights, np.zeros(3), 1.0, 0.0) for name in PROPOSALS}
    families = [prior.parameters for prior in priors]
    (truth,) = images(families, which[:1], vectors[:1])
    found = []
    for sample in range(12):
        row, _ = _frame(data, sample, truth, drawn, families)
        assert row["likely_circle"] == pytest.approx(0.5)
        assert row["likely_ring"] == pytest.approx(0.5)
        found.append(cast("float", row["rank_x"]))
    (first, *others) = traces(images(families, which, vectors), data.sensor)[:, 0]
    below = weights[1:] @ (np.array(others) < first)
    assert below <= min(found) < max(found) <= below + 0.5
    assert max(found) - min(found) > 0.2  # chance says where


def test_a_truth_with_the_pixels_of_all_draws_is_at_any_rank_of_places() -> None:
    """Their places differ by rounding, as their conductivities are others."""
    data, (prior,) = load(SCENARIO, "test"), priors_of(SCENARIO)
    circle = prior.draw(1, np.random.default_rng(2))[0]
    vectors = np.repeat(circle[None], 41, axis=0)
    vectors[:, -1] = np.linspace(0.1, 0.4, 41)
    families, which = [prior.parameters], np.zeros(41, int)
    truth, *painted = images(families, which, vectors)
    x = traces(np.array([truth, *painted]), data.sensor)[:, 0]
    assert 0 < np.ptp(x) < 1e-15
    draws = Draws(which[1:], vectors[1:], np.full(40, 1 / 40), np.zeros(40), 1.0, 0.0)
    for sample in range(3):
        row, _ = _frame(data, sample, truth, dict.fromkeys(PROPOSALS, draws), families)
        chance = generator("ceiling", "ties", "tiny", sample).random(len(TRACES))
        chance[2] = 1  # of strength: the weakest touch has the least conductivity
        assert [row[f"rank_{name}"] for name in TRACES] == pytest.approx(chance.tolist())


def frames(n: int, ranks: np.random.Generator, width: float) -> pd.DataFrame:
    """Frames whose ranks are uniform, or lie about the middle where `width` is below 1."""
    error = ranks.exponential(1e-3, n)
    return pd.DataFrame({
        "scenario": "x", "snr_db": 40.0, "cluster": range(n), "mse": error, "mse_walk": 1.1 * error,
        "mse_differences": error, "expected_mse": error, "rhat": 1.0, "effective": 0.5,
        **dict.fromkeys(("psnr", "ssim", "cc", "rie", "localisation_mm"), 1.0),
        **{f"rank_{name}": 0.5 + width * (ranks.random(n) - 0.5) for name in TRACES},
    })  # fmt: skip


def test_shares_and_errors_of_trusted_and_of_exact_frames() -> None:
    table = frames(6, np.random.default_rng(3), 1.0).assign(
        mse=[1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7],
        rhat=[1.0, 1.009, 1.01, 1.2, np.inf, 1.0],
        effective=[0.0, 0.29, 0.3, 1.0, 0.3, 0.2],
    )
    (row,) = summary(table).to_dict("records")
    assert (row["agreed"], row["exact"]) == (0.5, 0.5)
    assert row["agreed_psnr"] == pytest.approx(-10 * np.log10((1e-2 + 1e-3 + 1e-7) / 3))
    assert row["exact_psnr"] == pytest.approx(-10 * np.log10((1e-4 + 1e-5 + 1e-6) / 3))


def test_a_calibrated_posterior_has_uniform_ranks_and_others_do_not() -> None:
    (right,) = summary(frames(300, np.random.default_rng(1), 1.0)).to_dict("records")
    (wide,) = summary(frames(300, np.random.default_rng(1), 0.7)).to_dict("records")
    assert right["uniform_p"] > 0.01
    assert wide["uniform_p"] < 1e-4
    assert right["width_p"] > 0.01
    assert wide["width_p"] < 1e-4
    # Draws of 0.8 times the right deviation, which ranks alone hardly tell.
    rng, found = np.random.default_rng(5), []
    for _ in range(10):
        sure = frames(200, rng, 1.0)
        for name in TRACES:
            sure[f"rank_{name}"] = stats.norm.cdf(rng.standard_normal(200) / 0.8)
        found += summary(sure).to_dict("records")
    assert sum(of["width_p"] < 0.05 for of in found) >= 8
    assert sum(of["uniform_p"] < 0.05 for of in found) <= 5
    ranks = frames(300, np.random.default_rng(1), 1.0)
    least = min(stats.kstest(ranks[f"rank_{name}"], "uniform").pvalue for name in TRACES)
    assert right["uniform_p"] == pytest.approx(min(1.0, 4 * least))  # one of four tests
    assert right["within_80"] == pytest.approx(0.8, abs=0.03)
    assert wide["within_80"] == 1


def test_samplers_that_differ_are_said_to() -> None:
    (row,) = summary(frames(100, np.random.default_rng(2), 1.0)).to_dict("records")
    assert row["apart_db"] == pytest.approx(-10 * np.log10(1.1))
    assert row["low"] < row["psnr_of_mse"] < row["high"]
    assert row["agreed"] == row["exact"] == 1
    errors = frames(100, np.random.default_rng(2), 1.0)["mse"]
    assert row["worst"] == pytest.approx(errors.max() / errors.sum())
