"""The learned methods: they learn, train reproducibly, and load what belongs to the sensor."""

import csv
import hashlib
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from tests.support.small_sensors import TINY, foam, suite_of, tiny_mse, tiny_problem

from eitbench.cli import main
from eitbench.methods import Problem, create, methods
from eitbench.methods.learned import image_network_training
from eitbench.methods.learned.image_network_training import ImageTask
from eitbench.methods.learned.image_networks import Dnn, DnnLarge, DnnRandomised, ImageNetworkMethod
from eitbench.methods.learned.latent_flow import LatentFlowMethod
from eitbench.methods.method import reconstructed
from eitbench.methods.networks.image_network import ImageNetwork
from eitbench.methods.problem import no_split
from eitbench.methods.training import (
    DivergedError,
    Recipe,
    TrainingInterruptedError,
    TrainingRequest,
    augmentation,
    samples,
    train,
)
from eitbench.methods.training.checkpoint import CHECKPOINT_FILE as FILE
from eitbench.methods.training.job import TrainingJob, TrainingResult, training_device
from eitbench.methods.training.loop import Data
from eitbench.methods.training.losses import image_loss
from eitbench.methods.weights import weight_files
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.simulation import clean_frames
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.imperfections.training_units import TrainingImperfections
from eitbench.scenarios.storage.array_file import read_arrays
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario, SplitNoise

NOISY = SimulatedScenario(
    name="noisy",
    image_shape=(12, 12),
    families=("circle",),
    noise=SplitNoise(train="mixture", validation="mixture"),
    train=130,
    validation=8,
    test=1,
)
SENSOR = TINY.nominal_sensor
QUICK: dict[str, Any] = {"operator": "jacobian"}


def recipe(**other: Any) -> Recipe:
    return replace(ImageNetworkMethod.recipe, **other)


def state(folder: Path) -> dict[str, Any]:
    found = read_arrays(folder / FILE)
    assert found is not None
    return found[0]


def rows(folder: Path) -> list[dict[str, float]]:
    with (folder / "curve.csv").open() as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    folder = tmp_path_factory.mktemp("trained")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32))
        tiny = suite_of(folder, TINY)
        request = TrainingRequest(
            "dnn", tiny, epochs=30, out=folder / "out", install="never", **QUICK
        )
        return train(request)


@pytest.fixture(autouse=True)
def _own_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weight_files, "user_weights", lambda: tmp_path / "weights")
    monkeypatch.setattr(weight_files, "packaged_weights", lambda: tmp_path / "packaged")
    monkeypatch.setattr("eitbench.methods.training.job.user_weights", weight_files.user_weights)


def install(result: TrainingResult) -> Path:
    path = weight_files.user_weights() / result.weights.name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(result.weights.read_bytes())
    return path


