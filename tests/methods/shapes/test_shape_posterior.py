"""Reconstruction by the posterior of shapes."""

import numpy as np
import pytest

from eitbench.methods import Problem, create
from eitbench.methods.method import DRAWS
from eitbench.methods.problem import no_split
from eitbench.methods.shapes.shape_posterior import ShapePosterior
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios import load, sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.suite import scenario_by_name

PAPER = scenario_by_name("paper")


@pytest.fixture(scope="module")
def fitted() -> tuple[Problem, ShapePosterior]:
    test = load(PAPER, "validation", 1)
    problem = Problem(test.sensor, test.references[0], no_split)
    method = ShapePosterior()
    method.fit(problem)
    return problem, method


@pytest.mark.slow
def test_clean_frames_are_explained_better_than_by_the_network(
    fitted: tuple[Problem, ShapePosterior],
) -> None:
    """Four validation frames without noise, of which most are explained to the last pixel."""
    problem, method = fitted
    data = load(PAPER, "validation", 10)
    rows = np.flatnonzero(np.isnan(data.samples["snr_db"].to_numpy()))[:4]
    problem.reference = data.references[rows[0]]
    network = create("dnn")
    network.fit(problem)
    assert data.conductivity is not None
    truth = data.conductivity[rows]
    errors = []
    for one in (network, method):
        images = one.reconstruct(data.voltages[rows])
        errors.append(((images - truth) ** 2).mean(axis=(1, 2)))
        if one is method:
            model = problem.model
            left = model.voltages(images) - data.voltages[rows]
            shown = data.voltages[rows] - problem.reference
            assert (np.linalg.norm(left, axis=1) < 0.05 * np.linalg.norm(shown, axis=1)).all()
    assert np.median(np.log10(errors[1])) < np.median(np.log10(errors[0])) - 1.5  # by 15 dB


def test_a_frame_that_no_shape_explains_gets_the_image_of_the_network(
    fitted: tuple[Problem, ShapePosterior],
) -> None:
    """Four discs that the network shows as they are, unlike any family of the training."""
    problem, method = fitted
    x, y = problem.sensor.pixel_centres
    guess = np.ones(x.shape)
    for a, b in ((0.03, 0.03), (0.07, 0.03), (0.03, 0.07), (0.07, 0.07)):
        guess[np.hypot(x - a, y - b) < 0.008] = 0.4
    voltages = forward_model(problem.sensor).voltages(guess)
    image, draws = method._of_one(guess, voltages - problem.background_voltages)
    assert image is guess
    assert (draws == guess).all()


def test_draws_are_shapes_about_the_image(fitted: tuple[Problem, ShapePosterior]) -> None:
    """A disc near the rim, of which the noise leaves the size and the depth open."""
    problem, method = fitted
    x, y = problem.sensor.pixel_centres
    truth = np.where(np.hypot(x - 0.03, y - 0.05) < 0.012, 0.5, 1.0)
    clean = forward_model(problem.sensor).voltages(truth)
    frame = add_noise(clean, 40.0, np.random.default_rng(6))[None]
    (image,), (draws,) = method.reconstruct(frame), method.uncertainty(frame)
    assert draws.shape == (DRAWS, *truth.shape)
    spread = draws.std(axis=0)
    assert 0.01 < spread.max() < 0.4
    assert np.abs(draws.mean(axis=0) - image).max() < 3 * spread.max() / np.sqrt(DRAWS) + 1e-3
    assert all(len(np.unique(draw.round(4))) <= 4 for draw in draws)  # sharp edges


def test_an_untouched_sensor_stays_untouched(fitted: tuple[Problem, ShapePosterior]) -> None:
    problem, method = fitted
    problem.reference = problem.background_voltages
    image = method.reconstruct(problem.background_voltages[None])
    assert np.abs(image - problem.background).max() < 0.05


def test_it_says_what_was_told(fitted: tuple[Problem, ShapePosterior]) -> None:
    """The board prints whose training data its families are from."""
    _, method = fitted
    assert method.trained_on["scenario"] == "paper"
    assert method.train_s > 0


def test_bad_parameters_and_presses_are_refused_in_a_sentence() -> None:
    skin = sensor("ohmc16")
    problem = Problem(skin, forward_model(skin).voltages(forward_model(skin).background), no_split)
    with pytest.raises(InputError, match="at least 50 particles and 1 step"):
        ShapePosterior(particles=10).fit(problem)
    with pytest.raises(InputError, match="whole numbers, got particles='many'"):
        ShapePosterior(particles="many").fit(problem)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no parameters of the family 'soft-press'"):
        ShapePosterior().fit(problem)
    assert "no parameters of the family 'soft-press'" in ShapePosterior.unusable(skin)
    assert not ShapePosterior.unusable(sensor("foam16"))


def test_weights_of_an_unknown_training_are_refused(
    fitted: tuple[Problem, ShapePosterior], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, _ = fitted
    module = "eitbench.methods.shapes.shape_posterior.scenarios"
    monkeypatch.setattr(module, dict)
    with pytest.raises(InputError, match="trained on a packaged scenario"):
        ShapePosterior().fit(problem)


def test_damaged_weights_are_told_by_fit_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A suite is checked before its run: a damaged file must not end it."""

    def load(*_: object) -> None:
        raise DataCorruptError("The file is damaged.")

    monkeypatch.setattr(WeightFiles, "load", load)
    assert ShapePosterior.unusable(sensor("foam16")) == ""
