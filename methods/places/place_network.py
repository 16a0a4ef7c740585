"""A network from a frame to the place of its only contact, trained by simulated and real presses.

It sees differences divided by their rms: where a touch is does not depend on how strong it is.
While it learns, every measurement is multiplied by a random factor and noise is added, drawn anew
at every step, since no simulation knows the channels of a board. (Domain randomisation; Tobin et
al., IROS 2017, did it with images.)
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.data.simulation import split_folder
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_log = logging.getLogger(__name__)

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
        train_s: time of all its training [s].
    """

    train_s: float = 0.0

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
        start = time.perf_counter()
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
        trained.train_s = self.train_s + time.perf_counter() - start
        return trained

    def trained_once(self, frames: Array, places: Array, phase: TrainingPhase) -> PlaceNetwork:
        """As `trained`; the same training is made once, and read from the cache from then on.

        So all skins share what is learned from simulated presses of their sensor, and all numbers
        of labelled presses of a skin what is learned from other skins.
        """
        made_from = hashlib.sha256(Path(__file__).read_bytes())
        made_from.update(repr((torch.__version__, self._seed, phase)).encode())
        for array in (frames, places, self.centre, np.array(self.scale), *self._state().values()):
            made_from.update(np.ascontiguousarray(array).tobytes())
        # Beside the simulated data, which workers may write, too.
        path = split_folder("train") / "places" / f"{made_from.hexdigest()}.safetensors"
        try:
            stored = read_arrays(path)
        except DataCorruptError as error:
            _log.warning("%s It is made again.", error)
            stored = None
        if stored is None:
            trained = self.trained(frames, places, phase)
            write_arrays(path, trained._state(), {"train_s": str(trained.train_s)})
            return trained
        trained = copy.deepcopy(self)
        state = {name: torch.from_numpy(array) for name, array in stored[0].items()}
        trained._network.load_state_dict(state)
        trained.train_s = float(stored[1]["train_s"])
        return trained

    def _state(self) -> dict[str, NDArray[np.float32]]:
        return {name: value.numpy() for name, value in self._network.state_dict().items()}

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
