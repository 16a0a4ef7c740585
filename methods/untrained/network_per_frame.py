"""An untrained network that is fitted to the voltages of a single frame."""

from __future__ import annotations

import itertools
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
    from torch.optim import Optimizer

    from eitbench.methods.problem import Problem


NEAREST = 0.05
"""Least distance of the first conductivity from the ends of its range, as a fraction of it."""

SMOOTHING = 0.01
"""The total variation is rounded where the relative conductivity changes by less than this."""


BATCH = 8
"""Frames that are fitted side by side: the exact operator solves eight images at once."""

Objective = Callable[["nn.Module", "Tensor"], "Tensor"]
"""A loss () of a network and of what `FittedPerFrame.together` makes of its image."""


@dataclass
class Fit:
    """A network that is being fitted to one frame.

    Attributes:
        first: (H, W) the image that it begins with, conductivity over background.
    """

    network: nn.Module
    optimiser: Optimizer
    objective: Objective
    first: Tensor
    stopping: MovingVariance


@dataclass
class FittedPerFrame(Method):
    """Base of the methods that fit a network to each frame.

    A subclass says which network, and what it is to minimise beside the weighted total variation.
    The image is that of `MovingVariance`, which may also stop Adam, at twice its window at the
    earliest.

    Attributes:
        name: that it is registered by.
        steps: of the optimiser, at most.
        tv: weight of the total variation of conductivity / background; 0 for none.
        seed: of the network.
    """

    needs: ClassVar = "torch"
    name: ClassVar[str]
    learning_rate: ClassVar[float]
    window: ClassVar[int] = 100
    """Of `MovingVariance`, and its patience [steps]."""

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

    def together(self, relative: Tensor) -> Tensor:
        """Return what objectives look at (n, ...), of images (n, H, W) over the background.

        Here these images; what costs less for several images at once is computed here, too.
        """
        return relative

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
        whole = isinstance(self.steps, int)
        if not (whole and self.steps >= 1 and 0 <= self.tv < math.inf):
            raise InputError(
                f"{self.name!r} needs at least 1 step, a whole number of them, and a weight of at "
                f"least 0, got steps={self.steps} and tv={self.tv}."
            )
        self._problem = problem

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        differences = self._problem.difference(voltages)
        relative = np.empty((len(differences), *self._problem.mask.shape))
        waiting = ((image, self._begun(d)) for image, d in zip(relative, differences, strict=True))
        running: list[tuple[Array, Fit]] = []
        # A frame that is done makes room for the next.
        while running := running + list(itertools.islice(waiting, BATCH - len(running))):
            done = self._step([fit for _, fit in running])
            for image, fit in itertools.compress(running, done):
                image[:] = fit.stopping.image
            running = [pair for pair, over in zip(running, done, strict=True) if not over]
        return relative * self._problem.background

    def _begun(self, difference: Array) -> Fit:
        """The beginning of the fit to one frame's `difference` (M,) [V/A]."""
        import torch

        first = self.first(difference)
        # Every frame has the same network, so that it does not matter which others come with it.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            network = self.network()
        return Fit(
            network,
            torch.optim.Adam(network.parameters(), self.learning_rate, fused=True),
            self.objective(difference, first),
            torch.from_numpy(first).float(),
            MovingVariance(self.window, self.window),
        )

    def _step(self, fits: list[Fit]) -> list[bool]:
        """Take a step of every fit; return True for those that are done."""
        import torch

        mask = torch.from_numpy(self._problem.mask)
        with torch.enable_grad():
            # One by one, so that not even the rounding of an image depends on what is beside it.
            images = [torch.where(mask, self.image(f.network(), f.first), 1.0) for f in fits]
            seen = self.together(torch.stack(images))
            losses = [f.objective(f.network, of) for f, of in zip(fits, seen, strict=True)]
            if self.tv > 0:
                losses += [self.tv * self._variation(image) for image in images]
            for fit in fits:
                fit.optimiser.zero_grad()
            torch.autograd.backward(losses)
        done = []
        for fit, image in zip(fits, images, strict=True):
            still = fit.stopping.stops(image.detach().double().numpy())
            done.append(still or fit.stopping.seen == self.steps)
            if not done[-1]:
                fit.optimiser.step()
        return done

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
        """See `FittedPerFrame`; the misfit of the differences that the operator predicts."""
        del first
        misfit = self._misfit.of(difference)
        return lambda _, predicted: misfit(predicted)

    def together(self, relative: Tensor) -> Tensor:
        """See `FittedPerFrame`; the differences (n, M) [V/A] that the operator predicts."""
        return self._misfit.predicted(relative * self._problem.background)


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
        seen: number of images.
    """

    image: Array

    def __init__(self, window: int, patience: int) -> None:
        self.position = 0
        self._window, self._patience = window, patience
        self._images: deque[Array] = deque()
        self._least = np.inf
        self.seen = 0

    def stops(self, image: Array) -> bool:
        """Take in the next image (H, W); return True if it is time to stop."""
        if not self._images:
            self._total, self._squares = np.zeros_like(image), 0.0
        self._images.append(image)
        self._total += image
        self._squares += float(np.vdot(image, image))
        self.seen += 1
        if len(self._images) > self._window:
            oldest = self._images.popleft()
            self._total -= oldest
            self._squares -= float(np.vdot(oldest, oldest))
        mean = self._total / len(self._images)
        full = len(self._images) == self._window
        variance = self._squares / len(self._images) - float(np.vdot(mean, mean))
        if not full or variance < self._least:
            self.image, self.position = mean, self.seen
            self._least = variance if full else np.inf
        return self.seen - self.position >= self._patience
