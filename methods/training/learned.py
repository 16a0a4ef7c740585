"""Training of the networks from voltages to images, with and without a physical loss."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench.methods.learned.image_networks import Dnn, PhyDnn
from eitbench.methods.learned.ridge import Ridge, ridge
from eitbench.methods.networks.image_network import ImageNetwork
from eitbench.methods.problem import Problem
from eitbench.methods.registry import operator
from eitbench.methods.training.augmentation import Augmentation
from eitbench.methods.training.job import (
    Training,
    clean_samples,
    data_settings,
    finish,
    images,
    no_split,
    training_count,
    training_folder,
    training_scenario,
)
from eitbench.methods.training.loop import begun_in, fit
from eitbench.methods.training.physical import PhysicalLoss
from eitbench.methods.training.precision import working_precision
from eitbench.methods.training.recipe import Recipe
from eitbench.methods.training.symmetry import symmetries
from eitbench.methods.training.trainee import Data, Trainee
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from eitbench.methods.learned.image_networks import Learned
    from eitbench.methods.training.request import Request
    from eitbench.scenarios.suites.scenario import SimulatedScenario

EPOCHS = 100
BATCH = 64
RATE = 1e-3
PATIENCE = 25

MINIMUM = 2 * BATCH
"""Training samples for which an epoch is more than a step."""

BETA = {"dnn": 0.0, "phydnn": 0.0029}
"""Weight of the physical loss beside the data loss, as published."""

DATA_ALONE = 0.3
"""Share of the epochs at the beginning in which only the data loss is minimised."""

PHYSICAL_SHARE = 0.25
"""Share of each batch that the physical loss is taken over. The mean over a part of a shuffled
batch has the same expectation; over all of it, physics would cost as much time as the network."""

METHODS: dict[str, type[Learned]] = {"dnn": Dnn, "phydnn": PhyDnn}


class LearnedTrainee(Trainee):
    """alpha * data loss + beta * physical loss, with alpha = 1.

    A batch holds differences (n, M) [V/A], rms of the frames (n,) [V/A] and relative images
    (n, H, W). The data loss is the mean over samples and pixels of (sigma_p - sigma)^2, both
    relative to the background; for the other see `PhysicalLoss`. It is minimised over
    `PHYSICAL_SHARE` of each batch after the first `DATA_ALONE` of the epochs, and logged always, on
    the validation split and on as many training samples.
    """

    network: ImageNetwork

    def __init__(
        self,
        network: ImageNetwork,
        augmentation: Augmentation,
        physical: PhysicalLoss,
        beta: float,
        epochs: int,
    ) -> None:
        super().__init__(network)
        self._augmentation = augmentation
        self._physical = physical
        self._beta = beta
        self._alone = round(DATA_ALONE * epochs)

    def training_step(self, batch: Data, index: int) -> Tensor:
        """What is minimised, on one augmented batch."""
        difference, truth, motion = self._augmentation(*batch)
        relative = self._images(difference)
        data = (relative - truth).square().mean()
        self.log_train(data, len(truth))
        # Images that are not finite have no voltages; the data loss tells of them.
        if self._beta == 0 or self.epochs_done < self._alone or not data.isfinite():
            return data
        part = slice(math.ceil(PHYSICAL_SHARE * len(truth)))
        physical: Tensor = self._physical(relative[part], difference[part], motion)
        return data + self._beta * physical

    def validation_step(self, batch: Data, index: int, dataloader_idx: int = 0) -> None:
        """Log the losses on validation samples, or (1) the physical loss on training samples."""
        difference, _, truth = batch
        relative = self._images(difference)
        data = (relative - truth).square().mean()
        physical = self._physical(relative, difference, None) if data.isfinite() else data
        split = "train" if dataloader_idx else "validation"
        losses = {f"{split}_physical": physical}
        if split == "validation":
            losses[split] = data
        self.log_dict(losses, batch_size=len(truth), add_dataloader_idx=False)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam with decoupled weight decay, all weights in one pass."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4, fused=True)

    def _images(self, difference: Tensor) -> Tensor:
        """The network's images in float32, worked out in bfloat16 where that is faster."""
        with working_precision(difference.device.type):
            found: Tensor = self.network(difference)
        return found


