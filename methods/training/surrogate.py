"""Training of the surrogate operator on a simulated scenario's clean voltages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.operators.surrogate import WEIGHTS, SurrogateNetwork
from eitbench.methods.training.job import (
    clean_samples,
    data_settings,
    put_in_use,
    save_result,
    training_folder,
    training_scenario,
)
from eitbench.methods.training.loop import begun_in, fit
from eitbench.methods.training.recipe import ONE_DEVICE, Devices, Recipe
from eitbench.methods.training.symmetry import symmetries
from eitbench.methods.training.trainee import Data, OneLoss
from eitbench.scenarios.suites import load_suite

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eitbench.methods.training.symmetry import Symmetry

EPOCHS = 40
BATCH = 64
RATE = 1e-3


@dataclass(frozen=True)
class SurrogateTraining:
    """A finished training.

    Attributes:
        weights: the file of weights that the operator will use from now on.
        validation_mse: mean squared error of standardised voltages on the validation split.
        jacobian_mse: the same of the `jacobian` operator.
    """

    weights: Path
    validation_mse: float
    jacobian_mse: float

    def sentences(self) -> list[str]:
        """What to tell the user."""
        ratio = self.jacobian_mse / self.validation_mse
        return [
            f"Validation MSE of standardised voltages: {self.validation_mse:.3g}, {ratio:.3g} "
            f"times below the Jacobian's {self.jacobian_mse:.3g}.",
            f"Weights: {self.weights}",
            "The operator `surrogate` uses them from now on; delete the file to go back.",
        ]


class SurrogateTrainee(OneLoss):
    """Mean squared error of standardised voltages, over all measurements of a frame.

    While it trains, each batch is seen under a random symmetry of the sensor.
    """

    network: SurrogateNetwork
    shares: Tensor

    def __init__(self, network: SurrogateNetwork, motions: Sequence[Symmetry]) -> None:
        super().__init__(network)
        self._motions = motions
        shares = torch.bincount(network.owner) / len(network.owner)
        self.register_buffer("shares", shares.float(), persistent=False)

    def loss(self, batch: Data) -> Tensor:
        """From conductivities (n, H, W) [S/m] and clean voltages (n, M) [V/A]."""
        sigma, voltages = batch
        if self.training:
            motion = self._motions[int(torch.randint(len(self._motions), ()))]
            sigma, voltages = motion.images(sigma), motion.voltages(voltages)
        error: Tensor = self.network(sigma) - self.network.standardised(voltages)
        return (error.square() @ self.shares).mean()


def train_surrogate(
    suite: str,
    *,
    epochs: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: Path | None = None,
    devices: Devices = ONE_DEVICE,
    progress: bool = False,
) -> SurrogateTraining:
    """Train on the suite's simulated sensor, or continue, and put the weights in use.

    Args:
        suite: name, or path of a suite file, whose first scenario with training and validation
            samples is trained on.
        epochs: how often every training sample is seen.
        seed: of the initial weights and of the order of samples.
        jobs: number of processes to simulate with.
        out: where state and results are kept; a folder in the cache by default.
        devices: to train on.
        progress: show on stderr how far it is.

    Raises:
        InputError: a suite without training samples or with several sensors; `out` holds a training
            with other settings.
        DataCorruptError: what `out` holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        EitbenchError: a folder is not writable or full.
    """
    scenario = training_scenario(load_suite(suite))
    sensor = scenario.nominal_sensor
    folder = training_folder(WEIGHTS, sensor, out)
    recipe = Recipe(epochs=EPOCHS if epochs is None else epochs, seed=seed, batch=BATCH, rate=RATE)
    settings = data_settings(WEIGHTS, scenario)
    begun_in(folder, recipe, settings)  # before minutes are spent on data
    sigma, voltages = clean_samples(scenario, "train", scenario.train, jobs=jobs, progress=progress)
    seen_sigma, seen_voltages = clean_samples(
        scenario, "validation", scenario.validation, jobs=jobs, progress=progress
    )

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = SurrogateNetwork(sensor)
    linear = Jacobian(sensor)
    jacobian = linear.matrix.reshape(-1, *sensor.image_shape)
    mean, std = voltages.mean(0), voltages.std(0)
    std = std.clamp(min=1e-6 * std.max())  # a measurement that never changes
    network.start_from(mean, std, linear.reference, jacobian)
    trained = fit(
        SurrogateTrainee(network, symmetries(sensor, jacobian)),
        recipe,
        (sigma, voltages.float()),
        (seen_sigma, seen_voltages.float()),
        folder,
        settings,
        devices=devices,
        progress=progress,
    )
    error = (linear.tensor_voltages(seen_sigma.double()) - seen_voltages) / std
    jacobian_mse = float(error.square().mean())
    figures = {
        "command": f"eitbench train surrogate --suite {suite} --epochs {recipe.epochs} "
        f"--seed {seed}",
        "jacobian_validation_mse": repr(jacobian_mse),
    }
    weights = save_result(WEIGHTS, scenario, folder, recipe, trained, figures)
    return SurrogateTraining(put_in_use(weights), trained.best.validation, jacobian_mse)
