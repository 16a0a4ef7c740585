"""Training of the networks from voltages to images, with and without a physical loss."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from eitbench.methods.learned.linear_maps import Ridge, ridge
from eitbench.methods.registry import operator, operators
from eitbench.methods.training.augmentation import Augmentation, noise_estimates, symmetries
from eitbench.methods.training.loop import Data, TrainingTask, working_precision
from eitbench.methods.training.losses import image_loss
from eitbench.methods.training.samples import images, nominal_problem
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eitbench.methods.learned.image_networks import ImageNetworkMethod
    from eitbench.methods.networks.image_network import ImageNetwork
    from eitbench.methods.operator import Operator
    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.arrays import Array
    from eitbench.scenarios.data.datasets import Dataset

DATA_ALONE = 0.3
"""Share of the epochs at the beginning in which only the data loss is minimised."""

PHYSICAL_SHARE = 0.25
"""Share of each batch that the physical loss is taken over. The mean over a part of a shuffled
batch has the same expectation; over all of it, physics would cost as much time as the network."""


class ImageTask(TrainingTask):
    """alpha * data loss + beta * physical loss, with alpha = 1 or 0; the data loss alone without
    an operator.

    A batch for training holds differences (n, M) [V/A], rms of the frames (n,) [V/A], relative
    images (n, H, W) and the numbers of the estimates (n,) that noise goes through. The data loss is
    one of `LOSSES` of sigma_p - sigma, both relative to the background; for the other see
    `PhysicalLoss`. It is minimised over `PHYSICAL_SHARE` of each batch after the first `DATA_ALONE`
    of the epochs, and always shown, for the validation split and for as many training samples.

    With alpha = 0 the physical loss of whole batches is minimised from the first epoch on, and
    chooses the best one: no true image has a part in it.
    """

    network: ImageNetwork

    def __init__(
        self,
        network: ImageNetwork,
        augmentation: Augmentation,
        loss: str,
        physical: PhysicalLoss | None,
        alpha: float,
        beta: float,
        epochs: int,
    ) -> None:
        super().__init__(network)
        self.data_loss = image_loss(loss)
        self.augmentation = augmentation
        self.physical = physical
        self._alpha, self._beta = alpha, beta
        self._alone = round(DATA_ALONE * epochs)

    def objective(self, batch: Data, epochs_done: int) -> tuple[Tensor, Tensor]:
        """Return what is minimised on an augmented batch, and what is shown of it."""
        difference, truth, motion = self.augmentation(*batch)
        relative = self.images(difference)
        if self._alpha == 0:
            assert self.physical is not None
            if not relative.isfinite().all():  # such images have no voltages
                return relative.sum(), relative.sum()
            alone: Tensor = self.physical(relative, difference, motion)
            return alone, alone
        data = self.data_loss(relative - truth)
        # Images that are not finite have no voltages; the data loss tells of them.
        silent = self._beta == 0 or epochs_done < self._alone or not data.isfinite()
        if self.physical is None or silent:
            return data, data
        part = slice(math.ceil(PHYSICAL_SHARE * len(truth)))
        physical: Tensor = self.physical(relative[part], difference[part], motion)
        return data + self._beta * physical, data

    def losses(self, batch: Data) -> dict[str, Tensor]:
        """See `TrainingTask`; the data loss and the physical loss. The first is minimised."""
        difference, _, truth = batch
        relative = self.images(difference)
        data = self.data_loss(relative - truth)
        if self.physical is None:
            return {"": data}
        physical = self.physical(relative, difference, None) if data.isfinite() else data
        if self._alpha == 0:
            return {"": physical, "data": data}
        return {"": data, "physical": physical}

    def network_of(self, metadata: Mapping[str, str]) -> ImageNetwork:
        """See `TrainingTask`."""
        return type(self.network)(self.network.sensor, metadata["backbone"])

    def optimizer(self) -> torch.optim.Optimizer:
        """See `TrainingTask`; all weights in one pass."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4, fused=True)

    def images(self, difference: Tensor) -> Tensor:
        """Return the network's images in float32, computed in bfloat16 where that is faster."""
        with working_precision(difference.device.type):
            relative: Tensor = self.network(difference)
        return relative


