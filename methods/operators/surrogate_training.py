"""Training of the surrogate operator on a simulated scenario's clean voltages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.operators.surrogate import SurrogateNetwork
from eitbench.methods.training.augmentation import symmetries
from eitbench.methods.training.samples import clean_samples
from eitbench.methods.training.task import Data, OneLossTask

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.job import TrainingJob, TrainingResult


class SurrogateTask(OneLossTask):
    """Mean squared error of standardised voltages, over all measurements of a frame.

    In training, each batch is seen under a random symmetry of the sensor.
    """

    network: SurrogateNetwork
    shares: Tensor

    def __init__(self, network: SurrogateNetwork, motions: Sequence[Symmetry]) -> None:
        super().__init__(network)
        self._motions = motions
        shares = torch.bincount(network.owner) / len(network.owner)
        self.register_buffer("shares", shares.float(), persistent=False)

    def loss(self, batch: Data) -> Tensor:
        """Return the loss of conductivities (n, H, W) [S/m] and clean voltages (n, M) [V/A]."""
        sigma, voltages = batch
        if self.training:
            motion = self._motions[int(torch.randint(len(self._motions), ()))]
            sigma, voltages = motion.images(sigma), motion.voltages(voltages)
        error: Tensor = self.network(sigma) - self.network.standardised(voltages)
        return (error.square() @ self.shares).mean()


def train_surrogate(job: TrainingJob) -> TrainingResult:
    """Train on the job's sensor; see `eitbench.methods.training.train`."""
    job.check({})
    scenario, sensor, request = job.scenario, job.sensor, job.request
    jobs, progress = request.jobs, request.progress
    sigma, voltages = clean_samples(scenario, "train", scenario.train, jobs=jobs, progress=progress)
    seen_sigma, seen_voltages = clean_samples(
        scenario, "validation", scenario.validation, jobs=jobs, progress=progress
    )
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        network = SurrogateNetwork(sensor)
    linear = Jacobian(sensor)
    jacobian = linear.matrix.reshape(-1, *sensor.image_shape)
    mean, std = voltages.mean(0), voltages.std(0)
    std = std.clamp(min=1e-6 * std.max())  # a measurement that never changes
    network.start_from(mean, std, linear.reference, jacobian)
    fitted = job.fit(
        SurrogateTask(network, symmetries(sensor, jacobian)),
        (sigma, voltages.float()),
        (seen_sigma, seen_voltages.float()),
        {},
    )
    error = (linear.tensor_voltages(seen_sigma.double()) - seen_voltages) / std
    jacobian_mse = float(error.square().mean())
    metadata = {"jacobian_validation_mse": repr(jacobian_mse)}
    return job.finish(fitted, metadata, "the Jacobian", jacobian_mse)
