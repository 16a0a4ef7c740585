"""An untrained network that is fitted to the voltages of a single frame."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.method import Method
from eitbench.methods.registry import OPERATOR_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor, nn

    from eitbench.methods.problem import Problem


WINDOW, PATIENCE = 100, 100
"""Of the early stopping, in steps."""

NEAREST = 0.05
"""Least distance of the first conductivity from the ends of its range, as a fraction of it."""

SMOOTHING = 0.01
"""The total variation is rounded where the relative conductivity changes by less than this."""


@dataclass
class NetworkPerFrame(Method):
    """An untrained network per frame, fitted to its voltages through a forward operator.

    The loss is `misfit.Misfit` plus the weighted total variation; Adam is stopped by
    `MovingVariance`.

    Attributes:
        operator: the forward operator that the network is fitted through.
        steps: of the optimiser, at most.
        tv: weight of the total variation of conductivity / background; 0 for none.
        seed: of the network.
    """

    learning_rate: ClassVar[float]

    operator: str = "fem"
    steps: int = 400
    tv: float = 0.1
    seed: int = 0

    @abstractmethod
    def network(self) -> nn.Module:
        """Return a new network; called without an input, it returns the image (H, W).

        The image is the logit of the conductivity within its range, 0 being the background.
        """

    def fit(self, problem: Problem) -> None:
        """Prepare the operator and its misfit.

        Raises:
            InputError: an unknown operator or one that does not serve the sensor; no step, or a
                negative weight.
        """
        from eitbench.methods.untrained.misfit import Misfit

        if not (self.steps >= 1 and 0 <= self.tv < math.inf):
            raise InputError(
                f"{type(self).__name__.lower()!r} needs at least 1 step and a weight of at least "
                f"0, got steps={self.steps} and tv={self.tv}."
            )
        self._problem = problem
        self._misfit = Misfit(problem, OPERATOR_REGISTRY.create(self.operator, problem.sensor))

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        relative = [self._fitted(frame) for frame in self._problem.difference(voltages)]
        shape = (-1, *self._problem.mask.shape)
        return np.asarray(relative).reshape(shape) * self._problem.background

    def _fitted(self, difference: Array) -> Array:
        """Conductivity over background (H, W) for one frame's `difference` (M,) [V/A]."""
        import torch

        misfit, background = self._misfit.of(difference), self._problem.background
        # Every frame has the same network, so that it does not matter which others come with it.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            network = self.network()
        optimiser = torch.optim.Adam(network.parameters(), self.learning_rate, fused=True)
        stopping = MovingVariance(WINDOW, PATIENCE)
        for _ in range(self.steps):
            with torch.enable_grad():
                relative = self._relative(network)
                loss = misfit(relative * background)
                if self.tv > 0:
                    loss = loss + self.tv * self._variation(relative)
                optimiser.zero_grad()
                torch.autograd.backward(loss)
            if stopping.stops(relative.detach().double().numpy()):
                break
            optimiser.step()
        return stopping.image

    def _relative(self, network: nn.Module) -> Tensor:
        """Return the network's conductivity over background (H, W); 1 outside the sensor."""
        import torch

        low, high = self._problem.sensor.conductivity_range
        share = min(max((1 - low) / (high - low), NEAREST), 1 - NEAREST)
        inside = torch.sigmoid(network() + math.log(share / (1 - share)))
        mask = torch.from_numpy(self._problem.mask)
        return torch.where(mask, low + (high - low) * inside, 1.0)

    def _variation(self, relative: Tensor) -> Tensor:
        """Total variation () inside the sensor, in sides of it: 1 for a step of 1 across it."""
        import torch

        mask = torch.from_numpy(self._problem.mask)
        across = torch.diff(relative, dim=1)[:-1] * (mask[:-1, 1:] & mask[:-1, :-1])
        along = torch.diff(relative, dim=0)[:, :-1] * (mask[1:, :-1] & mask[:-1, :-1])
        slope = (across.square() + along.square() + SMOOTHING**2).sqrt() - SMOOTHING
        return slope.sum() / math.sqrt(self._problem.mask.sum())


class MovingVariance:
    """Keeps the mean of the window of successive images that vary least.

    A network fits the image first and the noise later; in between, its images stand still. So the
    window with the least variance is the place to stop, and it is known when a later window has
    not come below it for `patience` images. Nothing but the images is looked at.

    Source: Wang et al., "Early Stopping for Deep Image Prior", TMLR 2023, algorithm 1. They return
    the window's first image; the mean is as good or better here, and free.

    Attributes:
        image: (H, W) the mean over the best window so far, over all images while there is no full
            window yet.
        position: number of images seen when that window was complete.
    """

    image: Array

    def __init__(self, window: int, patience: int) -> None:
        self.position = 0
        self._window, self._patience = window, patience
        self._images: deque[Array] = deque()
        self._least = np.inf
        self._seen = 0

    def stops(self, image: Array) -> bool:
        """Take in the next image (H, W); return True if it is time to stop."""
        if not self._images:
            self._total, self._squares = np.zeros_like(image), 0.0
        self._images.append(image)
        self._total += image
        self._squares += float(np.vdot(image, image))
        self._seen += 1
        if len(self._images) > self._window:
            oldest = self._images.popleft()
            self._total -= oldest
            self._squares -= float(np.vdot(oldest, oldest))
        mean = self._total / len(self._images)
        full = len(self._images) == self._window
        variance = self._squares / len(self._images) - float(np.vdot(mean, mean))
        if not full or variance < self._least:
            self.image, self.position = mean, self._seen
            self._least = variance if full else np.inf
        return self._seen - self.position >= self._patience
