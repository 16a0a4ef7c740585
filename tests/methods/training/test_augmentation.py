"""Noise that is drawn anew in training, beside that of measured data."""

from pathlib import Path

import numpy as np
import pytest
import torch
from tests.support.small_sensors import TINY, suite_of

from eitbench.methods import Problem, create
from eitbench.methods.learned import image_network_training
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.methods.training import TrainingRequest, augmentation, train
from eitbench.methods.training.augmentation import Augmentation, Symmetry, symmetries
from eitbench.scenarios import load
from eitbench.scenarios.data.simulation import clean_frames
from eitbench.scenarios.imperfections.noise import Noise
from eitbench.scenarios.suites.scenario import SplitNoise


@pytest.mark.parametrize("noise", [30.0, 50.0, "mixture"])
def test_augmented_differences_are_as_noisy_as_measured_ones(
    noise: Noise, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A difference has the noise of two frames: that of the touch and the reference frame."""
    monkeypatch.setattr(augmentation, "UNTOUCHED", 0.0)
    scenario = TINY.model_copy(update={"noise": SplitNoise(train=noise)})
    clean, data = clean_frames(scenario, "train", 240), load(scenario, "train")
    problem = Problem(scenario.nominal_sensor, clean.untouched[0], no_split)
    difference = problem.difference(clean.voltages)
    rms = np.sqrt(np.mean(clean.voltages**2, axis=1))

    identity = symmetries(scenario.nominal_sensor, torch.from_numpy(problem.jacobian))[:1]
    with torch.random.fork_rng():
        torch.manual_seed(0)
        reference_rms = float(np.sqrt(np.mean(clean.untouched[0] ** 2)))
        drawn, _, _ = Augmentation(noise, identity, reference_rms)(
            torch.from_numpy(difference), torch.from_numpy(rms), torch.ones(240, 1, 1)
        )
    levels = [
        np.sqrt(np.mean((noisy - difference) ** 2, axis=1)) / rms
        for noisy in (drawn.numpy(), problem.differences(data))
    ]
    if noise == "mixture":  # half of either is clean
        assert [np.mean(level < 1e-4) for level in levels] == pytest.approx([0.5, 0.5], abs=0.15)
    else:
        assert levels[0].mean() == pytest.approx(levels[1].mean(), rel=0.015)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_networks_that_learn_with_a_noisy_reference_are_better(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On sessions at 30 dB, the noisiest of the mixture, in the mean over three seeds."""
    noise = SplitNoise(train="mixture", validation="mixture", test=30)
    size = {"image_shape": (24, 24), "train": 1200, "validation": 150, "test": 300}
    scenario = TINY.model_copy(update={"name": "noisy", "noise": noise, **size})
    suite, test = suite_of(tmp_path, scenario), load(scenario, "test")
    error: dict[bool, list[float]] = {False: [], True: []}
    for known in error:

        def made(
            noise: Noise,
            motions: list[Symmetry],
            rms: float,
            estimates: torch.Tensor,
            known: bool = known,
        ) -> object:
            return Augmentation(noise, motions, rms if known else 0.0, estimates)

        monkeypatch.setattr(image_network_training, "Augmentation", made)
        for seed in range(3):
            out = tmp_path / f"{known}-{seed}"
            request = TrainingRequest(
                "dnn", suite, epochs=12, seed=seed, out=out, operator="jacobian"
            )
            method = create("dnn", weights=str(train(request).weights))
            problem = Problem(test.sensor, test.references[0], no_split)
            method.fit(problem)
            assert test.conductivity is not None
            images = reconstructed(method, problem, test)
            error[known].append(float(np.mean((images - test.conductivity) ** 2)))
    gains_db = 10 * np.log10(np.divide(error[False], error[True]))
    print(f"gain of the noise of the reference frame in training: {gains_db} dB")
    assert gains_db.mean() > 0
