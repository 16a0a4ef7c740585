"""Training of the networks from voltages to images, with and without a physical loss."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench.methods.learned import Dnn, PhyDnn
from eitbench.methods.networks.image_network import ImageNetwork
from eitbench.methods.problem import Problem
from eitbench.methods.registry import operator
from eitbench.methods.ridge import Ridge, ridge
from eitbench.methods.training.augmentation import Augmentation
from eitbench.methods.training.job import (
    clean_samples,
    data_settings,
    images,
    put_in_use,
    save_result,
    training_folder,
    training_scenario,
)
from eitbench.methods.training.loop import begun_in, fit
from eitbench.methods.training.physical import PhysicalLoss
from eitbench.methods.training.recipe import ONE_DEVICE, Devices, Recipe
from eitbench.methods.training.symmetry import symmetries
from eitbench.methods.training.trainee import Data, Trainee
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites import load_suite

if TYPE_CHECKING:
    from pathlib import Path

    from eitbench.methods.learned import Learned
    from eitbench.scenarios.scenario import SimulatedScenario

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

METHODS: dict[str, type[Learned]] = {"dnn": Dnn, "phydnn": PhyDnn}


@dataclass(frozen=True)
class Choices:
    """What may be chosen about a training; the defaults give the weights that are shipped.

    Attributes:
        operator: forward operator of the physical loss.
        beta: weight of the physical loss; by default the method's own.
        backbone: of the network.
        limit: training samples to use; all by default.
    """

    operator: str = "surrogate"
    beta: float | None = None
    backbone: str = "unet"
    limit: int | None = None

    def arguments(self) -> str:
        """What differs from the defaults, as arguments of the command."""
        default = asdict(SHIPPED)
        chosen = asdict(self).items()
        return "".join(f" --{name} {value}" for name, value in chosen if value != default[name])


SHIPPED = Choices()


@dataclass(frozen=True)
class LearnedTraining:
    """A finished training.

    Attributes:
        name: of the method.
        weights: the file of weights.
        in_use: whether the method will use them from now on.
        validation_mse: mean squared error of conductivity over background on the validation split.
        linear_mse: the same of the best linear map.
    """

    name: str
    weights: Path
    in_use: bool
    validation_mse: float
    linear_mse: float

    def sentences(self) -> list[str]:
        """What to tell the user."""
        ratio = self.linear_mse / self.validation_mse
        said = [
            f"Validation MSE of relative conductivity: {self.validation_mse:.3g}; the best linear "
            f"map's is {ratio:.3g} times as large, {self.linear_mse:.3g}.",
            f"Weights: {self.weights}",
        ]
        if self.in_use:
            said.append(
                f"The method {self.name!r} uses them from now on; delete the file to go back."
            )
        return said


def has_bfloat16(device: str) -> bool:
    """Whether a kind of device computes in bfloat16; processors without it take 15 times as long.

    Results of the two precisions differ by rounding, so that one seed makes one result on one
    kind of machine.
    """
    if device == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    able = torch.cpu.get_capabilities()
    return bool(able.get("amx_bf16") or able.get("avx512_bf16"))


class LearnedTrainee(Trainee):
    """alpha * data loss + beta * physical loss, with alpha = 1.

    A batch holds differences (n, M) [V/A], rms of the frames (n,) [V/A] and relative images
    (n, H, W). The data loss is the mean over samples and pixels of (sigma_p - sigma)^2, both
    relative to the background; for the other see `PhysicalLoss`, which is minimised after the
    first `DATA_ALONE` of the epochs, and logged always: on the validation split, and on as many
    training samples.
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
        physical: Tensor = self._physical(relative, difference, motion)
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
        kind = difference.device.type
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=has_bfloat16(kind)):
            found: Tensor = self.network(difference)
        return found


def train_learned(
    name: str,
    suite: str,
    *,
    epochs: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: Path | None = None,
    devices: Devices = ONE_DEVICE,
    choices: Choices = SHIPPED,
    use: bool = True,
    progress: bool = False,
) -> LearnedTraining:
    """Train the network of the method `name`, or continue, and put the weights in use.

    Args:
        suite: name, or path of a suite file, whose first scenario with training and validation
            samples is trained on.
        epochs: how often every training sample is seen.
        seed: of initial weights, order, noise and symmetries.
        jobs: number of processes to simulate with.
        out: where state and results are kept; a folder in the cache by default.
        devices: to train on.
        choices: what else can be chosen.
        use: whether the method is to use the weights from now on.
        progress: show on stderr how far it is.

    Raises:
        InputError: a suite without training samples or with several sensors; too few samples; no
            `out` holds a training with other settings; no weights for the operator.
        DataCorruptError: what `out` holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        DivergedError: a loss is not finite; the last good state is kept.
        EitbenchError: a folder is not writable or full.
    """
    files = METHODS[name].files
    scenario = training_scenario(load_suite(suite))
    sensor = scenario.nominal_sensor
    folder = training_folder(files, sensor, out)
    recipe = Recipe(
        epochs=EPOCHS if epochs is None else epochs,
        seed=seed,
        batch=BATCH,
        rate=RATE,
        patience=PATIENCE,
    )
    beta = BETA[name] if choices.beta is None else choices.beta
    if name == "dnn" and beta:
        raise InputError("'dnn' has no physical loss: train 'phydnn' to choose its beta.")
    if not 0 <= beta < float("inf"):
        raise InputError(f"The weight beta of the physical loss is at least 0, got {beta}.")
    count = _training_count(scenario, choices.limit)
    settings = data_settings(files, scenario) | {
        "backbone": choices.backbone,
        "operator": choices.operator,
        "beta": beta,
        "limit": count,
    }
    begun_in(folder, recipe, settings)  # before minutes are spent on data
    forward = operator(choices.operator, sensor)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = ImageNetwork(sensor, choices.backbone)

    data = _Data(scenario, count, jobs=jobs, progress=progress)
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
        devices=devices,
        progress=progress,
    )
    figures = {
        "command": f"eitbench train {name} --suite {suite} --epochs {recipe.epochs} --seed {seed}"
        + choices.arguments(),
        "backbone": choices.backbone,
        "operator": choices.operator,
        "beta": repr(beta),
        "train_samples": str(count),
        "linear_validation_mse": repr(linear.validation_mse),
    }
    weights = save_result(files, scenario, folder, recipe, trained, figures)
    return LearnedTraining(
        name,
        put_in_use(weights) if use else weights,
        use,
        trained.best.validation,
        linear.validation_mse,
    )


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
        problem = Problem(sensor, validation.reference, _no_split)
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


def _no_split(split: str, limit: int | None) -> Dataset:
    raise RuntimeError(f"Training reads the {split} split itself.")


def _training_count(scenario: SimulatedScenario, limit: int | None) -> int:
    count = scenario.train if limit is None else min(limit, scenario.train)
    if count < MINIMUM:
        raise InputError(
            f"{count} training samples are too few: scenario {scenario.name!r} declares "
            f"{scenario.train}, and training takes at least {MINIMUM}."
        )
    return count
