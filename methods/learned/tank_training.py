"""Training of the U-Net for the Kuopio tank on simulated objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench.methods.learned.tank_unet import CHANNELS, LinearImages, image_map
from eitbench.methods.networks.class_network import ClassNetwork
from eitbench.methods.problem import Problem, no_split
from eitbench.methods.training.loop import Data, TrainingTask, working_precision
from eitbench.methods.training.samples import images
from eitbench.methods.weights.weight_files import sensor_key
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.public.kuopio import LEVELS, tank

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.arrays import Array
    from eitbench.scenarios.sensors.patterns import DrivePattern

STRENGTH = (0.3, 0.15)
"""Mean and standard deviation of the logarithm of what the real tank changes over the model. In
the four training phantoms of the challenge it is 1.1 to 1.5, with the gain of the reference."""
GAIN = 0.04
"""Standard deviation of the gain of a drive, and of a measuring pair."""
DRIFT = 0.04
"""Standard deviation of the common factor of a frame; it was -0.08 to 0.01."""
UNLIKE = 0.03
"""Part of that factor that is not common."""
FLOOR = 7e-4
"""Standard deviation of a value's noise [V/A]."""
SEEN_LEVELS = (1, 4, 7)
"""Levels whose losses choose the best epoch."""


class Board:
    """What the real tank and its board may do to a clean difference, drawn anew each time."""

    def __init__(self, pattern: DrivePattern, untouched: Array) -> None:
        self._untouched = torch.from_numpy(untouched).float()
        self._drive, self._sense = (
            torch.from_numpy(np.unique(pattern.table[:, pair], axis=0, return_inverse=True)[1])
            for pair in (slice(0, 2), slice(2, 4))
        )

    def __call__(self, difference: Tensor) -> Tensor:
        """Measured differences (n, M) [V/A] but for their common factor, from clean ones."""
        n = len(difference)
        mean, deviation = STRENGTH
        factor = torch.exp(mean + deviation * torch.randn(n, 1))
        for of in (self._drive, self._sense):
            factor = factor * (1 + GAIN * torch.randn(n, int(of.max()) + 1)[:, of])
        drift = DRIFT * UNLIKE * torch.randn(n, 1) * torch.randn_like(difference)
        noise = FLOOR * torch.rand(n, 1) * 2 * torch.randn_like(difference)
        return factor * difference + drift * self._untouched + noise


class TankTask(TrainingTask):
    """Mean squared error of the expected class; each batch is of a level drawn at random."""

    network: ClassNetwork

    def __init__(
        self,
        network: ClassNetwork,
        board: Board,
        levels: Sequence[tuple[Tensor, Callable[[Tensor], Tensor]]],
    ) -> None:
        """`levels` hold the numbers of their measurements, and the images of these."""
        super().__init__(network)
        self._board, self._levels = board, levels

    def loss(self, batch: Data) -> Tensor:
        """See `TrainingTask`."""
        return self._loss(batch, int(torch.randint(len(self._levels), ())))

    def losses(self, batch: Data) -> dict[str, Tensor]:
        """See `TrainingTask`; the same noise in every epoch."""
        with torch.random.fork_rng():
            torch.manual_seed(0)
            each = {f"level_{level}": self._loss(batch, level - 1) for level in SEEN_LEVELS}
        return {"": torch.stack([*each.values()]).mean(), **each}

    def _loss(self, batch: Data, index: int) -> Tensor:
        difference, truth = batch
        kept, inputs = self._levels[index]
        # Random numbers and images are made on the CPU, so that they are the same everywhere.
        shown = inputs(self._board(difference.cpu())[:, kept]).to(truth.device)
        with working_precision(truth.device.type):
            found = self.network(shown)
        error: Tensor = found - truth
        return error.square().mean()


def train_tank_unet(job: TrainingJob) -> TrainingResult:
    """Train the network; see `eitbench.methods.training.train`."""
    scenario, sensor, count = job.scenario, job.sensor, job.training_count()
    if sensor_key(sensor) != sensor_key(tank()):
        raise InputError(
            f"'tank-unet' is for the tank of the Kuopio challenge, and {scenario.name!r} is of the "
            f"sensor {sensor.name!r}: name a suite that simulates the tank, such as `--suite tank`."
        )
    job.check(limit=count)
    model = forward_model(sensor)
    untouched = model.voltages(model.background)
    problem = Problem(sensor, untouched, no_split)
    jacobian, mask = problem.jacobian[:, problem.mask], problem.mask
    with torch.random.fork_rng():
        torch.manual_seed(job.recipe.seed)
        network = ClassNetwork(mask, CHANNELS)
    levels = []
    rows = {tuple(row): k for k, row in enumerate(sensor.pattern.table.tolist())}
    for level in range(1, LEVELS + 1):
        kept = np.array([rows[tuple(row)] for row in tank(level).pattern.table.tolist()])
        linear = LinearImages(jacobian[kept], untouched[kept], mask)
        levels.append((torch.from_numpy(kept), image_map(linear, mask)))

    sigma, clean = job.clean_samples("train", count)
    train = _tensors(clean.numpy() - untouched, sigma)
    seen = load(scenario, "validation", jobs=job.request.jobs, progress=job.request.progress)
    seen_sigma = images(scenario, "validation", scenario.validation)
    validation = _tensors(problem.differences(seen), seen_sigma)
    scale = levels[0][1](train[0][:512]).std((0, 2, 3))
    network.scale.copy_(scale.clamp(min=1e-6 * float(scale.max())))
    return job.fit(
        TankTask(network, Board(sensor.pattern, untouched), levels),
        train,
        validation,
        "an image without objects",
        {"train_samples": str(count)},
    )


def _tensors(difference: Array, sigma: Tensor) -> Data:
    """Differences (n, M) [V/A] and classes (n, H, W)."""
    return torch.from_numpy(difference).float(), torch.sign(torch.log(sigma)).to(torch.int8)