def train_image_network(method: type[ImageNetworkMethod], job: TrainingJob) -> TrainingResult:
    """Train the network of `method`; see `eitbench.methods.training.train`."""
    request, scenario, sensor = job.request, job.scenario, job.sensor
    beta = method.beta if request.beta is None else request.beta
    if not method.beta and beta:
        raise InputError(
            f"{method.files.name!r} has no physical loss: train 'phydnn' to choose its beta."
        )
    if not 0 <= beta < float("inf"):
        raise InputError(f"The weight beta of the physical loss is at least 0, got {beta}.")
    if request.alpha not in (0, 1) or (request.alpha == 0 and not beta):
        raise InputError(
            f"The weight alpha of the data loss is 1, or 0 with a physical loss; got "
            f"{request.alpha} for {method.files.name!r}."
        )
    job.check_gains()
    count = job.training_count(more=True)
    if request.unlimited:
        job.check_nominal("makes new touches of the nominal sensor in every epoch")
    # Without a physical loss to minimise, it is shown for an operator that is asked for.
    name = request.operator or ("surrogate" if beta else None)
    known = operators().get(name or "")  # `operator` below refuses an unknown one
    backbone = request.backbone or method.backbone
    job.check(
        backbone=backbone,
        loss=request.loss,
        operator=name,
        operator_weights=known.weights_hash(sensor) if known else "",
        alpha=request.alpha,
        beta=beta,
        limit=count,
        unlimited=request.unlimited,
        gain_power=request.gain_power,
    )
    image_loss(request.loss)
    forward = None if name is None else operator(name, sensor)
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        network = method.network(sensor, backbone)
    job.begin(network)

    seen = load(scenario, "validation", jobs=request.jobs, progress=request.progress)
    problem = nominal_problem(scenario)
    untouched = problem.reference

    def differences(data: Dataset) -> Array:
        return problem.differences(data, request.gain_power)

    def simulated(epoch: int) -> Data:
        fresh, voltages = job.fresh_samples(epoch, count)
        found = _tensors(voltages.numpy(), problem.difference(voltages), fresh / sensor.background)
        return *found, torch.zeros(count, dtype=torch.int64)

    estimates = None
    if scenario.training_imperfections is None and count > scenario.train:
        train = simulated(0)
    else:
        clean = job.noiseless(count)
        sigma = images(scenario, "train", count) / sensor.background
        units, estimates = noise_estimates(problem, clean.references, request.gain_power)
        train = (*_tensors(clean.voltages, differences(clean), sigma), units)
    seen_sigma = images(scenario, "validation", scenario.validation) / sensor.background
    validation = _tensors(seen.voltages, differences(seen), seen_sigma)
    std = train[0].std(0)
    physical = None
    compared = None
    if forward is not None:
        # As measured; those to train on get their noise by augmentation.
        measured = load(scenario, "train", min(count, scenario.train, scenario.validation))
        voltages = measured.voltages
        compared = _tensors(voltages, differences(measured), train[2][: len(measured)])
        spread = std.clamp(min=1e-6 * std.max())
        physical = PhysicalLoss(forward, torch.from_numpy(untouched).float(), spread)
    baseline = "the best linear map"
    if job.begun is None:
        _standardise(network, train)
        if request.alpha:
            declared = tuple(tensor[: scenario.train] for tensor in train)
            matrix = torch.from_numpy(_best_linear_map(network, declared, validation).matrix)
        else:
            matrix = torch.zeros_like(network.backbone.linear.weight.T)
            baseline = "an image of the untouched sensor, by the physical loss"
        network.backbone.start_from(matrix)
    motions = symmetries(sensor, torch.from_numpy(problem.jacobian))
    rms = float(np.sqrt(np.mean(untouched**2)))
    augmentation = Augmentation(scenario.split_noise("train"), motions, rms, estimates)

    return job.fit(
        ImageTask(
            network,
            augmentation,
            request.loss,
            physical,
            request.alpha,
            beta,
            job.recipe.epochs,
        ),
        train,
        validation,
        baseline,
        {
            "backbone": backbone,
            "loss": request.loss,
            "operator": name or "",
            "alpha": repr(request.alpha),
            "beta": repr(beta),
            "gain_power": repr(request.gain_power),
            "train_samples": str(count),
        },
        compared=compared,
        renewed=simulated if request.unlimited else None,
    )


def _standardise(network: ImageNetwork, train: Data) -> None:
    """Take the spread (K,) [V/A] of the network's inputs from the training differences."""
    std = (train[0] @ network.averaging).std(0)
    network.std.copy_(std.clamp(min=1e-6 * std.max()))  # a measurement that never changes


def _best_linear_map(network: ImageNetwork, train: Data, validation: Data) -> Ridge:
    """Return the map from standardised inputs (n, K) to contrasts (n, H * W), as `ridge` does."""
    inputs = [network.inputs(data[0]).double().numpy() for data in (train, validation)]
    contrasts = [data[2].flatten(1).numpy() - 1 for data in (train, validation)]
    return ridge(inputs[0], contrasts[0], inputs[1], contrasts[1])


def _tensors(voltages: Array, difference: Array, relative: Tensor) -> Data:
    """Differences (n, M), rms of the frames (n,), and the images (n, H, W) that belong to them."""
    rms = np.sqrt(np.mean(voltages**2, axis=1))
    return torch.from_numpy(difference).float(), torch.from_numpy(rms).float(), relative


class PhysicalLoss(nn.Module):
    """Mean over frames and measurements of ((F(sigma_p) - V) / s)^2.

    F is a forward operator, V the frame that the network saw, in model units, and s (M,) the
    standard deviation of each measurement over the training frames. (Whether the published loss
    divides by it is not stated.) sigma_p is kept within the sensor's range of conductivity, for
    outside it F need not exist; there its gradient is 0.
    """

    reference: Tensor
    std: Tensor

    def __init__(self, operator: Operator, reference: Tensor, std: Tensor) -> None:
        """`reference` frame (M,) and `std` (M,) are in model units [V/A]."""
        super().__init__()
        self.operator = operator
        sensor = operator.sensor
        self.background, self.range = sensor.background, sensor.conductivity_range
        self.register_buffer("reference", reference, persistent=False)
        self.register_buffer("std", std, persistent=False)

    def forward(self, relative: Tensor, difference: Tensor, motion: Symmetry | None) -> Tensor:
        """Loss () of images `relative` to the background (n, H, W).

        `difference` (n, M) [V/A] is what the network saw, moved by `motion` if that is given.
        """
        sigma = relative.clamp(*self.range) * self.background
        reference = self.reference if motion is None else motion.voltages(self.reference)
        with torch.autocast(sigma.device.type, enabled=False):
            error = (self.operator.voltages(sigma) - reference - difference) / self.std
        return error.square().mean()
