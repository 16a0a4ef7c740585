"""Training: it learns, survives being killed, and refuses what it cannot continue."""

import json
import logging
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.support.small_sensors import suite_of
from torch import nn

from eitbench.cli import main
from eitbench.methods import operator
from eitbench.methods.operators.surrogate import Surrogate, SurrogateNetwork, SurrogateTask
from eitbench.methods.training import Recipe, TrainingInterruptedError, TrainingRequest, train
from eitbench.methods.training.augmentation import symmetries
from eitbench.methods.training.checkpoint import CHECKPOINT_FILE as FILE
from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.loop import Data, TrainingTask, fit
from eitbench.methods.weights.weight_files import user_weights
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite

WEIGHTS = "weights/"


def tiny(pixels: int = 16, train: int = 128, name: str = "tiny") -> SimulatedScenario:
    return SimulatedScenario(
        name=name,
        image_shape=(pixels, pixels),
        families=("circle", "two-circles", "l-shape", "triangle", "rectangle", "ring"),
        train=train,
        validation=60,
        test=6,
    )


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_command_of_a_training_may_be_pasted_into_a_shell() -> None:
    request = TrainingRequest("dnn", "my suites/own.toml", scenario="a b", loss="log-mse")
    words = shlex.split(request.command(5))
    assert words[words.index("--suite") + 1] == "my suites/own.toml"
    assert words[words.index("--scenario") + 1] == "a b"


def stored(folder: Path, group: str = WEIGHTS) -> dict[str, Any]:
    found = read_arrays(folder / FILE)
    assert found is not None
    return {name: array for name, array in found[0].items() if name.startswith(group)}


def epochs_done(folder: Path) -> int:
    found = read_arrays(folder / FILE)
    return 0 if found is None else len(json.loads(found[1]["curve"]))


def equal(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


class Toy(TrainingTask):
    """A line with dropout; `at` calls a function on entering a training step of that number."""

    def __init__(self, at: dict[int, Callable[[], None]] | None = None) -> None:
        torch.manual_seed(0)
        super().__init__(nn.Sequential(nn.Dropout(0.3), nn.Linear(5, 2)))
        self.at = at or {}
        self.steps = 0

    def loss(self, batch: Data) -> torch.Tensor:
        if self.training:
            self.at.get(self.steps, lambda: None)()
            self.steps += 1
        x, y = batch
        error: torch.Tensor = self.network(x) - y
        return error.square().mean()


def toy_data(count: int = 23) -> Data:
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(count, 5, generator=generator)
    return x, x[:, :2] - x[:, 2:4] + 0.1 * torch.randn(count, 2, generator=generator)


def toy_fit(
    folder: Path, trainee: Toy, epochs: int = 6, rate: float = 0.1, progress: bool = False
) -> Checkpoint:
    recipe = Recipe(epochs=epochs, seed=3, batch=10, rate=rate)
    return fit(trainee, recipe, toy_data(), toy_data(7), folder, {"kind": "toy"}, progress=progress)


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)  # Python delivers it between two instructions


@pytest.mark.slow
def test_the_surrogate_learns_what_a_linear_branch_cannot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny_suite = suite_of(tmp_path, tiny(train=600))
    result = train(TrainingRequest("surrogate", tiny_suite, epochs=8))
    assert result.validation_loss < 0.6 * result.baseline_loss
    sentences = " ".join(result.sentences())
    assert str(result.weights) in sentences
    assert f"loss: {result.validation_loss:.3g} ({result.baseline_loss:.3g} of the Jac" in sentences

    s = load_suite(tiny_suite).scenarios[0].nominal_sensor
    assert result.weights == user_weights() / Surrogate.files.file_name(s)
    f = operator("surrogate", s)
    assert f.trained_on == "cpu"
    assert f.train_s > 0
    about = json.loads(result.weights.with_suffix(".json").read_text())
    assert about["command"] == f"eitbench train surrogate --suite {tiny_suite} --epochs 8 --seed 0"
    assert [epoch["epoch"] for epoch in about["curve"]] == list(range(1, 9))
    assert min(epoch["validation"] for epoch in about["curve"]) == result.validation_loss

    # The same training of the physics branch alone: the correction stays at zero.
    def frozen(self: SurrogateNetwork, sigma: torch.Tensor) -> torch.Tensor:
        values: torch.Tensor = self.physics((sigma - 1).flatten(1) / 16)
        return values

    monkeypatch.setattr(SurrogateNetwork, "forward", frozen)
    alone = train(TrainingRequest("surrogate", tiny_suite, epochs=8, out=tmp_path / "alone"))
    assert result.validation_loss < 0.7 * alone.validation_loss


