"""Training of the surrogate operator on a simulated scenario's clean voltages."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench import __version__
from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.operators.surrogate import SurrogateNetwork
from eitbench.methods.operators.surrogate_weights import (
    NETWORK_VERSION,
    file_name,
    save_weights,
    sensor_key,
    user_weights,
)
from eitbench.methods.training.loop import Data, Recipe, Trainee, begun_in, fit
from eitbench.methods.training.symmetry import symmetries
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.scenario import SimulatedScenario
from eitbench.scenarios.simulation import clean_voltages, phantom
from eitbench.scenarios.suites import Suite, load_suite

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eitbench.methods.training.curve import Trained
    from eitbench.methods.training.symmetry import Symmetry
    from eitbench.scenarios.scenario import Split

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


class SurrogateTrainee(Trainee):
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
        progress: show on stderr how far it is.

    Raises:
        InputError: a suite without training samples or with several sensors; `out` holds a training
            with other settings.
        DataCorruptError: what `out` holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        EitbenchError: a folder is not writable or full.
    """
    scenario = _trained_on(load_suite(suite))
    sensor = scenario.nominal_sensor
    folder = out or cache_dir() / "training" / f"surrogate-{sensor.name}-{sensor_key(sensor)[:12]}"
    recipe = Recipe(epochs=EPOCHS if epochs is None else epochs, seed=seed, batch=BATCH, rate=RATE)
    settings = {
        "name": "surrogate",
        "network_version": NETWORK_VERSION,
        "sensor_key": sensor_key(sensor),
        "scenario": scenario.name,
        "train_data": scenario.data_hash("train"),
        "validation_data": scenario.data_hash("validation"),
    }
    begun_in(folder, recipe, settings)  # before minutes are spent on data
    sigma, voltages = _samples(scenario, "train", jobs, progress)
    seen_sigma, seen_voltages = _samples(scenario, "validation", jobs, progress)

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
        progress=progress,
    )
    error = (linear.tensor_voltages(seen_sigma.double()) - seen_voltages) / std
    jacobian_mse = float(error.square().mean())
    about = {
        "command": f"eitbench train surrogate --suite {suite} --epochs {recipe.epochs} "
        f"--seed {seed}",
        "seed": str(seed),
        "epochs": str(recipe.epochs),
        "scenario": scenario.name,
        "train_data": settings["train_data"],
        "validation_data": settings["validation_data"],
        "best_epoch": str(trained.best.epoch),
        "validation_mse": repr(trained.best.validation),
        "jacobian_validation_mse": repr(jacobian_mse),
        "train_s": f"{trained.seconds:.1f}",
        "device": trained.device,
        "eitbench": __version__,
        "torch": torch.__version__,
    }
    weights = folder / file_name(sensor)
    save_weights(weights, sensor, trained.weights, about)
    _write_curve(weights.with_suffix(".json"), about, trained)
    return SurrogateTraining(_put_in_use(weights), trained.best.validation, jacobian_mse)


def _trained_on(suite: Suite) -> SimulatedScenario:
    simulated = [
        scenario
        for scenario in suite.scenarios
        if isinstance(scenario, SimulatedScenario) and scenario.train and scenario.validation
    ]
    if not simulated:
        raise InputError(
            f"Suite {suite.name!r} has no simulated scenario with training and validation samples."
        )
    others = {sensor_key(s.nominal_sensor): s.nominal_sensor.name for s in simulated}
    if len(others) > 1:
        raise InputError(
            f"Suite {suite.name!r} simulates {len(others)} sensors ({', '.join(others.values())}): "
            "the surrogate is trained for one, so use a suite for each."
        )
    return simulated[0]


def _samples(
    scenario: SimulatedScenario, split: Split, jobs: int, progress: bool
) -> tuple[Tensor, Tensor]:
    """Conductivities (n, H, W) [S/m] in float32 and clean voltages (n, M) [V/A] in float64."""
    count, sensor = scenario.size(split), scenario.nominal_sensor
    voltages = clean_voltages(scenario, split, count, jobs=jobs, progress=progress)
    images = np.empty((count, *sensor.image_shape), dtype=np.float32)
    for sample, image in enumerate(images):
        image[:] = rasterise(phantom(scenario, split, sample), sensor)
    images[:, ~sensor.mask] = sensor.background
    return torch.from_numpy(images), torch.from_numpy(voltages)


def _write_curve(path: Path, about: dict[str, str], trained: Trained) -> None:
    curve = [asdict(epoch) for epoch in trained.curve]
    path.write_text(json.dumps({**about, "curve": curve}, indent=1) + "\n")


def _put_in_use(weights: Path) -> Path:
    """Copy weights and learning curve to where the operator looks for the user's own."""
    used = user_weights() / weights.name
    used.parent.mkdir(parents=True, exist_ok=True)
    for source, target in (
        (weights.with_suffix(".json"), used.with_suffix(".json")),
        (weights, used),
    ):
        partial = target.with_name(f".{target.name}.partial")
        shutil.copyfile(source, partial)
        partial.replace(target)
    return used
