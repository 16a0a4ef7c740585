"""Methods that refine an image: what physics says of it, and what is learned from that."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import integrate, stats
from tests.support.small_sensors import TINY, clean_problem, foam, round_board, suite_of, tiny_mse

from eitbench.methods import Problem, create
from eitbench.methods.learned.ensemble import NetworkEnsemble
from eitbench.methods.learned.gauss_newton_update import SNR_DB, GaussNewtonUpdate, expected_error
from eitbench.methods.learned.image_networks import (
    TRAINED_ON,
    Dnn,
    ImageNetworkMethod,
    TrainedMethod,
)
from eitbench.methods.learned.refined import (
    LearnedGaussNewton,
    RefinementMethod,
    SecondGaussNewton,
)
from eitbench.methods.learned.refiner_training import RefinerTask, SpreadTask, _inputs
from eitbench.methods.networks.image_network import ImageNetwork
from eitbench.methods.networks.refiner import LEAST, SOFT, Refiner, SpreadNetwork
from eitbench.methods.problem import no_split
from eitbench.methods.training import TrainingInterruptedError, TrainingRequest, train
from eitbench.methods.training.loop import Data
from eitbench.methods.weights import weight_files
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios import load, sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.symmetry import motions
from eitbench.scenarios.suites.suite import load_suite

Array = NDArray[np.float64]


def touched(s: Sensor, depth: float = 0.4) -> Array:
    """Conductivity over background with a touched spot."""
    image = np.ones(s.image_shape)
    image[3:7, 4:8] -= depth
    return image


def difference(problem: Problem, relative: Array) -> Array:
    sigma = relative * problem.background
    return np.asarray(problem.model.voltages(sigma) - problem.background_voltages)


@pytest.mark.parametrize("make", [lambda: foam((12, 14)), round_board])
def test_an_update_is_the_textbook_step(make: Callable[[], Sensor]) -> None:
    """Over all measurements, in the pixels: (J^T J / s^2 + D^-1)^-1 J^T (dv - (F(x) - F(1)))."""
    s = make()
    problem = clean_problem(s)
    guess = touched(s, 0.2).astype(np.float32)
    frame = difference(problem, touched(s))
    update = GaussNewtonUpdate(problem)(frame[None], guess[None])[0]

    sigma = guess * problem.background
    rows = problem.model.jacobian(sigma)[:, s.mask] * problem.background
    missing = frame - difference(problem, guess.astype(np.float64))
    inverse_prior = np.diag(expected_error(guess)[s.mask].astype(float) ** -2)
    rms = np.sqrt(np.mean(problem.background_voltages**2))
    for level, snr in enumerate(SNR_DB):
        noise = (rms * 10 ** (-snr / 20)) ** 2
        normal = rows.T @ rows / noise + inverse_prior
        expected = np.zeros(s.image_shape)
        expected[s.mask] = np.linalg.solve(normal, rows.T @ missing / noise)
        scale = np.abs(expected).max()
        assert scale > 1e-3
        np.testing.assert_allclose(update[level], expected, atol=2e-3 * scale)


@pytest.mark.parametrize("make", [lambda: foam((12, 14)), round_board])
def test_an_update_explains_more_of_the_frame(make: Callable[[], Sensor]) -> None:
    s = make()
    problem = clean_problem(s)
    guess, truth = touched(s, 0.3), touched(s)
    frame = difference(problem, truth)
    update = GaussNewtonUpdate(problem)
    small = guess.astype(np.float32)
    changed = small + update(frame[None], small[None])[0, 0]

    def misfit(image: Array) -> float:
        return float(np.linalg.norm(difference(problem, image) - frame))

    assert misfit(changed.astype(float)) < 0.2 * misfit(guess)
    assert np.linalg.norm(changed - truth) < np.linalg.norm(guess - truth)
    # And nothing is to be changed where all is explained.
    right = truth.astype(np.float32)
    assert np.abs(update(frame[None], right[None])).max() < 1e-3


@pytest.mark.slow
def test_a_refiner_begins_as_the_identity_and_sees_all_its_images() -> None:
    mask = torch.ones(13, 11, dtype=torch.bool)
    mask[:2] = False
    network = Refiner(mask, 4)
    images = torch.randn(5, 4, 13, 11)
    torch.testing.assert_close(network(images), images[:, 0])
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    images.requires_grad_()
    changed = network(images)
    assert torch.equal(changed[:, ~mask], images[:, 0][:, ~mask])
    changed.square().sum().backward()
    assert images.grad is not None
    assert (images.grad.abs().amax((0, 2, 3)) > 0).all()
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in network.parameters())


def with_random_weights(name: str, s: Sensor, folder: Path) -> TrainedMethod:
    """A method whose networks know nothing of symmetry, ready for the sensor `s`."""
    method = create(name, weights=str(folder / f"{name}.safetensors"))
    assert isinstance(method, TrainedMethod)
    torch.manual_seed(3)
    about = dict.fromkeys(TRAINED_ON, "1") | {"train_s": "5", "backbone": "unet", "begun_from": ""}
    if isinstance(method, RefinementMethod):
        method.start(clean_problem(s))
        network = torch.nn.Sequential(method.network(clean_problem(s)))
        about["begun_from"] = method.begun_from
    else:
        network = ImageNetwork(s, "unet")  # type: ignore[assignment]
    for parameter in network.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    method.files.save(Path(method.weights), s, network.state_dict(), about)
    method.fit(clean_problem(s))
    return method


@pytest.mark.parametrize(
    ("make", "count"), [(foam, 8), (lambda: foam((12, 16)), 4), (round_board, 1)]
)
def test_images_move_with_the_sensor(
    make: Callable[[], Sensor], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exactly, whatever the weights; a sensor without symmetry has a mean of one."""
    monkeypatch.setattr(weight_files, "user_weights", lambda: tmp_path)
    s = make()
    problem = clean_problem(s)
    moves = motions(s, problem.jacobian)
    assert len(moves) == count
    frames = difference(problem, touched(s))[None]
    for name in ("dnn", "coarse-to-fine", "learned-gn"):
        method = with_random_weights(name, s, tmp_path)
        if name == "dnn":
            Path(method.weights).rename(tmp_path / method.files.file_name(s))
        image = method.relative(frames)
        assert method.relative(frames[:0]).shape == (0, *s.image_shape)
        alone = []
        for move in moves:
            change = method.relative(move.voltages(frames)) - move.images(image)
            assert np.abs(change).max() < 1e-3 * np.ptp(image)
            np.testing.assert_array_equal(move.images_back(move.images(image)), image)
        # One network does not do it by itself.
        monkeypatch.setattr(method, "_motions", moves[:1])
        alone = [
            method.relative(move.voltages(frames)) - move.images(method.relative(frames))
            for move in moves[1:]
        ]
        assert all(np.abs(change).max() > 0.02 * np.ptp(image) for change in alone)
    assert method.train_s == 10  # that of `dnn`, which it continues, too