@pytest.mark.nightly
def test_a_killed_training_continues_as_if_it_had_never_stopped(tmp_path: Path) -> None:
    tiny_suite, killed, whole = suite_of(tmp_path, tiny()), tmp_path / "killed", tmp_path / "whole"
    command = [sys.executable, "-m", "eitbench.cli", "train", "surrogate", "--suite", tiny_suite]
    with subprocess.Popen(
        [*command, "--epochs", "15", "--seed", "7", "--out", str(killed)],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not (killed / FILE).exists() and process.poll() is None:
            time.sleep(0.005)
        process.kill()
        out, log = process.communicate()
    done = epochs_done(killed)
    assert 1 <= done < 15, log
    # In a log there is one line for an epoch, and nothing else.
    assert out == ""
    assert [line.split("  ")[0] for line in log.splitlines()][:done] == [
        f"epoch {k + 1}/15" for k in range(len(log.splitlines()))
    ][:done]
    train(TrainingRequest("surrogate", tiny_suite, epochs=15, seed=7, out=killed))
    train(TrainingRequest("surrogate", tiny_suite, epochs=15, seed=7, out=whole))
    assert epochs_done(killed) == 15
    for group in (WEIGHTS, "best/", "optimizer/"):
        assert equal(stored(killed, group), stored(whole, group))
    train(TrainingRequest("surrogate", tiny_suite, epochs=15, seed=8, out=tmp_path / "other"))
    assert not equal(stored(whole), stored(tmp_path / "other"))
    # Nothing is written but into the folder and the cache.
    assert {p.name for p in tmp_path.iterdir()} == {
        "tiny.toml",
        "killed",
        "whole",
        "other",
        "cache",
    }
    assert not list(tmp_path.rglob(".*"))


def test_ctrl_c_keeps_finished_epochs_and_the_same_call_continues(tmp_path: Path) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(TrainingInterruptedError, match="stopped"):
        toy_fit(tmp_path / "stopped", Toy({7: interrupt}))
    assert signal.getsignal(signal.SIGINT) is handler
    assert epochs_done(tmp_path / "stopped") == 2
    continued = toy_fit(tmp_path / "stopped", Toy())
    whole = toy_fit(tmp_path / "whole", Toy())
    assert equal(continued.best, whole.best)
    assert equal(stored(tmp_path / "stopped", ""), stored(tmp_path / "whole", ""))
    losses = [
        [(e.epoch, e.train, e.validation, e.rate) for e in t.curve] for t in (continued, whole)
    ]
    assert losses[0] == losses[1]


@pytest.mark.slow
def test_the_command_ends_with_130_on_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    loss, steps = SurrogateTask.loss, []

    def stopping(self: SurrogateTask, batch: Data) -> torch.Tensor:
        steps.append(1)
        if len(steps) == 3:  # one for training and one for validation were an epoch
            interrupt()
        return loss(self, batch)

    monkeypatch.setattr(SurrogateTask, "loss", stopping)
    arguments = ["train", "surrogate", "--suite", suite_of(tmp_path, tiny()), "--epochs", "3"]
    monkeypatch.setattr(sys, "argv", ["eitbench", *arguments, "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 130
    last = capfd.readouterr().err.splitlines()[-1]
    assert last.startswith("eitbench: Interrupted: ")
    assert str(tmp_path / "out") in last
    monkeypatch.setattr(SurrogateTask, "loss", loss)
    with pytest.raises(SystemExit) as done:
        main()
    assert done.value.code == 0
    assert "of the Jacobian)." in capfd.readouterr().out
    assert epochs_done(tmp_path / "out") == 3


def test_samples_of_every_epoch_may_be_new(tmp_path: Path) -> None:
    """An interrupted training takes up those of its next epoch."""
    asked: list[int] = []

    def renewed(epoch: int) -> Data:
        asked.append(epoch)
        return toy_data(20 + epoch)

    def run(name: str, trainee: Toy) -> Checkpoint:
        recipe = Recipe(epochs=4, seed=3, batch=10, rate=0.1)
        folder = tmp_path / name
        return fit(trainee, recipe, toy_data(), toy_data(7), folder, {}, renewed=renewed)

    with pytest.raises(TrainingInterruptedError):
        run("stopped", Toy({7: interrupt}))  # in the third epoch
    continued = run("stopped", Toy())
    assert asked == [1, 2, 2, 3]
    assert equal(continued.best, run("whole", Toy()).best)
    assert not equal(continued.best, toy_fit(tmp_path / "same", Toy(), epochs=4).best)


def test_a_finished_training_is_not_repeated(tmp_path: Path) -> None:
    first = toy_fit(tmp_path, Toy())
    unused = Toy({0: lambda: pytest.fail("trained again")})
    second = toy_fit(tmp_path, unused)
    assert equal(first.best, second.best)
    assert first.curve == second.curve


def test_the_weights_are_those_of_the_best_epoch(tmp_path: Path) -> None:
    def spoil() -> None:
        with torch.no_grad():
            toy.network[1].weight.add_(10.0)  # type: ignore[index]

    toy = Toy({11: spoil})  # in the fourth of six epochs
    trained = toy_fit(tmp_path, toy, rate=0.03)
    assert trained.best_epoch.epoch < 4
    assert trained.best_epoch.validation < min(e.validation for e in trained.curve[3:])
    toy.network.load_state_dict(trained.best)
    loss = toy.eval().loss(toy_data(7))
    assert loss.item() == pytest.approx(trained.best_epoch.validation, rel=1e-5)


def test_the_rate_rises_then_falls() -> None:
    recipe = Recipe(epochs=10, seed=0, batch=1, rate=2.0)
    rates = [recipe.rate_at(p) for p in (0.0, 0.025, 0.05, 0.5, 0.9, 1.0)]
    assert rates[:3] == [0.0, 1.0, 2.0]
    assert rates[2] > rates[3] > rates[4] > rates[5] == pytest.approx(0.0, abs=1e-12)


def test_a_folder_begun_with_other_settings_is_refused(tmp_path: Path) -> None:
    toy_fit(tmp_path, Toy())
    with pytest.raises(InputError, match=r"begun with epochs 6, not 7: choose .* --out"):
        toy_fit(tmp_path, Toy(), epochs=7)
    with pytest.raises(InputError, match=r"begun with rate 0\.1, not 0\.2"):
        toy_fit(tmp_path, Toy(), rate=0.2)
    tiny_suite = suite_of(tmp_path, tiny())
    train(TrainingRequest("surrogate", tiny_suite, epochs=1, out=tmp_path / "out"))
    shutil.rmtree(tmp_path / "cache" / "simulated")
    with pytest.raises(InputError, match="begun with seed 0, not 1"):
        train(TrainingRequest("surrogate", tiny_suite, epochs=1, seed=1, out=tmp_path / "out"))
    assert not (tmp_path / "cache" / "simulated").exists()  # said before anything is simulated
    with pytest.raises(InputError, match="at least 1 epoch, got 0"):
        toy_fit(tmp_path / "new", Toy(), epochs=0)


def test_a_damaged_or_foreign_checkpoint_is_named(tmp_path: Path) -> None:
    toy_fit(tmp_path, Toy())
    content = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(content[:-3])
    with pytest.raises(DataCorruptError, match=rf"{FILE} is damaged.*delete .* to begin again"):
        toy_fit(tmp_path, Toy())
    write_arrays(tmp_path / FILE, {"x": np.zeros(1)}, {"settings": "{}", "curve": "[]"})
    with pytest.raises(DataCorruptError, match=f"{FILE} is no checkpoint"):
        toy_fit(tmp_path, Toy())


def test_a_log_has_one_line_for_an_epoch(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    with warnings.catch_warnings(), caplog.at_level(logging.INFO):
        warnings.simplefilter("error")
        toy_fit(tmp_path, Toy(), epochs=2, progress=True)
    out, err = capfd.readouterr()
    assert out == ""
    assert [line.split("  ")[0] for line in err.splitlines()] == ["epoch 1/2", "epoch 2/2"]
    assert "validation" in err
    assert not caplog.records
    toy_fit(tmp_path / "quiet", Toy(), epochs=2)
    assert capfd.readouterr() == ("", "")


def test_what_cannot_be_trained_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no simulated scenario with training"):
        train(TrainingRequest("surrogate", suite_of(tmp_path, tiny(train=0))))
    two = suite_of(tmp_path, tiny(), tiny(pixels=12, name="coarse"))
    with pytest.raises(InputError, match=r"simulates 2 sensors .* name a scenario"):
        train(TrainingRequest("surrogate", two))
    result = train(TrainingRequest("surrogate", two, scenario="coarse", epochs=1))
    about = json.loads(result.weights.with_suffix(".json").read_text())
    assert about["scenario"] == "coarse"
    assert about["command"] == f"eitbench train surrogate --suite {two} --scenario coarse " + (
        "--epochs 1 --seed 0"
    )
    with pytest.raises(InputError, match="to train on: 'coars': did you mean 'coarse'"):
        train(TrainingRequest("surrogate", two, scenario="coars"))


def shifted() -> Sensor:
    s = sensor("foam16")
    return replace(s, electrodes=even_electrodes(s.outline, 16, 0.01, 1e-3, start=0.014))


def odd() -> Sensor:
    """One of its electrodes is worse than the others."""
    s = sensor("foam16")
    worse = replace(s.electrodes[5], contact_impedance=2e-3)
    return replace(s, electrodes=(*s.electrodes[:5], worse, *s.electrodes[6:]))


def both_ways() -> Sensor:
    """Every pair of opposite electrodes drives in both directions."""
    return replace(sensor("foam16"), pattern=sensor("ohmc16").pattern)


@pytest.mark.parametrize(
    ("make", "count"),
    [
        (lambda: replace(sensor("foam16"), image_shape=(12, 12)), 8),
        (lambda: replace(sensor("foam16", offset=4), image_shape=(12, 12)), 8),
        (lambda: replace(sensor("foam16"), image_shape=(12, 16)), 4),
        (lambda: replace(shifted(), image_shape=(12, 12)), 4),  # the turns are left
        (lambda: replace(odd(), image_shape=(12, 12)), 1),
        (lambda: replace(sensor("ohmc16"), image_shape=(24, 24)), 1),  # its mesh has no other
        (lambda: replace(both_ways(), image_shape=(12, 12)), 8),
        (
            lambda: replace(
                sensor("foam16"),
                image_shape=(12, 12),
                pattern=replace(offset_pattern(16, 3), magnitudes=True),
            ),
            8,
        ),
    ],
)
def test_moved_images_have_moved_voltages(make: Callable[[], Sensor], count: int) -> None:
    s = make()
    model = forward_model(s)
    found = symmetries(s, torch.from_numpy(model.jacobian(model.background)))
    assert len(found) == count
    sigma = torch.from_numpy(np.random.default_rng(0).uniform(0.2, 1.0, s.image_shape))
    frames = []
    for symmetry in found:
        moved = model.voltages(np.ascontiguousarray(symmetry.images(sigma).numpy()))
        expected = symmetry.voltages(torch.from_numpy(model.voltages(sigma.numpy())))
        np.testing.assert_allclose(moved, expected, rtol=1e-8)
        frames.append(moved)
    assert np.array_equal(found[0].images(sigma), sigma)
    assert len(np.unique(np.round(frames, 9), axis=0)) == count
