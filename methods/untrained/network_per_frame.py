"""An untrained network that is fitted to the voltages of a single frame."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
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


Objective = Callable[["nn.Module", "Tensor"], "Tensor"]
"""A loss () of a network and of its image (H, W), conductivity over background."""


@dataclass
class FittedPerFrame(Method):
    """Base of the methods that fit a network to each frame.

    A subclass says which network, and what it is to minimise beside the weighted total variation.
    Adam is stopped by `MovingVariance`.

    Attributes:
        name: that it is registered by.
        steps: of the optimiser, at most.
        tv: weight of the total variation of conductivity / background; 0 for none.
        seed: of the network.
    """

    needs: ClassVar = "torch"
    name: ClassVar[str]
    learning_rate: ClassVar[float]

    steps: int = 400
    tv: float = 0.1
    seed: int = 0

    @abstractmethod
    def network(self) -> nn.Module:
        """Return a new network; called without an input, it returns what `image` takes (H, W)."""

    @abstractmethod
    def objective(self, difference: Array, first: Array) -> Objective:
        """Return what is minimised for one frame's `difference` (M,) [V/A].

        `first` (H, W) is the image to begin with, conductivity over background.
        """

    def first(self, difference: Array) -> Array:
        """Return the image (H, W) to begin with, conductivity over background; 1 everywhere."""
        del difference
        return np.ones(self._problem.mask.shape)

    def image(self, output: Tensor, first: Tensor) -> Tensor:
        """Return the image (H, W) of a network's output, zero for that it begins with.

        The output is added to the logit of the first image within the range of conductivity.
        """
        import torch

        low, high = self._problem.sensor.conductivity_range
        share = ((first - low) / (high - low)).clamp(NEAREST, 1 - NEAREST)
        return low + (high - low) * torch.sigmoid(output + torch.logit(share))

    def fit(self, problem: Problem) -> None:
        """Check the parameters.

        Raises:
            InputError: no step, or a negative weight.
        """
        if not (self.steps >= 1 and 0 <= self.tv < math.inf):
            raise InputError(
                f"{self.name!r} needs at least 1 step and a weight of at least 0, got "
                f"steps={self.steps} and tv={self.tv}."
            )
        self._problem = problem

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        relative = [self._fitted(frame) for frame in self._problem.difference(voltages)]
        shape = (-1, *self._problem.mask.shape)
        return np.asarray(relative).reshape(shape) * self._problem.background

    def _fitted(self, difference: Array) -> Array:
        """Conductivity over background (H, W) for one frame's `difference` (M,) [V/A]."""
        import torch

        first = self.first(difference)
        objective, begun = self.objective(difference, first), torch.from_numpy(first).float()
        mask = torch.from_numpy(self._problem.mask)
        # Every frame has the same network, so that it does not matter which others come with it.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            network = self.network()
        optimiser = torch.optim.Adam(network.parameters(), self.learning_rate, fused=True)
        stopping = MovingVariance(WINDOW, PATIENCE)
        for _ in range(self.steps):
            with torch.enable_grad():
                relative = torch.where(mask, self.image(network(), begun), 1.0)
                loss = objective(network, relative)
                if self.tv > 0:
                    loss = loss + self.tv * self._variation(relative)
                optimiser.zero_grad()
                torch.autograd.backward(loss)
            if stopping.stops(relative.detach().double().numpy()):
                break
            optimiser.step()
        return stopping.image

    def _variation(self, relative: Tensor) -> Tensor:
        """Total variation () inside the sensor, in sides of it: 1 for a step of 1 across it."""
        import torch

        mask = torch.from_numpy(self._problem.mask)
        across = torch.diff(relative, dim=1)[:-1] * (mask[:-1, 1:] & mask[:-1, :-1])
        along = torch.diff(relative, dim=0)[:, :-1] * (mask[1:, :-1] & mask[:-1, :-1])
        slope = (across.square() + along.square() + SMOOTHING**2).sqrt() - SMOOTHING
        return slope.sum() / math.sqrt(self._problem.mask.sum())


@dataclass
class NetworkPerFrame(FittedPerFrame):
    """An untrained network per frame, fitted to its voltages through a forward operator.

    For the other attributes see `FittedPerFrame`.

    Attributes:
        operator: the forward operator that the network is fitted through, see `misfit.Misfit`.
    """

    operator: str = "fem"

    def fit(self, problem: Problem) -> None:
        """Prepare the operator and its misfit.

        Raises:
            InputError: an unknown operator or one that does not serve the sensor; no step, or a
                negative weight.
        """
        from eitbench.methods.untrained.misfit import Misfit

        super().fit(problem)
        self._misfit = Misfit(problem, OPERATOR_REGISTRY.create(self.operator, problem.sensor))

    def objective(self, difference: Array, first: Array) -> Objective:
        """See `FittedPerFrame`; the misfit of the operator's voltages."""
        del first
        misfit, background = self._misfit.of(difference), self._problem.background
        return lambda _, relative: misfit(relative * background)


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
