"""The mean of a classical method's images and a trained method's."""

import numpy as np
import pytest

from eitbench.methods import Problem, create
from eitbench.methods.learned.ensemble import NetworkEnsemble
from eitbench.methods.learned.image_networks import Dnn
from eitbench.methods.learned.refined import LearnedGaussNewton
from eitbench.methods.learned.tank_unet import TankUNet
from eitbench.methods.problem import no_split
from eitbench.scenarios import sensor
from eitbench.scenarios.physics.forward import forward_model


@pytest.fixture(scope="module")
def problem() -> Problem:
    skin = sensor("ohmc16")
    model = forward_model(skin)
    return Problem(skin, model.voltages(model.background), no_split)


@pytest.mark.parametrize("amplification", [1.0, 4.0])
def test_both_images_have_equal_energy_in_the_mean(problem: Problem, amplification: float) -> None:
    x, y = problem.sensor.pixel_centres
    span = np.ptp(x[problem.mask])
    image = np.where(np.hypot(x - x.mean() - 0.1 * span, y - y.mean()) < 0.1 * span, 0.7, 1.0)
    frame = problem.model.voltages(image * problem.background)[None]
    contrasts = []
    for name in ("learned-gn", "noser", "ensemble"):
        parameters = {} if name == "learned-gn" else {"weight": 0.3}
        amplified = {} if name == "noser" else {"amplification": amplification}
        method = create(name, **parameters, **amplified)
        method.fit(problem)
        contrasts.append((method.reconstruct(frame) - problem.background)[0][problem.mask])
    learned, linear, mean = contrasts
    linear = linear * np.linalg.norm(learned) / np.linalg.norm(linear)
    low, high = (limit * problem.background for limit in problem.sensor.conductivity_range)
    expected = ((learned + linear) / 2 + problem.background).clip(low, high)
    assert mean + problem.background == pytest.approx(expected, abs=1e-6)


def test_an_untouched_skin_stays_as_it_is(problem: Problem) -> None:
    method = create("ensemble")
    method.fit(problem)
    image = method.reconstruct(problem.reference[None])
    assert np.abs(image - problem.background)[0][problem.mask].max() < 0.05


def test_noser_takes_out_the_gains_that_the_network_was_trained_with(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights of `learned-gn` that say that gains were taken out of their training frames."""
    fitted = LearnedGaussNewton.fit

    def fit(method: LearnedGaussNewton, given: Problem) -> None:
        fitted(method, given)
        method.effective_gain_power = method.gain_power or 0.5

    monkeypatch.setattr(LearnedGaussNewton, "fit", fit)
    uneven = Problem(problem.sensor, problem.reference * np.linspace(0.7, 1.3, 192), no_split)
    frames = (uneven.reference * 1.01 + 0.01 * problem.reference)[None]
    images = []
    for parameters in ({}, {"gain_power": 0.5}, {"gain_power": 1.0}):
        method = create("ensemble", **parameters)
        method.fit(uneven)
        images.append(method.reconstruct(frames))
    assert images[0] == pytest.approx(images[1], abs=1e-12)
    assert np.abs(images[0] - images[2]).max() > 1e-4


def test_networks_are_averaged_and_their_distance_is_the_deviation() -> None:
    foam = sensor("foam16")
    model = forward_model(foam)
    problem = Problem(foam, model.voltages(model.background), no_split)
    x, y = foam.pixel_centres
    frame = model.voltages(np.where(np.hypot(x - 0.03, y - 0.05) < 0.01, 0.5, 1.0))[None]
    ensemble = create("network-ensemble")
    ensemble.fit(problem)
    images = []
    for name in ("dnn", "phydnn", "fno", "learned-gn", "learned-proximal"):
        network = create(name)
        network.fit(problem)
        images.append(network.reconstruct(frame))
    np.testing.assert_allclose(ensemble.reconstruct(frame), np.mean(images, axis=0), atol=1e-6)
    deviation = ensemble.uncertainty(frame)
    np.testing.assert_allclose(deviation, np.std(images, axis=0, ddof=1), atol=1e-6)
    assert deviation.max() > 0.02  # they do not agree


def test_one_network_is_no_ensemble(monkeypatch: pytest.MonkeyPatch) -> None:
    foam = sensor("foam16")
    assert NetworkEnsemble.unusable(foam) == ""
    monkeypatch.setattr(NetworkEnsemble, "kinds", (Dnn, TankUNet))
    assert "'tank-unet' has no weights" in NetworkEnsemble.unusable(foam)


def test_the_training_of_a_first_image_counts_once() -> None:
    foam = sensor("foam16")
    model = forward_model(foam)
    problem = Problem(foam, model.voltages(model.background), no_split)
    ensemble, alone = create("network-ensemble"), {}
    ensemble.fit(problem)
    for name in ("dnn", "phydnn", "fno", "learned-gn", "learned-proximal"):
        network = create(name)
        network.fit(problem)
        alone[name] = network.train_s
    assert ensemble.train_s == pytest.approx(sum(alone.values()) - alone["dnn"])
