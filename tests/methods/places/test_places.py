"""Places straight from voltages: kernel ridge, networks, and the linear map of touches."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from eitbench.benchmark.checks.place_under_test import simulated, skin
from eitbench.methods import PlaceProblem, Problem, create
from eitbench.methods.method import reconstructed
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.places.kernel_ridge import WEIGHTS, gaussians, kernel_ridge, linear
from eitbench.methods.places.place_network import SIMULATED, PlaceNetwork
from eitbench.scenarios import InputError, RecordedScenario, load
from eitbench.scenarios.arrays import unit_frames
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.suites.suite import has_training, learned_from, scenario_by_name

Array = NDArray[np.float64]

RNG = np.random.default_rng(0)


def test_the_leave_one_out_error_is_that_of_leaving_out_one() -> None:
    x, y = RNG.standard_normal((12, 3)), RNG.standard_normal((12, 2))
    kernel = gaussians(x)[2]
    found = kernel_ridge(x, y, [kernel])
    # The same ridge, chosen by brute force, with the mean of all outputs as the closed form has it.
    errors = []
    gram, mean = kernel(x, x), y.mean(axis=0)
    for weight in WEIGHTS:
        left = []
        for k in range(len(x)):
            rest = np.delete(np.arange(len(x)), k)
            ridge = weight * np.trace(gram) / len(x) * np.eye(len(rest))
            fitted = np.linalg.solve(gram[np.ix_(rest, rest)] + ridge, y[rest] - mean)
            left.append(mean + gram[k, rest] @ fitted - y[k])
        errors.append(np.sqrt(np.mean(np.square(left))))
    assert found.error == pytest.approx(min(errors), rel=1e-6)


def test_one_block_of_all_leaves_out_single_samples() -> None:
    """Nothing would be left: all kernels and ridges would be equally good, but for rounding."""
    x, y = RNG.standard_normal((12, 3)), RNG.standard_normal((12, 2))
    whole = kernel_ridge(x, y, gaussians(x), [slice(0, 12)])
    assert whole.error == kernel_ridge(x, y, gaussians(x)).error


def test_whole_blocks_are_left_out() -> None:
    x, y = RNG.standard_normal((12, 3)), RNG.standard_normal((12, 2))
    kernel, blocks = gaussians(x)[1], [slice(0, 5), slice(5, 8), slice(8, 12)]
    found = kernel_ridge(x, y, [kernel], blocks)
    errors = []
    gram, mean = kernel(x, x), y.mean(axis=0)
    for weight in WEIGHTS:
        ridge, left = weight * np.trace(gram) / len(x), []
        for block in blocks:
            out = np.arange(len(x))[block]
            rest = np.setdiff1d(np.arange(len(x)), out)
            inverse = np.linalg.inv(gram[np.ix_(rest, rest)] + ridge * np.eye(len(rest)))
            left.append(mean + gram[np.ix_(out, rest)] @ inverse @ (y[rest] - mean) - y[out])
        errors.append(np.sqrt(np.mean(np.square(np.concatenate(left)))))
    assert found.error == pytest.approx(min(errors), rel=1e-6)


def test_a_linear_function_is_learned_by_the_linear_kernel_and_a_bend_by_the_gaussian() -> None:
    x, seen = RNG.uniform(-1, 1, (60, 2)), RNG.uniform(-1, 1, (200, 2))

    def straight(a: Array) -> Array:
        return np.asarray(a @ np.array([[1.0, 2.0], [0.5, -1.0]]) + 3)

    def bent(a: Array) -> Array:
        return np.stack([np.sin(3 * a[:, 0]), a[:, 0] * a[:, 1]], axis=1)

    assert np.allclose(kernel_ridge(x, straight(x), [linear])(seen), straight(seen), atol=1e-4)
    found = kernel_ridge(x, bent(x), gaussians(x))
    assert np.sqrt(np.mean((found(seen) - bent(seen)) ** 2)) < 0.05
    with pytest.raises(InputError, match="at least 3 samples"):
        kernel_ridge(x[:2], straight(x[:2]), [linear])


def disc_frames(n: int) -> tuple[Array, Array]:
    """Frames of 40 values that fall off with the distance from 40 points, and their places."""
    places = RNG.uniform(-0.05, 0.05, (n, 2))
    points = RNG.uniform(-0.08, 0.08, (40, 2))
    distance = np.linalg.norm(places[:, None] - points, axis=2)
    return RNG.uniform(0.1, 2, (n, 1)) * np.exp(-((distance / 0.04) ** 2)), places


@pytest.mark.slow
def test_a_network_learns_places_and_further_training_leaves_it_as_it_was() -> None:
    frames, places = disc_frames(600)
    phase = replace(SIMULATED, steps=400, gain=0.1, noise=0.05)
    fresh = PlaceNetwork(40, (0, 0), 0.05, seed=1)
    before = fresh(frames[:5])
    trained = fresh.trained(frames[:500], places[:500], phase)
    error = np.hypot(*(trained(frames[500:]) - places[500:]).T)
    assert np.median(error) < 0.005  # presses lie 38 mm from the middle in the median
    assert np.array_equal(fresh(frames[:5]), before)
    again = fresh.trained(frames[:500], places[:500], phase)
    assert np.array_equal(again(frames), trained(frames))
    with pytest.raises(InputError, match="for each frame"):
        fresh.trained(frames, places[:3], phase)


@pytest.mark.slow
def test_the_same_training_is_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    frames, places = disc_frames(60)
    phase = replace(SIMULATED, steps=5)
    fresh = PlaceNetwork(40, (0, 0), 0.05, seed=1)
    expected = fresh.trained(frames, places, phase)(frames)
    made: list[int] = []
    train = PlaceNetwork.trained

    def counted(self: PlaceNetwork, *what: Any) -> PlaceNetwork:
        made.append(1)
        return train(self, *what)

    monkeypatch.setattr(PlaceNetwork, "trained", counted)
    first, again = (fresh.trained_once(frames, places, phase) for _ in range(2))
    assert len(made) == 1
    assert again.train_s == first.train_s > 0
    for network in (first, again):
        assert np.array_equal(network(frames), expected)
    # Anything else that it learns from, or starts from, is another training.
    fresh.trained_once(frames, places[::-1], phase)
    fresh.trained_once(frames, places, replace(phase, noise=0.1))
    PlaceNetwork(40, (0, 0), 0.05, seed=2).trained_once(frames, places, phase)
    first.trained_once(frames, places, phase)
    assert len(made) == 5
    for path in tmp_path.rglob("*.safetensors"):
        path.write_bytes(b"damaged")
    assert np.array_equal(fresh.trained_once(frames, places, phase)(frames), expected)
    assert "made again" in caplog.text


@pytest.mark.slow
@given(st.floats(1e-6, 1e6))
def test_places_do_not_depend_on_the_strength_of_a_frame(factor: float) -> None:
    frames, _ = disc_frames(3)
    network = PlaceNetwork(40, (0.01, 0.02), 0.05, seed=0)
    np.testing.assert_allclose(network(factor * frames), network(frames), atol=1e-6)
    assert np.array_equal(unit_frames(np.zeros((2, 4))), np.zeros((2, 4)))


def few_presses(split: str, limit: int | None) -> Dataset:
    """300 simulated presses of the disc sensor, from the mesh that is inverted with."""
    presses = scenario_by_name("presses").model_copy(update={"imperfections": Imperfections()})
    return load(presses, split, min(limit or 300, 300))


@pytest.mark.slow
def test_a_linear_map_learned_from_presses_finds_others_whatever_the_gain() -> None:
    test = few_presses("test", 40)

    def seen(share: float) -> Dataset:
        """As a board of another gain sees `share` of what each press changes."""
        voltages = test.references + share * (test.voltages - test.references)
        return replace(test, voltages=1e3 * voltages, references=1e3 * test.references)

    method = create("linear-touch")
    problem = Problem(test.sensor, seen(1.0).references[0], few_presses)
    method.fit(problem)
    assert test.conductivity is not None
    background = test.sensor.background
    true = locate(test.conductivity - background, test.sensor)
    images = reconstructed(method, problem, seen(1.0))
    found = locate(images - background, test.sensor)
    assert np.median(np.hypot(*(found - true).T)) < 0.008  # on a disc 171 mm across
    assert images.max() <= background  # a press lowers conductivity
    # Twice the difference is twice the contrast, up to the sensor's range.
    weak, weaker = (reconstructed(method, problem, seen(share)) for share in (0.01, 0.005))
    np.testing.assert_allclose(2 * (weaker - background), weak - background, atol=1e-12)


def test_recorded_presses_are_learned_from_simulated_ones_of_their_sensor() -> None:
    source = learned_from(RecordedScenario(name="ohmc8", recording="ohmc8"))
    assert source.nominal_sensor.name == "ohmc8"
    assert source.kind == "simulated"
    paper = scenario_by_name("paper")
    assert learned_from(paper) is paper
    tank = scenario_by_name("sciospec-tank")
    assert learned_from(tank) is tank
    known = {"presses": True, "paper": True, "sciospec-tank": False, "ktc2023": False}
    assert {name: has_training(scenario_by_name(name)) for name in known} == known


def located(name: str, labelled: int) -> float:
    """Median error [mm] of a method of places on the skin of the checks, not registered."""
    given, presses = skin()
    problem = PlaceProblem(replace(given, labelled=given.labelled[:labelled]), simulated)
    method = create_place_method(name)
    method.fit(problem)
    places = method.locate(presses.differences)
    return float(1e3 * np.median(np.hypot(*(places - presses.places).T)))


def test_a_skin_is_learned_from_another() -> None:
    guess = located("one-place", 60)
    # The same sensor and another gain: what is learned of it holds here.
    assert located("kernel-ridge-skins", 0) < 0.2 * guess
    assert located("kernel-ridge-skins", 60) < 0.2 * guess
    assert located("kernel-ridge", 0) > 0.5 * guess
    assert located("ridge", 60) < 0.5 * guess


def test_an_imaging_method_says_the_place_of_its_contact() -> None:
    assert located("noser", 0) < 10  # of a square of 100 mm, in the sensor's own coordinates
    assert located("noser", 10) < 10


@pytest.mark.nightly
def test_networks_learn_from_simulation_and_skins_first(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SIMULATED", "SKINS"):
        phase = replace(SIMULATED, steps=400, gain=0.1, noise=0.1)
        monkeypatch.setattr(f"eitbench.methods.places.place_network.{name}", phase)
    guess, alone = located("one-place", 10), located("network", 10)
    for name in ("network-simulated", "network-skins", "network-simulated-skins"):
        assert located(name, 0) < 0.5 * guess
        assert located(name, 10) < alone
    assert located("network", 0) > 0.5 * guess  # it has learned nothing
