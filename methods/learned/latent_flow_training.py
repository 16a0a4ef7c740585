"""Training of the flow over images given frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench.methods.networks.latent_flow import LatentFlow
from eitbench.methods.training.augmentation import Augmentation, noise_estimates, symmetries
from eitbench.methods.training.loop import Data, TrainingTask
from eitbench.methods.training.samples import images, nominal_problem
from eitbench.scenarios.data.datasets import load

if TYPE_CHECKING:
    from eitbench.methods.training.job import TrainingJob, TrainingResult

SEEN_FIRST = 2000
"""Training samples that components are taken from, each as often as there are symmetries, under one
that is drawn."""


class FlowTask(TrainingTask):
    """Mean negative log density of the components of true images, over their number.

    A batch for training holds differences (n, M) [V/A], rms of the frames (n,) [V/A], relative
    images (n, H, W) and the numbers of the estimates (n,) that noise goes through, and is
    augmented; one for validation differences and images.
    """

    network: LatentFlow

    def __init__(self, network: LatentFlow, augmentation: Augmentation) -> None:
        super().__init__(network)
        self.augmentation = augmentation

    def loss(self, batch: Data) -> Tensor:
        """Return the loss () of a batch."""
        if self.training:
            difference, truth, _ = self.augmentation(*batch)
        else:
            difference, truth = batch
        density = self.network.log_density(self.network.encoded(truth - 1), difference)
        return -density.mean() / len(self.network.components)


def train_latent_flow(job: TrainingJob) -> TrainingResult:
    """Train the flow; see `eitbench.methods.training.train`."""
    job.check_gains()
    scenario, sensor, count = job.scenario, job.sensor, job.training_count(more=True)
    gain_power = job.request.gain_power
    job.check(limit=count, gain_power=gain_power)
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        network = LatentFlow(sensor.n_measurements, sensor.image_shape)
    problem = nominal_problem(scenario)
    clean, truth = job.noiseless(count), images(scenario, "train", count) / sensor.background
    difference = torch.from_numpy(problem.differences(clean, gain_power)).float()
    units, estimates = noise_estimates(problem, clean.references, gain_power)
    frame_rms = torch.from_numpy(np.sqrt(np.mean(clean.voltages**2, axis=1))).float()
    train = (difference, frame_rms, truth, units)
    seen = load(scenario, "validation", jobs=job.request.jobs, progress=job.request.progress)
    seen_truth = images(scenario, "validation", scenario.validation) / sensor.background
    validation = (torch.from_numpy(problem.differences(seen, gain_power)).float(), seen_truth)
    moves = symmetries(sensor, torch.from_numpy(problem.jacobian))
    rms = float(np.sqrt(np.mean(problem.reference**2)))
    augmentation = Augmentation(scenario.split_noise("train"), moves, rms, estimates)
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        first = [augmentation(*(tensor[:SEEN_FIRST] for tensor in train)) for _ in moves]
        contrasts = torch.cat([moved - 1 for _, moved, _ in first])
        network.start_from(contrasts, torch.cat([frames for frames, _, _ in first]))
    task = FlowTask(network, augmentation)
    return job.fit(
        task, train, validation, "a normal distribution of all images",
        {"gain_power": repr(gain_power), "train_samples": str(count)},
    )  # fmt: skip
