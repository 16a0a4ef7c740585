"""A network from a frame to the place of its only contact, trained by simulated and real presses.

It sees differences divided by their rms: where a touch is does not depend on how strong it is.
While it learns, every measurement is multiplied by a random factor and noise is added, drawn anew
at every step, since no simulation knows the channels of a board. (Domain randomisation; Tobin et
al., IROS 2017, did it with images.)
"""

from __future__ import annotations

import copy
import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


HIDDEN = (256, 256)


@dataclass(frozen=True)
class TrainingPhase:
    """Hyper-parameters of learning from frames with known places.

    Attributes:
        steps: of the optimiser, AdamW with one cycle of its learning rate.
        batch: frames in a step; all of them if there are fewer.
        rate: the highest learning rate.
        gain: standard deviation of the logarithm of each measurement's random factor.
        noise: standard deviation of what is added to a frame of unit rms.
    """

    steps: int
    batch: int
    rate: float
    gain: float
    noise: float


SIMULATED = TrainingPhase(steps=2500, batch=128, rate=3e-3, gain=0.5, noise=1.0)
"""From thousands of simulated presses."""

SKINS = TrainingPhase(steps=2000, batch=256, rate=1e-3, gain=0.3, noise=0.5)
"""From thousands of presses of other skins, whose boards and gels differ."""

REAL = TrainingPhase(steps=300, batch=512, rate=1e-3, gain=0.0, noise=0.3)
"""From tens or hundreds of real ones, whose board is the one to be used."""


class PlaceNetwork:
    """Places (n, 2) [m] from differences (n, M) in any unit.

    Attributes:
        centre, scale: of the places it can tell [m]; its outputs are relative to them.
    """

    def __init__(self, n_measurements: int, centre: ArrayLike, scale: float, seed: int) -> None:
        self.centre, self.scale = np.asarray(centre, dtype=np.float64), scale
        widths = (n_measurements, *HIDDEN, 2)
        layers: list[nn.Module] = []
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            for a, b in itertools.pairwise(widths):
                layers += [nn.Linear(a, b), nn.GELU()]
        self._network = nn.Sequential(*layers[:-1])
        self._seed = seed

    def trained(self, frames: ArrayLike, places: ArrayLike, phase: TrainingPhase) -> PlaceNetwork:
        """A copy that has learned from `frames` (n, M) and `places` (n, 2) [m].

        Raises:
            InputError: no frames, or not as many places.
        """
        x = torch.from_numpy(unit_frames(frames)).float()
        y = torch.from_numpy((np.asarray(places) - self.centre) / self.scale).float()
        if not len(x) or x.shape[0] != y.shape[0] or y.shape[1:] != (2,):
            raise InputError(f"A place (x, y) is needed for each frame, got {y.shape}, {x.shape}.")
        trained = copy.deepcopy(self)
        network = trained._network
        optimizer = torch.optim.AdamW(network.parameters(), phase.rate, weight_decay=1e-2)
        rates = torch.optim.lr_scheduler.OneCycleLR(optimizer, phase.rate, phase.steps)
        with torch.random.fork_rng():
            torch.manual_seed(self._seed)
            for _ in range(phase.steps):
                chosen = torch.randperm(len(x))[: phase.batch]
                seen = _corrupted(x[chosen], phase)
                loss = (network(seen) - y[chosen]).square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                rates.step()
        return trained

    @torch.no_grad()
    def __call__(self, frames: ArrayLike) -> Array:
        """Places (n, 2) [m] of differences `frames` (n, M)."""
        outputs = self._network(torch.from_numpy(unit_frames(frames)).float())
        return np.asarray(self.centre + self.scale * outputs.double().numpy())


def _corrupted(frames: Tensor, phase: TrainingPhase) -> Tensor:
    """As another board would measure them, at unit rms again."""
    if phase.gain:
        frames = frames * torch.exp(phase.gain * torch.randn_like(frames))
    noisy: Tensor = frames + phase.noise * torch.randn_like(frames)
    rms: Tensor = noisy.norm(dim=1, keepdim=True) / math.sqrt(frames.shape[1])
    return noisy / rms
