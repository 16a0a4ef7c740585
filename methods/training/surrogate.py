"""Training of the surrogate operator on a simulated scenario's clean voltages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.operators.surrogate import WEIGHTS, SurrogateNetwork
from eitbench.methods.training.job import (
    Training,
    clean_samples,
    data_settings,
    finish,
    training_folder,
    training_scenario,
)
from eitbench.methods.training.loop import begun_in, fit
from eitbench.methods.training.recipe import Recipe
from eitbench.methods.training.request import CHOICES, Request
from eitbench.methods.training.symmetry import symmetries
from eitbench.methods.training.trainee import Data, OneLoss
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.training.symmetry import Symmetry

EPOCHS = 40
BATCH = 64
RATE = 1e-3


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


def train_surrogate(request: Request) -> Training:
    """Train on the suite's simulated sensor; see `train`."""
    request.refuse(*CHOICES)
    scenario = training_scenario(load_suite(request.suite))
    sensor = scenario.nominal_sensor
    folder = training_folder(WEIGHTS, sensor, request.out)
    recipe = Recipe(request.epochs or EPOCHS, request.seed, BATCH, RATE)
    settings = data_settings(WEIGHTS, scenario)
    begun_in(folder, recipe, settings)  # before minutes are spent on data
    jobs, progress = request.jobs, request.progress
    sigma, voltages = clean_samples(scenario, "train", scenario.train, jobs=jobs, progress=progress)
    seen_sigma, seen_voltages = clean_samples(
        scenario, "validation", scenario.validation, jobs=jobs, progress=progress
    )

    with torch.random.fork_rng():
        torch.manual_seed(request.seed)
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
        devices=request.devices,
        progress=progress,
    )
    error = (linear.tensor_voltages(seen_sigma.double()) - seen_voltages) / std
    jacobian_mse = float(error.square().mean())
    about = {
        "command": request.command(recipe.epochs),
        **trained.about(),
        "jacobian_validation_mse": repr(jacobian_mse),
    }
    path = finish(request, WEIGHTS, scenario, trained.weights, trained.curve, about)
    return Training(
        request.name, path, request.use, trained.best.validation, "the Jacobian", jacobian_mse
    )