def train_learned(request: Request) -> Training:
    """Train the network of `dnn` or `phydnn`; see `train`."""
    files = METHODS[request.name].files
    scenario = training_scenario(load_suite(request.suite))
    sensor = scenario.nominal_sensor
    folder = training_folder(files, sensor, request.out)
    recipe = Recipe(request.epochs or EPOCHS, request.seed, BATCH, RATE, PATIENCE)
    beta = _beta(request)
    count = training_count(request, scenario, MINIMUM)
    settings = data_settings(files, scenario) | {
        "backbone": request.backbone,
        "operator": request.operator,
        "beta": beta,
        "limit": count,
    }
    begun_in(folder, recipe, settings)  # before minutes are spent on data
    forward = operator(request.operator, sensor)
    with torch.random.fork_rng():
        torch.manual_seed(request.seed)
        network = ImageNetwork(sensor, request.backbone)

    data = _Data(scenario, count, jobs=request.jobs, progress=request.progress)
    physical = PhysicalLoss(forward, data.reference, data.std)
    linear = start(network, data.train, data.validation)
    augmentation = Augmentation(scenario.split_noise("train"), data.motions)
    trained = fit(
        LearnedTrainee(network, augmentation, physical, beta, recipe.epochs),
        recipe,
        data.train,
        data.validation,
        folder,
        settings,
        compared=data.compared,
        devices=request.devices,
        progress=request.progress,
    )
    about = {
        "command": request.command(recipe.epochs),
        "backbone": request.backbone,
        "operator": request.operator,
        "beta": repr(beta),
        "train_samples": str(count),
        **trained.about(),
        "linear_validation_mse": repr(linear.validation_mse),
    }
    path = finish(request, files, scenario, trained.weights, trained.curve, about)
    return Training(
        request.name,
        path,
        request.use,
        trained.best.validation,
        "the best linear map",
        linear.validation_mse,
    )


def _beta(request: Request) -> float:
    """The weight of the physical loss that is asked for, or the method's own."""
    beta = BETA[request.name] if request.beta is None else request.beta
    if request.name == "dnn" and beta:
        raise InputError("'dnn' has no physical loss: train 'phydnn' to choose its beta.")
    if not 0 <= beta < float("inf"):
        raise InputError(f"The weight beta of the physical loss is at least 0, got {beta}.")
    return beta


def start(network: ImageNetwork, train: Data, validation: Data) -> Ridge:
    """Standardise the network's inputs and make it the best linear map, which is returned."""
    raw = train[0] @ network.averaging
    std = raw.std(0)
    network.std.copy_(std.clamp(min=1e-6 * std.max()))  # a measurement that never changes
    inputs = [network.inputs(data[0]).double().numpy() for data in (train, validation)]
    contrasts = [data[2].flatten(1).numpy() - 1 for data in (train, validation)]
    found = ridge(inputs[0], contrasts[0], inputs[1], contrasts[1])
    network.backbone.start_from(torch.from_numpy(found.matrix))
    return found


class _Data:
    """Samples of a scenario: differences (n, M), rms of the frames (n,), relative images (n, H, W).

    Attributes:
        train: without noise, which the augmentation adds.
        validation: as measured.
        compared: as many training samples, as measured.
        reference, std: (M,) the reference frame, and standard deviations over the training frames.
        motions: symmetries of the sensor.
    """

    def __init__(
        self, scenario: SimulatedScenario, count: int, *, jobs: int, progress: bool
    ) -> None:
        sensor = scenario.nominal_sensor
        sigma, clean = clean_samples(scenario, "train", count, jobs=jobs, progress=progress)
        validation = load(scenario, "validation", jobs=jobs, progress=progress)
        compared = load(scenario, "train", min(count, scenario.validation))
        problem = Problem(sensor, validation.reference, no_split)
        sigma /= sensor.background
        self.train = _tensors(problem, clean.numpy(), sigma)
        seen = images(scenario, "validation", scenario.validation) / sensor.background
        self.validation = _tensors(problem, validation.voltages, seen)
        self.compared = _tensors(problem, compared.voltages, sigma[: len(compared)])
        self.reference = torch.from_numpy(problem.reference / problem.gain).float()
        std = self.train[0].std(0)
        self.std = std.clamp(min=1e-6 * std.max())
        self.motions = symmetries(sensor, torch.from_numpy(problem.jacobian))


def _tensors(problem: Problem, voltages: np.ndarray, relative: Tensor) -> Data:
    rms = np.sqrt(np.mean(voltages**2, axis=1)) / problem.gain
    difference = torch.from_numpy(problem.difference(voltages))
    return difference.float(), torch.from_numpy(rms).float(), relative
