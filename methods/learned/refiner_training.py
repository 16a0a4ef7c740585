"""Training of the networks that refine images."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import joblib
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor, nn

from eitbench.methods.training.augmentation import symmetries
from eitbench.methods.training.loop import Data, TrainingTask, working_precision
from eitbench.methods.training.losses import image_loss
from eitbench.methods.training.samples import images, nominal_problem
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.interrupts import worker_pool

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.learned.refined import RefinementMethod
    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.suites.scenario import SimulatedScenario, Split


TOGETHER = 100
"""Samples that a process works on before it hands them over."""


class RefinerTask(TrainingTask):
    """An image loss of conductivity over background, of refined images.

    A batch holds the network's inputs (n, C, H, W) and the truth (n, H, W). In training, each batch
    is seen under a random symmetry of the sensor. Noise is that of the training split, not drawn
    anew: to work the inputs out again takes too long.
    """

    def __init__(self, network: nn.Module, motions: Sequence[Symmetry], loss: str = "mse") -> None:
        super().__init__(network)
        self._motions = motions
        self._image_loss = image_loss(loss)

    def loss(self, batch: Data) -> Tensor:
        """Return the loss () of a batch."""
        inputs, truth = self.moved(batch)
        with working_precision(inputs.device.type):
            refined = self.network(inputs)
        return self._image_loss(refined - truth)

    def moved(self, batch: Data) -> Data:
        """The batch as it is seen."""
        if not self.training:
            return batch
        motion = self._motions[int(torch.randint(len(self._motions), ()))]
        return tuple(motion.images(images) for images in batch)


class SpreadTask(RefinerTask):
    """CRPS of normal distributions about the guess, with the deviation that the network gives.

    Source: Gneiting et al., Mon. Weather Rev. 133(5), 2005 (its minimum as an estimate).
    """

    def loss(self, batch: Data) -> Tensor:
        """Return the loss () of a batch."""
        inputs, truth = self.moved(batch)
        with working_precision(inputs.device.type):
            deviation = self.network(inputs)
        error = truth - inputs[:, 0]
        z = error / deviation
        density = torch.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
        crps = error * torch.erf(z / math.sqrt(2))
        crps += deviation * (2 * density - 1 / math.sqrt(math.pi))
        return crps.mean()


def train_refiner(method_class: type[RefinementMethod], job: TrainingJob) -> TrainingResult:
    """Train the network of a method; see `eitbench.methods.training.train`."""
    scenario, sensor, count = job.scenario, job.sensor, job.training_count(more=True)
    problem = nominal_problem(scenario)
    method = method_class()
    method.start(problem)
    gain_power = job.request.gain_power
    method.check_gain_power(gain_power)
    job.check(
        limit=count, begun_from=method.begun_from, loss=job.request.loss, gain_power=gain_power
    )
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        network = method.network(problem)
    motions = symmetries(sensor, torch.from_numpy(problem.jacobian))
    task = method.task(nn.Sequential(network), motions, job.request.loss)
    inputs, truth = _samples(method_class, job, method.begun_from, "train", count)
    validation = _samples(method_class, job, method.begun_from, "validation", scenario.validation)
    scale = inputs.std((0, 2, 3))
    network.scale.copy_(scale.clamp(min=1e-6 * float(scale.max())))
    return job.fit(
        task,
        (inputs, truth),
        validation,
        method.baseline,
        {
            "begun_from": method.begun_from,
            "gain_power": repr(gain_power),
            "train_samples": str(count),
        },
    )


def _samples(
    method: type[RefinementMethod], job: TrainingJob, begun_from: str, split: Split, count: int
) -> tuple[Tensor, Tensor]:
    """The network's inputs (n, C, H, W), and conductivity over background (n, H, W)."""
    request, scenario, device = job.request, job.scenario, job.device.type
    if split == "train":  # there may be more than the scenario declares
        scenario = scenario.model_copy(update={"train": count})
    data = load(scenario, split, count, jobs=request.jobs, progress=request.progress)
    difference = nominal_problem(scenario).differences(data, request.gain_power)
    inputs = worker_pool(request.jobs)(
        joblib.delayed(_inputs)(
            method, scenario, device, begun_from, difference[first : first + TOGETHER]
        )
        for first in range(0, count, TOGETHER)
    )
    truth = images(scenario, split, count) / data.sensor.background
    return torch.from_numpy(np.concatenate(inputs)), truth


@lru_cache(maxsize=1)
def _started(
    method_class: type[RefinementMethod],
    scenario: SimulatedScenario,
    device: str,
    begun_from: str,
) -> RefinementMethod:
    """A method that is ready for differences on the scenario's sensor.

    It is kept as long as the weights that it begins with, `begun_from`, are the same.
    """
    del begun_from
    method = method_class()
    method.start(nominal_problem(scenario), device)
    return method


def _inputs(
    method: type[RefinementMethod],
    scenario: SimulatedScenario,
    device: str,
    begun_from: str,
    difference: Array,
) -> Images:
    """The network's inputs of some samples; runs in a worker process, on one thread."""
    with threadpool_limits(1):
        return _started(method, scenario, device, begun_from).inputs(difference)
