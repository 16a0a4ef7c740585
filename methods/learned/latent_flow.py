"""A generative network: images drawn from a learned posterior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.learned.image_networks import TrainedMethod
from eitbench.methods.method import DRAWS
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.sensors.symmetry import motions

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.methods.problem import Problem
    from eitbench.methods.training.job import TrainingJob, TrainingResult

DRAWN = 40
"""Images of a frame, as many of each motion of the sensor, whose mean is the image."""


@register("latent-flow")
@dataclass
class LatentFlowMethod(TrainedMethod):
    """The mean of images drawn from a conditional normalising flow over principal components."""

    source: ClassVar[str] = (
        "Dinh, Sohl-Dickstein and Bengio, ICLR 2017 (real NVP); Ardizzone et al., ICLR 2019 "
        "(inverse problems)"
    )
    files: ClassVar = WeightFiles("latent-flow")
    recipe: ClassVar = Recipe(epochs=60, batch=128)
    options: ClassVar[tuple[str, ...]] = ("limit", "gain_power")

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        from eitbench.methods.learned.latent_flow_training import train_latent_flow

        return train_latent_flow(job)

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`."""
        import torch

        from eitbench.methods.networks.latent_flow import LatentFlow

        self._network = LatentFlow(problem.sensor.n_measurements, problem.mask.shape)
        self._network.load_state_dict(tensors)
        self._network.eval().requires_grad_(requires_grad=False)
        self._motions = motions(problem.sensor, problem.jacobian)
        # The same numbers for every frame and motion: images move with their frames.
        rng = np.random.default_rng(0)
        count = len(self._network.components)
        normal = rng.standard_normal((-(-DRAWN // len(self._motions)), count))
        self._normal = torch.from_numpy(normal).float()

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`."""
        mean: Images = self._drawn(difference).mean(axis=1).astype(np.float32)
        return mean

    def uncertainty(self, voltages: Array) -> Array:
        """Draws (n, K, H, W) [S/m] from the learned posterior of frames (n, M)."""
        drawn: Images = self._drawn(self.amplified(voltages))[:, :DRAWS].astype(np.float32)
        return np.asarray(self.weakened(drawn) * self._problem.background)

    def _drawn(self, difference: Array) -> Array:
        """Conductivity over background (n, D, H, W), drawn under every motion of the sensor."""
        import torch

        found = list[Array]()
        for motion in self._motions:
            moved = torch.from_numpy(motion.voltages(difference)).float()
            images: Images = self._network.draws(self._normal, moved).numpy()
            found.append(motion.images_back(images))
        return 1 + np.concatenate(found, axis=1)