def test_a_second_step_starts_from_the_image_of_the_first() -> None:
    """With the packaged weights, on eight clean validation frames."""
    data = load("paper", split="validation", limit=20)
    rows = np.flatnonzero(np.isnan(data.samples["snr_db"].to_numpy()))[:8]
    problem = Problem(data.sensor, data.references[0], no_split)
    first, second = LearnedGaussNewton(), SecondGaussNewton()
    for method in (first, second):
        method.fit(problem)
    frames = problem.difference(data.voltages[rows])
    image = first.relative(frames)
    low, high = data.sensor.conductivity_range
    np.testing.assert_allclose(second.inputs(frames)[:, 0], image.clip(low, high), atol=1e-5)
    assert data.conductivity is not None
    truth = data.conductivity[rows] / problem.background
    errors = [((one - truth) ** 2).mean(axis=(1, 2)) for one in (image, second.relative(frames))]
    assert np.log(errors[1]).mean() < np.log(errors[0]).mean() - 0.05  # by 0.2 dB
    # Both trainings that it stands on count as its own.
    assert second.train_s > first.train_s + 100


def test_what_the_first_image_was_learned_from_was_learned_from_too() -> None:
    data = load("paper", split="validation", limit=1)
    method = create("learned-gn-large")
    method.fit(Problem(data.sensor, data.references[0], no_split))
    assert method.trained_on["train_samples"] == "240000"
    assert method.trained_on["unlimited"] == "1"


def test_a_second_step_needs_the_weights_of_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    foam16 = sensor("foam16")
    assert not SecondGaussNewton.unusable(foam16)
    monkeypatch.setattr(LearnedGaussNewton, "files", WeightFiles("nobody"))
    assert "has no weights" in SecondGaussNewton.unusable(foam16)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    for base in (ImageNetworkMethod, RefinementMethod):
        monkeypatch.setattr(base, "recipe", replace(base.recipe, batch=32))
    return tmp_path


