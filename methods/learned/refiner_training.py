"""Training of the networks that refine images, one after the other."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import joblib
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from eitbench.methods.problem import Problem
from eitbench.methods.training.augmentation import symmetries
from eitbench.methods.training.samples import images, no_split
from eitbench.methods.training.task import Data, OneLossTask, working_precision
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import clean_reference

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.learned.refined import RefinementMethod
    from eitbench.methods.networks.refiner import Refiner
    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.curve import Epoch
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.methods.training.request import TrainingRequest
    from eitbench.scenarios.suites.scenario import SimulatedScenario


TOGETHER = 100
"""Samples that a process works on before it hands them over."""


class RefinerTask(OneLossTask):
    """Mean squared error of conductivity over background, of refined images.

    A batch holds the network's inputs (n, C, H, W) and the truth (n, H, W). In training, each batch
    is seen under a random symmetry of the sensor. Noise is that of the training split, not drawn
    anew: to work the inputs out again takes too long.
    """

    network: Refiner

    def __init__(self, network: Refiner, motions: Sequence[Symmetry]) -> None:
        super().__init__(network)
        self._motions = motions

    def loss(self, batch: Data) -> Tensor:
        """Return the mean squared error () of a batch."""
        inputs, truth = batch
        if self.training:
            motion = self._motions[int(torch.randint(len(self._motions), ()))]
            inputs, truth = motion.images(inputs), motion.images(truth)
        with working_precision(inputs.device.type):
            refined = self.network(inputs)
        error: Tensor = refined - truth
        return error.square().mean()


def train_refiners(method_class: type[RefinementMethod], job: TrainingJob) -> TrainingResult:
    """Train the networks of a method, step by step; see `eitbench.methods.training.train`."""
    request, scenario, sensor = job.request, job.scenario, job.sensor
    count = job.training_count()
    problem = Problem(sensor, clean_reference(scenario, "train"), no_split)
    method = method_class()
    method.start(problem)
    settings = {"limit": count, "begun_from": method.begun_from()}
    for step in range(method.steps):
        job.check(settings, f"step-{step + 1}")

    splits = {
        "train": _Split(method_class, scenario, "train", count, request),
        "validation": _Split(method_class, scenario, "validation", scenario.validation, request),
    }
    motions = symmetries(sensor, torch.from_numpy(problem.jacobian))
    weights: dict[str, Tensor] = {}
    curve: list[Epoch] = []
    for split in splits.values():
        split.guesses = split.parallel("first_guesses", split.difference)
    first_mse = splits["validation"].mse()
    for step in range(method.steps):
        inputs = {
            name: torch.from_numpy(split.parallel("inputs", split.difference, split.guesses))
            for name, split in splits.items()
        }
        with torch.random.fork_rng():
            torch.manual_seed(job.recipe.seed + step)
            network = method.network(problem)
        scale = inputs["train"].std((0, 2, 3))
        network.scale.copy_(scale.clamp(min=1e-6 * float(scale.max())))
        fitted = job.fit(
            RefinerTask(network, motions),
            (inputs["train"], splits["train"].truth),
            (inputs["validation"], splits["validation"].truth),
            settings,
            step=f"step-{step + 1}",
        )
        network.load_state_dict(fitted.weights)
        for name, split in splits.items():
            split.guesses = _refined(network, inputs[name], job.recipe.batch)
        weights |= {f"{step}.{name}": tensor for name, tensor in fitted.weights.items()}
        curve += fitted.curve
    metadata = {
        "begun_from": method.begun_from(),
        "train_samples": str(count),
        "first_validation_mse": repr(first_mse),
    }
    return job.finish(
        fitted, metadata, "the image that it refines", first_mse, weights=weights, curve=curve
    )


class _Split:
    """Samples as measured, and how far they have been refined.

    Attributes:
        difference: (n, M) [V/A].
        truth: conductivity over background (n, H, W).
        guesses: the present images (n, H, W).
    """

    guesses: Images

    def __init__(
        self,
        method: type[RefinementMethod],
        scenario: SimulatedScenario,
        name: str,
        count: int,
        request: TrainingRequest,
    ) -> None:
        data = load(scenario, name, count, jobs=request.jobs, progress=request.progress)
        self.reference, self.jobs = data.reference, request.jobs
        self.method, self.scenario = method, scenario
        problem = Problem(data.sensor, data.reference, no_split)
        self.difference = problem.difference(data.voltages)
        self.truth = images(scenario, data.split, count) / data.sensor.background

    def mse(self) -> float:
        """Return the mean squared error of the present images."""
        return float((torch.from_numpy(self.guesses) - self.truth).square().mean())

    def parallel(
        self, function: Literal["first_guesses", "inputs"], *arguments: Array | Images
    ) -> Images:
        """Return the method's `function` of all samples, worked out by `jobs` processes."""
        tasks = (
            joblib.delayed(_part)(
                self.method,
                self.scenario,
                self.reference,
                function,
                *(values[first : first + TOGETHER] for values in arguments),
            )
            for first in range(0, len(self.difference), TOGETHER)
        )
        return np.concatenate(joblib.Parallel(n_jobs=self.jobs)(tasks))


def _refined(network: Refiner, inputs: Tensor, batch: int) -> Images:
    """Return the network's images (n, H, W), as it will make them in use."""
    network.eval()
    with torch.inference_mode():
        return torch.cat([network(part) for part in torch.split(inputs, batch)]).numpy()


@lru_cache(maxsize=1)
def _started(
    method_class: type[RefinementMethod], scenario: SimulatedScenario, reference: bytes
) -> RefinementMethod:
    """Return a method that is ready for a scenario whose reference frame is `reference`."""
    method = method_class()
    method.start(Problem(scenario.nominal_sensor, np.frombuffer(reference), no_split))
    return method


def _part(
    method_class: type[RefinementMethod],
    scenario: SimulatedScenario,
    reference: Array,
    function: str,
    *arguments: Array | Images,
) -> Images:
    """Return the method's `function` of some samples; runs in a worker process, on one thread."""
    with threadpool_limits(1):
        method = _started(method_class, scenario, reference.tobytes())
        answer: Images = getattr(method, function)(*arguments)
        return answer