@pytest.mark.slow
def test_a_network_learns_what_no_linear_map_can(trained: TrainingResult) -> None:
    linear, network = tiny_mse(create("linear-learned")), tiny_mse(Dnn(str(trained.weights)))
    assert network < 0.8 * linear
    assert trained.baseline_loss == pytest.approx(linear, rel=0.3)
    assert trained.validation_loss == pytest.approx(network, rel=0.3)
    assert linear < tiny_mse(create("noser"))
    about = json.loads(trained.weights.with_suffix(".json").read_text())
    assert about["command"].endswith(" --epochs 30 --seed 0 --operator jacobian")
    table = rows(trained.weights.parent)
    assert table == about["curve"]
    assert len(table) == 30
    assert min(row["validation"] for row in table) == float(about["validation_loss"])
    # Images that resemble the truth explain the voltages better, though none asked them to.
    assert table[-1]["validation_physical"] < 0.95 * table[0]["validation_physical"]
    assert {"train", "train_physical", "rate", "seconds"} < set(table[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fno", "learned-proximal"])
def test_networks_of_other_kinds_learn_it_too(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their weights are those of their own network, and a training continues them."""
    method = methods()[name]
    assert issubclass(method, ImageNetworkMethod)
    monkeypatch.setattr(method, "recipe", recipe(batch=32))
    request = TrainingRequest(name, suite_of(tmp_path, TINY), epochs=20, out=tmp_path / "out")
    result = train(request)
    assert result.in_use
    linear, network = tiny_mse(create("linear-learned")), tiny_mse(create(name))
    assert network < 0.9 * linear
    assert result.validation_loss == pytest.approx(network, rel=0.3)
    again = train(replace(request, epochs=1, start="weights", out=tmp_path / "again"))
    assert again.baseline_loss == pytest.approx(result.validation_loss, rel=1e-3)


@pytest.mark.slow
def test_the_reference_frame_gives_the_background(trained: TrainingResult) -> None:
    install(trained)
    p = tiny_problem()
    for name, allowed in (("linear-learned", 1e-12), ("dnn", 0.05)):
        method = create(name)
        method.fit(p)
        assert np.abs(method.reconstruct(p.reference[None]) - 1).max() <= allowed


def test_who_lacks_weights_that_are_too_large_for_a_package_is_told_where_they_are() -> None:
    foam, packaged = sensor("foam16"), weight_files.packaged_weights()
    assert "has no weights for the sensor" in DnnLarge.files.missing(foam)
    packaged.mkdir()
    for network in (Dnn, DnnLarge):
        (packaged / network.files.file_name(foam)).with_suffix(".json").write_text("{}")
    where = "copy methods/weights/*-large-*.safetensors from the repository"
    assert where in DnnLarge.files.missing(foam)
    assert where not in Dnn.files.missing(foam)


@pytest.mark.slow
def test_the_users_own_weights_are_used_unless_a_file_is_named(trained: TrainingResult) -> None:
    path = install(trained)
    content = read_arrays(path)
    assert content is not None
    other = {name: torch.from_numpy(0.9 * array) for name, array in content[0].items()}
    Dnn.files.save(path, SENSOR, other, content[1])
    frames = load(TINY, limit=2).voltages
    images = []
    for method in (Dnn(), Dnn(str(trained.weights))):
        method.fit(tiny_problem())
        images.append(method.reconstruct(frames))
    assert np.abs(images[0] - images[1]).max() > 0.01
    assert images[0].shape == (2, 16, 16)
    assert images[0].dtype == np.float64
    assert 0.05 <= np.min(images) < np.max(images) <= 1.0
    with pytest.raises(InputError, match=r"no file of weights .*nowhere.*eitbench train dnn"):
        Dnn("nowhere").fit(tiny_problem())


@pytest.mark.slow
def test_weights_that_do_not_belong_are_refused(
    trained: TrainingResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"'dnn' has no weights .*`eitbench train dnn --suite"):
        create("dnn").fit(tiny_problem())
    other = replace(SENSOR, background=1.5)
    path = install(trained)
    path.rename(path.with_name(Dnn.files.file_name(other)))
    with pytest.raises(InputError, match="weights for another sensor"):
        create("dnn").fit(tiny_problem(other))
    path = install(trained)
    whole = path.read_bytes()
    for tensors, about in (({"x": torch.zeros(2)}, {"backbone": "unet"}), ({}, {})):
        Dnn.files.save(path, SENSOR, tensors, about)
        with pytest.raises(DataCorruptError, match="does not hold the weights of 'dnn'"):
            create("dnn").fit(tiny_problem())
    path.write_bytes(whole)
    monkeypatch.setattr(Dnn, "files", replace(Dnn.files, version="9"))
    with pytest.raises(InputError, match="version 1 of 'dnn', and this is version 9"):
        create("dnn").fit(tiny_problem())


@pytest.mark.slow
def test_an_interrupted_training_continues_as_if_it_had_not_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of `phydnn`, whose loss changes on the way, with noise and symmetries that are drawn."""
    noisy = suite_of(tmp_path, NOISY)
    step, calls = ImageTask.objective, []

    def stopping(self: ImageTask, batch: Data, epochs_done: int) -> Any:
        calls.append(epochs_done)
        if len(calls) == 8:  # in the third of five epochs, and after the loss changed
            raise KeyboardInterrupt
        return step(self, batch, epochs_done)

    def run(name: str, seed: int = 4) -> TrainingResult:
        out = tmp_path / name
        request = TrainingRequest("phydnn", noisy, epochs=5, seed=seed, out=out, **QUICK)
        return train(replace(request, install="always"))

    monkeypatch.setattr(ImageTask, "objective", stopping)
    with pytest.raises(TrainingInterruptedError):
        run("stopped")
    assert len(rows(tmp_path / "stopped")) == 2
    result = run("stopped")
    run("whole")
    run("other", seed=5)
    one, two, other = (state(tmp_path / name) for name in ("stopped", "whole", "other"))
    assert all(np.array_equal(one[name], two[name]) for name in two)
    assert any(not np.array_equal(one[name], other[name]) for name in two)
    timeless = [
        [{k: v for k, v in row.items() if k != "seconds"} for row in rows(tmp_path / name)]
        for name in ("stopped", "whole")
    ]
    assert timeless[0] == timeless[1]
    assert result.in_use
    assert result.weights.parent == weight_files.user_weights()
    assert "'phydnn' uses them from now on" in " ".join(result.sentences())
    method = create("phydnn")
    data = load(NOISY, "test")
    method.fit(Problem(data.sensor, data.references[0], no_split))
    assert method.reconstruct(data.voltages).shape == (1, 12, 12)


@pytest.mark.nightly
def test_the_physical_loss_is_minimised_after_a_third_of_the_epochs_and_not_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = {"train": 512, "validation": 100, "noise": {"train": "clean", "validation": "clean"}}
    clean = suite_of(tmp_path, SimulatedScenario(**NOISY.model_dump() | more))
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(rate=1e-4))

    def run(name: str, beta: float | None = None) -> list[dict[str, float]]:
        method = "dnn" if name == "dnn" else "phydnn"
        out = tmp_path / name
        train(TrainingRequest(method, clean, epochs=12, out=out, operator="fem", beta=beta))
        return rows(tmp_path / name)

    dnn, weak, strong = run("dnn"), run("weak"), run("strong", beta=0.3)
    losses = ("train", "validation", "train_physical", "validation_physical")
    for row in range(12):
        same = [[table[row][key] for key in losses] for table in (dnn, weak, strong)]
        before = row < 4  # 30 % of 12 epochs
        assert (same[0] == same[1] == same[2]) is before
        assert (same[0] != same[1]) is not before
    assert strong[-1]["train_physical"] < 0.8 * dnn[-1]["train_physical"]


@pytest.mark.slow
def test_the_gradient_is_that_of_both_losses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step's loss is data + beta * physical, of the images and frames of that very step.

    The physical loss is that of a quarter of them.
    """
    seen: list[tuple[float, float, float]] = []
    step = ImageTask.objective

    def watched(self: ImageTask, batch: Data, epochs_done: int) -> Any:
        random = torch.get_rng_state()
        objective, shown = step(self, batch, epochs_done)
        torch.set_rng_state(random)
        difference, truth, motion = self.augmentation(*batch)
        relative = self.images(difference)
        data = (relative - truth).square().mean()
        assert self.physical is not None
        part = slice(math.ceil(len(truth) / 4))
        physical = self.physical(relative[part], difference[part], motion)
        seen.append((objective.item(), data.item(), physical.item()))
        return objective, shown

    monkeypatch.setattr(ImageTask, "objective", watched)
    noisy = suite_of(tmp_path, NOISY)
    train(TrainingRequest("phydnn", noisy, epochs=3, out=tmp_path / "o", beta=0.5, **QUICK))
    assert len(seen) == 9
    for number, (objective, data, physical) in enumerate(seen):
        expected = data if number < 3 else data + 0.5 * physical
        assert objective == pytest.approx(expected, rel=1e-5)
        assert physical > 0


@pytest.mark.slow
def test_without_a_data_loss_no_true_image_has_a_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights are the same to the last bit where images are wrong, and explain the voltages."""
    clean = {"noise": {"train": "clean", "validation": "clean"}}
    suite = suite_of(tmp_path, SimulatedScenario(**NOISY.model_dump() | clean))
    request = TrainingRequest("phydnn", suite, epochs=4, operator="fem", alpha=0.0, install="never")
    first = train(replace(request, out=tmp_path / "true"))
    assert first.validation_loss < 0.5 * first.baseline_loss
    assert "physical loss" in first.sentences()[0]
    about = json.loads(first.weights.with_suffix(".json").read_text())
    assert (about["alpha"], about["beta"]) == ("0.0", "0.0029")
    assert "--alpha 0" in about["command"]

    right = samples.images

    def wrong(scenario: SimulatedScenario, split: Any, count: int) -> torch.Tensor:
        return torch.full_like(right(scenario, split, count), 0.5)

    monkeypatch.setattr(image_network_training, "images", wrong)
    second = train(replace(request, out=tmp_path / "wrong"))
    weights = [load_file(result.weights) for result in (first, second)]
    assert weights[0].keys() == weights[1].keys()
    for name, tensor in weights[0].items():
        assert torch.equal(tensor, weights[1][name])


def test_images_that_are_not_finite_have_no_finite_loss_without_a_data_loss() -> None:
    """So that a training of the physical loss alone ends as one of both does."""
    s = foam((12, 12))
    network = ImageNetwork(s, "unet")
    for weights in network.parameters():
        weights.data.fill_(torch.nan)
    voltages = torch.zeros(2, s.n_measurements)

    class Unmoved:
        def __call__(self, *batch: torch.Tensor) -> tuple[Any, ...]:
            return batch[0], batch[-1], None

    def physical(*_: object) -> Any:
        raise AssertionError("images that are not finite have no voltages")

    task = ImageTask(network, Unmoved(), "mse", physical, 0.0, 1.0, 5)  # type: ignore[arg-type]
    loss, _ = task.objective((voltages, voltages, torch.ones(2, 12, 12)), 4)
    assert not loss.isfinite()


@pytest.mark.slow
def test_a_training_that_diverges_says_so_and_keeps_what_was_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    rate_at = Recipe.rate_at
    monkeypatch.setattr(
        Recipe, "rate_at", lambda self, share: 1e30 if share > 0.45 else rate_at(self, share)
    )
    noisy, out = suite_of(tmp_path, NOISY), tmp_path / "out"
    command = ["eitbench", "train", "phydnn", "--suite", noisy, "--operator", "fem"]
    monkeypatch.setattr(sys, "argv", [*command, "--epochs", "6", "--out", str(out)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 1
    lines = capfd.readouterr().err.splitlines()
    assert lines[-1].startswith(f"eitbench: The training in {out} diverged: a loss in epoch ")
    kept = len(rows(out))
    assert kept >= 2
    assert lines[-1].endswith(
        f"epoch {kept + 1} is not finite; its state after epoch {kept} is stored."
    )
    assert "Traceback" not in "".join(lines)
    assert all(np.isfinite(array).all() for array in state(out).values())
    with pytest.raises(DivergedError):
        train(TrainingRequest("phydnn", noisy, epochs=6, out=out, operator="fem"))
    assert len(rows(out)) == kept


@pytest.mark.slow
def test_it_ends_early_when_nothing_improves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(rate=0.0, patience=3))
    noisy = suite_of(tmp_path, NOISY)
    for _ in range(2):  # and is not taken up again
        result = train(TrainingRequest("dnn", noisy, epochs=50, out=tmp_path / "o", **QUICK))
        assert len(rows(tmp_path / "o")) == 4
    # Without a step the network is the best linear map.
    assert result.validation_loss == pytest.approx(result.baseline_loss, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("dnn", {"limit": 127}, "127 training samples are too few"),
        ("dnn", {"beta": 0.1}, "'dnn' has no physical loss: train 'phydnn'"),
        ("phydnn", {"beta": -1.0}, "beta of the physical loss is at least 0"),
        ("phydnn", {"alpha": 0.5}, "alpha of the data loss is 1, or 0 with a physical loss"),
        ("dnn", {"alpha": 0.0}, "alpha of the data loss is 1, or 0 with a physical loss"),
        ("dnn", {"operator": "fe"}, "Unknown operator 'fe': did you mean 'fem'"),
        ("dnn", {"backbone": "mpl", **QUICK}, "Unknown backbone 'mpl': did you mean 'mlp'"),
        ("phydnn", {}, "'surrogate' has no weights for the sensor 'foam16'"),
        ("phydnn", {"loss": "log-mse"}, "'phydnn' takes no --loss log-mse"),
        ("dnn", {"loss": "log-mes"}, "Unknown loss 'log-mes': did you mean 'log-mse'"),
        ("dnn", {"start": "weights"}, "'dnn' has no weights for the sensor 'foam16'"),
        ("dnn", {"start": "old"}, "Unknown start of a training: 'old': known: new, weights"),
        ("dnn", {"install": "ever"}, "Unknown choice of --install: 'ever'"),
        ("surrogate", {"beta": 0.1}, "'surrogate' takes no --beta 0.1"),
        ("surrogate", {"gain_power": 0.5}, "'surrogate' takes no --gain-power 0.5"),
        ("dnn", {"gain_power": -1.0}, "The power of gains is at least 0, got -1.0"),
        ("dnn", {"gain_power": 1.0}, "have no gains to be taken out"),
        ("latent-flow", {"gain_power": 0.5}, "have no gains to be taken out"),
        ("dnn-randomised", {}, "'dnn' has no weights for the sensor 'foam16'"),
        ("learned-gn", {}, "'dnn' has no weights for the sensor 'foam16'"),
        ("coarse-to-fine", {"limit": 127}, "127 training samples are too few"),
        ("learned-proximal", {"limit": 127}, "127 training samples are too few"),
        ("fno", {"backbone": "unet"}, "'fno' takes no --backbone unet"),
        ("dn", {}, "Unknown name to train 'dn': did you mean 'dnn'"),
    ],
)
def test_what_cannot_be_trained_is_said_before_anything_is_simulated(
    name: str,
    options: dict[str, Any],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match=sentence):
        train(TrainingRequest(name, suite_of(tmp_path, NOISY), epochs=1, **options))
    assert not (tmp_path / "cache" / "simulated").exists()


def test_a_device_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="torch finds no GPU to train on: use --device cpu"):
        training_device("cuda")
    with pytest.raises(InputError, match="Unknown device 'gpu'"):
        training_device("gpu")
    assert training_device("auto").type == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [training_device(name).type for name in ("auto", "cpu")] == ["cuda", "cpu"]


@pytest.mark.slow
def test_what_is_worse_on_validation_data_is_not_put_in_use(
    trained: TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither worse than the linear map that it began as, nor than the weights in use."""
    used = weight_files.user_weights() / trained.weights.name
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32, rate=0.1))
    spoiled = TrainingRequest("dnn", suite_of(tmp_path, TINY), epochs=1, out=tmp_path / "spoiled")
    result = train(spoiled)
    assert result.validation_loss > result.baseline_loss
    assert result.better == "the best linear map"
    assert not result.in_use
    assert not used.exists()
    assert "'dnn' does not use them, for the best linear map has a lower" in result.sentences()[-1]
    # No surrogate was asked for, nor its loss shown.
    assert "validation_physical" not in rows(tmp_path / "spoiled")[0]
    assert train(replace(spoiled, install="always")).in_use
    assert used.exists()

    before = install(trained).read_bytes()
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32, rate=1e-5))
    short = replace(spoiled, backbone="mlp", out=tmp_path / "short")
    result = train(short)
    assert result.loss_before == pytest.approx(trained.validation_loss, rel=1e-5)
    assert trained.validation_loss < result.validation_loss
    assert result.better == "the weights in use"
    assert not result.in_use
    assert used.read_bytes() == before
    assert train(replace(short, install="always")).loss_before == result.loss_before
    assert used.read_bytes() != before
    assert train(short).in_use  # it is no worse than itself


@pytest.mark.slow
def test_a_training_continues_weights_and_counts_their_time(
    trained: TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used, out = install(trained), tmp_path / "out"
    used.with_suffix(".json").write_bytes(trained.weights.with_suffix(".json").read_bytes())
    before = json.loads(trained.weights.with_suffix(".json").read_text())
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32))
    tiny = suite_of(tmp_path, TINY)
    request = TrainingRequest("dnn", tiny, epochs=4, limit=128, start="weights", out=out)
    result = train(replace(request, loss="log-mse", install="never"))
    about = json.loads(result.weights.with_suffix(".json").read_text())
    assert result.baseline == "the weights that it continues"
    assert result.baseline_loss == result.loss_before
    # Begun anew, 16 steps do not come near to it.
    assert result.validation_loss < result.baseline_loss + 0.1
    own = sum(row["seconds"] for row in rows(out))
    assert float(about["train_s"]) == pytest.approx(float(before["train_s"]) + own, abs=0.1)
    assert about["train_samples"] == "240"  # of the weights, which have seen more
    assert about["begun_weights"] == hashlib.sha256(used.read_bytes()).hexdigest()
    assert " --limit 128 --start weights --loss log-mse" in about["command"]
    assert max(row["rate"] for row in rows(out)) <= 0.1e-3
    with pytest.raises(InputError, match="holds the weights of another network"):
        train(replace(request, backbone="mlp", out=tmp_path / "other"))
    other = suite_of(tmp_path, SimulatedScenario(**TINY.model_dump() | {"train": 239}))
    with pytest.raises(InputError, match="was trained on other data than those of scenario 'tiny'"):
        train(replace(request, suite=other, out=tmp_path / "other"))


@pytest.mark.slow
def test_training_data_without_end_are_new_phantoms_and_counted(
    trained: TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh, seen = TrainingJob.fresh_samples, []

    def watched(job: TrainingJob, epoch: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        seen.append(fresh(job, epoch, count))
        return seen[-1]

    monkeypatch.setattr(TrainingJob, "fresh_samples", watched)
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32, rate=1e-4))
    tiny, out = suite_of(tmp_path, TINY), tmp_path / "o"
    request = TrainingRequest("dnn", tiny, epochs=3, limit=100, unlimited=True, out=out)
    about = json.loads(train(request).weights.with_suffix(".json").read_text())
    assert (about["train_samples"], about["unlimited"]) == ("300", "1")
    assert about["command"].endswith(" --seed 0 --limit 100 --unlimited")
    # The next samples of the same stream: the first of them are declared, too.
    declared = load(TINY, "train")
    assert declared.conductivity is not None
    sigma, voltages = seen[0]
    np.testing.assert_allclose(sigma, declared.conductivity[100:200], rtol=1e-6)
    clean = clean_frames(TINY, "train", 200).voltages[100:]
    np.testing.assert_allclose(voltages, clean, rtol=1e-9, atol=1e-11)
    beyond = seen[1][1][len(declared) - 200 :].numpy()
    known = clean_frames(TINY, "train", len(declared)).voltages
    assert len(beyond)
    assert np.abs(beyond[:, None] - known).max(axis=2).min() > 1e-6
    method = Dnn(str(out / trained.weights.name))
    method.fit(tiny_problem())
    assert method.trained_on["unlimited"] == "1"


def test_more_training_samples_than_are_declared_follow_these(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ImageNetworkMethod, "recipe", recipe(batch=32, rate=1e-4))
    given: list[Data] = []

    def fit(job: TrainingJob, task: ImageTask, train: Data, *others: Any, **options: Any) -> None:
        given.append(train)
        assert others[2]["train_samples"] == str(TINY.train + 40)

    monkeypatch.setattr(TrainingJob, "fit", fit)
    tiny = suite_of(tmp_path, TINY)
    train(TrainingRequest("dnn", tiny, limit=TINY.train + 40, out=tmp_path / "o"))
    declared = load(TINY, "train")
    assert declared.conductivity is not None
    difference, _, images, units = given[0]
    assert len(difference) == len(images) == len(units) == TINY.train + 40
    shown = slice(TINY.train)
    np.testing.assert_allclose(images[shown], declared.conductivity / SENSOR.background, rtol=1e-6)
    clean = clean_frames(TINY, "train", TINY.train)
    expected = clean.voltages - clean.untouched
    np.testing.assert_allclose(difference[shown], expected, atol=1e-6 * np.abs(expected).max())
    further = np.unique(images[TINY.train :].flatten(1).numpy(), axis=0)
    assert len(further) == 40
    # So do samples of further units, where a scenario trains on units.
    train(TrainingRequest("dnn", suite_of(tmp_path, UNEVEN), limit=TINY.train + 40, out=tmp_path))
    difference, _, images, units = given[1]
    more = load(UNEVEN.model_copy(update={"train": TINY.train + 40}), "train")
    assert more.conductivity is not None
    np.testing.assert_allclose(images, more.conductivity / SENSOR.background, rtol=1e-6)
    assert len(difference) == len(images) == len(units) == len(more)
    assert len(np.unique(more.references, axis=0)) == -(-len(more) // TOUCHES)


@pytest.mark.parametrize("name", ["dnn", "latent-flow", "coarse-to-fine"])
@pytest.mark.parametrize("more", [0, 40])
def test_weights_say_whether_they_learned_from_more_samples_than_are_declared(
    name: str, more: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cls: Any = methods()[name]
    monkeypatch.setattr(cls, "recipe", replace(cls.recipe, batch=16))
    suite, count = suite_of(tmp_path, TINY), TINY.train + more
    trained = train(TrainingRequest(name, suite, epochs=1, limit=count, out=tmp_path / "out"))
    about = json.loads(trained.weights.with_suffix(".json").read_text())
    assert (about["train_samples"], about["unlimited"]) == (str(count), str(int(more > 0)))


def test_a_loss_of_logarithms_is_the_mean_psnr() -> None:
    error = torch.randn(5, 8, 8, dtype=torch.float64) * torch.logspace(-1, 1, 5)[:, None, None]
    psnr = -10 * torch.log10(error.square().mean((1, 2)) + 1e-5)
    found = image_loss("log-mse")(error)
    assert float(-10 / math.log(10) * found) == pytest.approx(float(psnr.mean()))
    assert float(image_loss("mse")(error)) == pytest.approx(float(error.square().mean()))


@pytest.mark.slow
def test_another_choice_needs_another_folder(tmp_path: Path) -> None:
    noisy = suite_of(tmp_path, NOISY)
    one = TrainingRequest("dnn", noisy, epochs=1, out=tmp_path / "o", **QUICK)
    train(one)
    with pytest.raises(InputError, match="begun with limit 130, not 128"):
        train(replace(one, limit=128))
    with pytest.raises(InputError, match="begun with name 'dnn', not 'phydnn'"):
        train(replace(one, name="phydnn"))


def test_a_recorded_set_has_nothing_to_fit_a_linear_map_on() -> None:
    def splits(split: str, limit: int | None) -> Dataset:
        return replace(load(TINY, split, limit), truth="position")

    p = Problem(SENSOR, load(TINY, "test", 1).references[0], splits)
    with pytest.raises(InputError, match="has no true images to learn from"):
        create("linear-learned").fit(p)


UNEVEN = TINY.model_copy(
    update={
        "name": "uneven",
        "training_imperfections": TrainingImperfections(
            electrode_shift_m=0.0005, drift=0.01, gain=0.05, dead_share=0.5
        ),
    }
)


@pytest.mark.parametrize(
    ("name", "gain_power"),
    [pytest.param("dnn", 0.0, marks=pytest.mark.slow), ("dnn", 1.0), ("latent-flow", 1.0)],
)
def test_a_network_sees_in_training_what_it_sees_in_use(
    name: str, gain_power: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last bit, for the same frame and reference frame, where no noise is drawn."""
    given: list[Any] = []

    def fit(job: TrainingJob, task: Any, train: Data, *others: Any, **options: Any) -> None:
        given.append((task, train))

    monkeypatch.setattr(TrainingJob, "fit", fit)
    monkeypatch.setattr(augmentation, "UNTOUCHED", 0.0)
    monkeypatch.setattr(LatentFlowMethod, "recipe", replace(LatentFlowMethod.recipe, batch=16))
    train(TrainingRequest(name, suite_of(tmp_path, UNEVEN), gain_power=gain_power))
    task, learned = given[0]
    alone = replace(task.augmentation, motions=task.augmentation.motions[:1])
    seen, truth, _ = alone(*learned)
    data = load(UNEVEN, "train")
    assert len(data) == len(seen)
    assert data.conductivity is not None
    in_use: list[Array] = []

    class Watched(Dnn):
        def fit(self, problem: Problem) -> None:
            self._problem, self.effective_gain_power = problem, self.gain_power

        def relative(self, difference: Array) -> Images:
            in_use.append(difference)
            return np.ones((len(difference), 16, 16), dtype=np.float32)

    problem = Problem(data.sensor, data.references[0], no_split)
    method = Watched(gain_power=gain_power)
    method.fit(problem)
    reconstructed(method, problem, data)
    assert torch.equal(seen, torch.from_numpy(np.concatenate(in_use)).float())
    np.testing.assert_allclose(truth, data.conductivity, rtol=1e-6)


@pytest.mark.slow
def test_a_network_that_begins_with_that_of_another_method_learns_from_other_units(
    trained: TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = install(trained)
    monkeypatch.setattr(DnnRandomised, "recipe", replace(DnnRandomised.recipe, batch=32))
    uneven = suite_of(tmp_path, UNEVEN)
    with pytest.raises(InputError, match="'uneven' have `training_imperfections`"):
        train(TrainingRequest("dnn-randomised", uneven, unlimited=True, out=tmp_path / "never"))
    result = train(TrainingRequest("dnn-randomised", uneven, epochs=12, out=tmp_path / "out"))
    about = json.loads(result.weights.with_suffix(".json").read_text())
    assert about["begun_weights"] == hashlib.sha256(used.read_bytes()).hexdigest()
    assert result.baseline == "the weights that it continues"
    assert result.baseline_loss == pytest.approx(trained.validation_loss, rel=0.1)
    data = load(UNEVEN, "train")
    assert data.conductivity is not None
    error = {}
    for name, weights in (("dnn", trained.weights), ("dnn-randomised", result.weights)):
        method = create(name, weights=str(weights))
        problem = Problem(data.sensor, data.references[0], no_split)
        method.fit(problem)
        error[name] = np.mean((reconstructed(method, problem, data) - data.conductivity) ** 2)
    assert error["dnn-randomised"] < 0.95 * error["dnn"]


@pytest.mark.slow
def test_weights_bring_the_power_of_gains_that_they_were_trained_with(tmp_path: Path) -> None:
    uneven = suite_of(tmp_path, UNEVEN)
    request = TrainingRequest("dnn", uneven, epochs=1, gain_power=1.0, out=tmp_path / "out")
    weights = str(train(request).weights)
    data = load(UNEVEN, "train", 3)
    images = []
    for gain_power in (0.0, 1.0, 0.5):
        problem = Problem(data.sensor, data.references[0], no_split)
        method = create("dnn", weights=weights, gain_power=gain_power)
        method.fit(problem)
        images.append(reconstructed(method, problem, data))
    np.testing.assert_array_equal(images[0], images[1])
    assert np.abs(images[2] - images[1]).max() > 1e-3