@pytest.mark.nightly
def test_a_step_through_the_model_improves_the_image_of_a_network(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny = suite_of(cache, TINY)
    train(TrainingRequest("dnn", tiny, epochs=6, operator="jacobian"))
    request = TrainingRequest("learned-gn", tiny, epochs=5, out=cache / "out")
    calls = []
    loss = RefinerTask.loss

    def stopping(self: RefinerTask, batch: Data) -> torch.Tensor:
        calls.append(1)
        if len(calls) == 25:  # in the third epoch
            raise KeyboardInterrupt
        return loss(self, batch)

    with monkeypatch.context() as patch:
        patch.setattr(RefinerTask, "loss", stopping)
        with pytest.raises(TrainingInterruptedError):
            train(request)
    assert (cache / "out/curve.csv").is_file()
    result = train(request)
    again = train(replace(request, out=cache / "again", install="never"))
    assert again.weights.with_suffix(".json") != result.weights.with_suffix(".json")
    assert again.validation_loss == result.validation_loss
    begun, found = tiny_mse(create("dnn")), tiny_mse(create("learned-gn"))
    assert found < 0.65 * begun
    assert found == tiny_mse(create("learned-gn", weights=str(again.weights)))
    assert result.baseline_loss == pytest.approx(begun, rel=0.3)
    assert result.validation_loss == pytest.approx(found, rel=0.3)

    train(TrainingRequest("dnn", tiny, epochs=1, operator="jacobian", out=cache / "other"))
    with pytest.raises(InputError, match="were trained for another first image than there is now"):
        tiny_mse(create("learned-gn"))
    sensor = load_suite(tiny).scenarios[0].nominal_sensor
    assert "trained for another first image" in LearnedGaussNewton.unusable(sensor)
    # An ensemble goes on without it.
    assert "learned-gn" not in [of.files.name for of in NetworkEnsemble.usable(sensor)]
    with pytest.raises(InputError, match="begun with begun_from"):
        train(request)


@pytest.mark.nightly
def test_a_network_improves_a_coarse_image(cache: Path) -> None:
    result = train(TrainingRequest("coarse-to-fine", suite_of(cache, TINY), epochs=16))
    assert result.in_use
    coarse = tiny_mse(create("noser", variable="clausius-mossotti", weight=0.01))
    assert tiny_mse(create("coarse-to-fine")) < 0.7 * coarse
    assert result.baseline_loss == pytest.approx(coarse, rel=0.3)


def test_first_images_are_those_of_the_weights_that_are_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A training after the first network was trained again learns from its new images."""
    monkeypatch.setattr(weight_files, "user_weights", lambda: tmp_path)
    s = TINY.nominal_sensor
    frames = difference(clean_problem(s), touched(s))[None]
    seen = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        network = ImageNetwork(s, "unet")
        for parameter in network.parameters():
            parameter.data += 0.05 * torch.randn_like(parameter)
        about = dict.fromkeys(TRAINED_ON, "1") | {"train_s": "5", "backbone": "unet"}
        Dnn.files.save(tmp_path / Dnn.files.file_name(s), s, network.state_dict(), about)
        method = LearnedGaussNewton()
        method.start(clean_problem(s))
        seen.append(_inputs(LearnedGaussNewton, TINY, "cpu", method.begun_from, frames))
        np.testing.assert_array_equal(seen[-1], method.inputs(frames))
    assert np.abs(seen[0] - seen[1]).max() > 1e-3


def test_a_method_that_continues_another_learns_from_the_same_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first image would be of differences that its network never saw."""
    monkeypatch.setattr(weight_files, "user_weights", lambda: tmp_path)
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    s = TINY.nominal_sensor
    network = ImageNetwork(s, "unet")
    about = dict.fromkeys(TRAINED_ON, "1") | {"train_s": "5", "backbone": "unet"}

    def install(gain_power: str) -> None:
        to = tmp_path / Dnn.files.file_name(s)
        Dnn.files.save(to, s, network.state_dict(), about | {"gain_power": gain_power})

    install("1.0")
    with pytest.raises(InputError, match="were trained with --gain-power 1, and its own with 0: t"):
        train(TrainingRequest("dnn-heteroscedastic", suite_of(tmp_path, TINY), epochs=1))
    # Weights from before this was checked.
    with pytest.raises(InputError, match="were trained with --gain-power 1, and its own with 0: t"):
        with_random_weights("dnn-heteroscedastic", s, tmp_path)
    install("0.0")
    with_random_weights("dnn-heteroscedastic", s, tmp_path)


def test_deviations_are_trained_by_the_crps_of_normal_distributions() -> None:
    """Beside its definition, the integral of (F(x) - 1[x >= t])^2."""
    truth, mean, deviation = 0.7, 0.9, 0.15
    exact, _ = integrate.quad(
        lambda x: (stats.norm.cdf(x, mean, deviation) - (x >= truth)) ** 2, -1, 3, points=[truth]
    )

    class Constant(torch.nn.Module):
        def forward(self, images: torch.Tensor) -> torch.Tensor:
            return torch.full_like(images[:, 0], deviation)

    task = SpreadTask(Constant(), ()).eval()
    batch = torch.full((2, 1, 4, 4), mean), torch.full((2, 4, 4), truth)
    assert float(task.loss(batch)) == pytest.approx(exact, rel=1e-5)


def test_a_new_network_of_deviations_gives_one_and_never_none() -> None:
    network = SpreadNetwork((16, 16))
    images = torch.rand(2, 1, 16, 16)
    assert torch.allclose(network(images), torch.tensor(LEAST + SOFT * np.log(2)).float())
    torch.nn.init.constant_(network.unet.get_parameter("leave.bias"), -1e4)
    assert torch.allclose(network(images), torch.tensor(LEAST))
