"""Training of the networks that refine images, one after the other."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Literal

import joblib
import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from torch import Tensor

from eitbench.methods.learned.refined import CoarseToFine, LearnedGaussNewton
from eitbench.methods.problem import Problem
from eitbench.methods.training.job import (
    Training,
    data_settings,
    finish,
    images,
    no_split,
    training_count,
    training_folder,
    training_scenario,
)
from eitbench.methods.training.loop import begun_in, fit
from eitbench.methods.training.precision import working_precision
from eitbench.methods.training.recipe import Recipe
from eitbench.methods.training.symmetry import symmetries
from eitbench.methods.training.trainee import Data, OneLoss
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import clean_reference
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.learned.refined import Refined
    from eitbench.methods.networks.refiner import Refiner
    from eitbench.methods.training.curve import Epoch
    from eitbench.methods.training.request import Request
    from eitbench.methods.training.symmetry import Symmetry
    from eitbench.scenarios.suites.scenario import SimulatedScenario

Array = NDArray[np.float64]
Images = NDArray[np.float32]

METHODS: dict[str, type[Refined]] = {
    "coarse-to-fine": CoarseToFine,
    "learned-gn": LearnedGaussNewton,
}
EPOCHS = 30
BATCH = 64
RATE = 1e-3
PATIENCE = 15
MINIMUM = 2 * BATCH

TOGETHER = 100
"""Samples that a process works on before it hands them over."""


class RefinerTrainee(OneLoss):
    """Mean squared error of conductivity over background, of refined images.

    A batch holds what the network is given (n, C, H, W) and the truth (n, H, W). While it trains,
    each batch is seen under a random symmetry of the sensor. Noise is that of the training split,
    not drawn anew: what physics says of it takes too long.
    """

    network: Refiner

    def __init__(self, network: Refiner, motions: Sequence[Symmetry]) -> None:
        super().__init__(network)
        self._motions = motions

    def loss(self, batch: Data) -> Tensor:
        """Mean squared error () of one batch."""
        given, truth = batch
        if self.training:
            motion = self._motions[int(torch.randint(len(self._motions), ()))]
            given, truth = motion.images(given), motion.images(truth)
        with working_precision(given.device.type):
            found = self.network(given)
        error: Tensor = found - truth
        return error.square().mean()


def train_refined(request: Request) -> Training:
    """Train the networks of `coarse-to-fine` or `learned-gn`, step by step; see `train`."""
    request.refuse("operator", "beta", "backbone")
    files = METHODS[request.name].files
    scenario = training_scenario(load_suite(request.suite))
    sensor = scenario.nominal_sensor
    folder = training_folder(files, sensor, request.out)
    recipe = Recipe(request.epochs or EPOCHS, request.seed, BATCH, RATE, PATIENCE)
    count = training_count(request, scenario, MINIMUM)
    problem = Problem(sensor, clean_reference(scenario, "train"), no_split)
    method = METHODS[request.name]()
    method.start(problem)
    settings = data_settings(files, scenario) | {"limit": count, "begun_from": method.begun_from()}
    for step in range(method.steps):
        begun_in(folder / f"step-{step + 1}", recipe, settings)  # before minutes are spent on data

    splits = {
        "train": _Split(scenario, "train", count, request),
        "validation": _Split(scenario, "validation", scenario.validation, request),
    }
    motions = symmetries(sensor, torch.from_numpy(problem.jacobian))
    weights: dict[str, Tensor] = {}
    curve: list[Epoch] = []
    for split in splits.values():
        split.guesses = _parallel("first", split, request)
    first_mse = splits["validation"].mse()
    for step in range(method.steps):
        given = {
            name: torch.from_numpy(_parallel("images", split, request))
            for name, split in splits.items()
        }
        with torch.random.fork_rng():
            torch.manual_seed(request.seed + step)
            network = method.network(problem)
        scale = given["train"].std((0, 2, 3))
        network.scale.copy_(scale.clamp(min=1e-6 * float(scale.max())))
        trained = fit(
            RefinerTrainee(network, motions),
            recipe,
            (given["train"], splits["train"].truth),
            (given["validation"], splits["validation"].truth),
            folder / f"step-{step + 1}",
            settings,
            devices=request.devices,
            progress=request.progress,
        )
        network.load_state_dict(trained.weights)
        for name, split in splits.items():
            split.guesses = _refined(network, given[name])
        weights |= {f"{step}.{name}": tensor for name, tensor in trained.weights.items()}
        curve += trained.curve
    about = {
        "command": request.command(recipe.epochs),
        "begun_from": method.begun_from(),
        "train_samples": str(count),
        **trained.about(),
        "first_validation_mse": repr(first_mse),
    }
    path = finish(request, files, scenario, weights, curve, about)
    return Training(
        request.name,
        path,
        request.use,
        trained.best.validation,
        "the image that it refines",
        first_mse,
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
        self, scenario: SimulatedScenario, name: str, count: int, request: Request
    ) -> None:
        data = load(scenario, name, count, jobs=request.jobs, progress=request.progress)
        self.scenario, self.reference = scenario, data.reference
        problem = Problem(data.sensor, data.reference, no_split)
        self.difference = problem.difference(data.voltages)
        self.truth = images(scenario, data.split, count) / data.sensor.background

    def mse(self) -> float:
        """Mean squared error of the present images."""
        return float((torch.from_numpy(self.guesses) - self.truth).square().mean())


def _refined(network: Refiner, given: Tensor) -> Images:
    """The network's images (n, H, W), as it will make them in use."""
    network.eval()
    with torch.inference_mode():
        return torch.cat([network(part) for part in torch.split(given, BATCH)]).numpy()


def _parallel(what: Literal["first", "images"], split: _Split, request: Request) -> Images:
    """The method's `first` or `images` for a split, worked out by `request.jobs` processes."""
    count = len(split.difference)
    arguments = [split.difference] + ([split.guesses] if what == "images" else [])
    tasks = (
        joblib.delayed(_part)(
            request.name, split.scenario, split.reference, what, *(a[part] for a in arguments)
        )
        for part in (slice(k, k + TOGETHER) for k in range(0, count, TOGETHER))
    )
    return np.concatenate(joblib.Parallel(n_jobs=request.jobs)(tasks))


@lru_cache(maxsize=1)
def _method(name: str, scenario: SimulatedScenario, reference: bytes) -> Refined:
    """The method `name`, ready for a scenario whose reference frame is `reference`."""
    method = METHODS[name]()
    method.start(Problem(scenario.nominal_sensor, np.frombuffer(reference), no_split))
    return method


def _part(
    name: str, scenario: SimulatedScenario, reference: Array, what: str, *arguments: Array | Images
) -> Images:
    """The method's answer for some samples; runs in a worker process, on one thread."""
    with threadpool_limits(1):
        method = _method(name, scenario, reference.tobytes())
        answer: Images = getattr(method, what)(*arguments)
        return answer
