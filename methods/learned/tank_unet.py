"""Classes of objects in a tank by a U-Net from linear images, whatever electrodes are left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import GAINS, damping
from eitbench.methods.classical.noser import noser_covariance
from eitbench.methods.learned.image_networks import TrainedMethod
from eitbench.methods.registry import register
from eitbench.methods.smoothness import smoothed
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles, Weights, sensor_key
from eitbench.scenarios.arrays import Array, Images, Mask
from eitbench.scenarios.recordings.public.kuopio import tank

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from torch import Tensor

    from eitbench.methods.problem import Problem
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.sensors.sensor import Sensor

NOISE = (0.05, 0.01)
"""Of a value, relative to it and to the largest one: the challenge's noise model, scaled."""
NOSER, LAPLACIAN = (0.003, 0.03, 0.3), (0.003, 0.03)
"""Weights of the images with either prior."""
CHANNELS = len(NOSER) + len(LAPLACIAN) + 1
RANK = 480
"""At least the rank of the Jacobian: 15 independent drives of 31 differences."""
CONTRAST = 0.9
"""Contrast of an image, in parts of the background, where a class is certain."""


class LinearImages:
    """The network's inputs: one-step images with two priors, and how well each pixel is seen.

    A common factor of all values, from water that became warmer since the reference frame, is no
    object: what is parallel to the reference frame is taken out of data and model.

    Attributes:
        combinations: (M, K) independent combinations of differences [V/A].
        matrix: (K, C - 1, P) from these to images.
        seen: (P,) the part of a pixel's contrast that its NOSER image shows.
    """

    def __init__(self, jacobian: Array, untouched: Array, mask: Mask) -> None:
        """`jacobian` (M, P) [V/A per S/m] on the pixels inside `mask`; `untouched` (M,) [V/A]."""
        relative, floor = NOISE
        self._weights = 1 / np.hypot(relative * untouched, floor * np.abs(untouched).max())
        rows = self._without_common(self._weights[:, None] * jacobian, self._weights * untouched)
        # Of full range almost surely, as random vectors are; the seed makes it the same each time.
        random = np.random.default_rng(0).normal(size=(rows.shape[1], min(RANK, len(rows))))
        basis = np.linalg.qr(rows @ random)[0]
        rows = basis.T @ rows
        noser = noser_covariance(rows)[:, None] * rows.T
        smooth = smoothed(rows, mask)
        found = [_inverse(rows, noser, weight) for weight in NOSER]
        self.seen = np.einsum("pk,kp->p", found[1], rows)
        found += [_inverse(rows, smooth, weight) for weight in LAPLACIAN]
        self.combinations: Array = self._weights[:, None] * basis
        self.matrix = np.array(found).transpose(2, 0, 1)

    def differences(self, difference: Array, reference: Array) -> Array:
        """Differences (n, M) without what is parallel to the reference frame (M,) [V/A]."""
        weighted = self._without_common((difference * self._weights).T, reference * self._weights)
        return np.asarray(weighted.T / self._weights)

    @staticmethod
    def _without_common(columns: Array, direction: Array) -> Array:
        unit = direction / np.linalg.norm(direction)
        return np.asarray(columns - np.outer(unit, unit @ columns))


def image_map(linear: LinearImages, mask: Mask) -> Callable[[Tensor], Tensor]:
    """Return the map of tensors from differences (n, M) [V/A] to the network's (n, C, H, W)."""
    import torch

    combinations, matrix, seen = (
        torch.from_numpy(array).float()
        for array in (
            linear.combinations,
            linear.matrix.reshape(len(linear.matrix), -1),
            linear.seen,
        )
    )
    inside = torch.from_numpy(mask.copy())

    def images(difference: Tensor) -> Tensor:
        shown = (difference @ combinations @ matrix).view(len(difference), -1, len(seen))
        shown = torch.cat([shown, seen.expand(len(shown), 1, -1)], dim=1)
        full = torch.zeros(*shown.shape[:2], *mask.shape)
        full[:, :, inside] = shown
        return full

    return images


def _inverse(rows: Array, prior: Array, weight: float) -> Array:
    """C J^T (J C J^T + w I)^-1 (P, K), given J (K, P) and C J^T (P, K)."""
    gram = rows @ prior
    return np.asarray(np.linalg.solve(gram + damping(gram, weight), prior.T).T)


@dataclass(frozen=True)
class TankWeights(WeightFiles):
    """Weights that serve the whole tank, and all levels of the challenge, which lack electrodes."""

    def load(self, sensor: Sensor, path: Path | None = None) -> Weights:
        """See `WeightFiles`."""
        return super().load(_whole(sensor), path)

    def content_hash(self, sensor: Sensor) -> str:
        """See `WeightFiles`."""
        return super().content_hash(_whole(sensor))


def _whole(sensor: Sensor) -> Sensor:
    """The whole tank, if `sensor` is it without some of its measurements, else `sensor`."""
    whole = tank()
    rows = {tuple(row) for row in whole.pattern.table.tolist()}
    part = all(tuple(row) in rows for row in sensor.pattern.table.tolist())
    same = part and sensor_key(replace(sensor, pattern=whole.pattern)) == sensor_key(whole)
    return whole if same else sensor


@register("tank-unet")
@dataclass
class TankUNet(TrainedMethod):
    """A U-Net from linear images of the Kuopio tank to classes, for any electrodes left out.

    An image is the background and 0.9 times of it more where an object conducts, less where it
    does not, times the probability of one minus that of the other.
    """

    source: ClassVar[str] = "Denker et al., arXiv:2407.01559, 2024"
    files: ClassVar = TankWeights("tank-unet", version="1")
    recipe: ClassVar = Recipe(epochs=7, batch=32, rate=2e-3)
    options: ClassVar = ("limit",)
    search: ClassVar = GAINS  # its images are of classes, which no amplification weakens

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        from eitbench.methods.learned.tank_training import train_tank_unet

        return train_tank_unet(job)

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`."""
        from eitbench.methods.networks.class_network import ClassNetwork

        jacobian = problem.jacobian[:, problem.mask]
        self._linear = LinearImages(jacobian, problem.background_voltages, problem.mask)
        self._network = ClassNetwork(problem.mask, CHANNELS)
        self._network.load_state_dict(tensors)
        self._network.eval().requires_grad_(requires_grad=False)
        self._inputs = image_map(self._linear, problem.mask)

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`."""
        import torch

        reference = self._problem.unit_reference
        clean = torch.from_numpy(self._linear.differences(difference, reference)).float()
        images: Images = self._network(self._inputs(clean)).numpy()
        return np.asarray(1 + CONTRAST * images.clip(-1, 1), dtype=np.float32)
