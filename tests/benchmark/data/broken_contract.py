"""A plugin whose methods each break one promise of the contract."""

import os
import random
import signal
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_info

from eitbench.methods import Method, Problem, register
from eitbench.scenarios.errors import InputError

Array = np.ndarray[Any, np.dtype[np.float64]]


class Sound(Method):
    """Keeps every promise."""

    def fit(self, problem: Problem) -> None:
        self.problem = problem
        self.spread = problem.jacobian.reshape(len(problem.jacobian), -1)
        self.spread = self.spread / np.abs(self.spread).sum() * 100

    def reconstruct(self, voltages: Array) -> Array:
        contrast = self.problem.difference(voltages) @ self.spread
        return self.problem.background + contrast.reshape(-1, *self.problem.mask.shape)


@register("contract-kept")
class StoredBatches(Sound):
    """Keeps every promise."""


@register("contract-contrast")
class Contrast(Sound):
    """Forgets the background."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) - self.problem.background


@register("contract-inverted")
class Inverted(Sound):
    """Has the sign wrong."""

    def reconstruct(self, voltages: Array) -> Array:
        return 2 * self.problem.background - super().reconstruct(voltages)


@register("contract-unsigned")
class Unsigned(Sound):
    """Sees every contact as resistive."""

    def reconstruct(self, voltages: Array) -> Array:
        background = self.problem.background
        return background - np.abs(super().reconstruct(voltages) - background)


@register("contract-batch")
class Batch(Sound):
    """Scales by what else is in the batch."""

    def reconstruct(self, voltages: Array) -> Array:
        background = self.problem.background
        contrast = super().reconstruct(voltages) - background
        return background + contrast * len(voltages)


@register("contract-random")
class Random(Sound):
    """Starts from what is another number in every process."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.spread = self.spread * (1 + os.getpid() % 97)


@register("contract-short")
class Short(Sound):
    """Pads frames that are too short."""

    def reconstruct(self, voltages: Array) -> Array:
        missing = len(self.problem.reference) - voltages.shape[1]
        return super().reconstruct(np.pad(voltages, ((0, 0), (0, missing))))


@register("contract-nan")
class Nan(Sound):
    """Takes a NaN for zero."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(np.nan_to_num(voltages))


@register("contract-own-grid")
class OwnGrid(Sound):
    """Keeps every promise where it exists: for the sensor's own image grid."""

    def fit(self, problem: Problem) -> None:
        if problem.mask.shape != (80, 80):
            raise InputError("There are weights for 80 x 80 pixels only.")
        super().fit(problem)


@register("contract-hole")
class Hole(Sound):
    """Has no value for a pixel."""

    def reconstruct(self, voltages: Array) -> Array:
        images = super().reconstruct(voltages)
        images[:, 3, 3] = np.nan
        return images


class Bent(Sound):
    """Base of those that do something to the contrast (n, H, W) of voltages (n, M)."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        raise NotImplementedError

    def reconstruct(self, voltages: Array) -> Array:
        background = self.problem.background
        return background + self.bent(super().reconstruct(voltages) - background, voltages)


@register("contract-order")
class Order(Bent):
    """Takes a frame that is suddenly stronger for a glitch, and halves it."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        strength = np.linalg.norm(self.problem.difference(voltages), axis=1)
        glitch = np.append(False, strength[1:] > 2 * strength[:-1])
        return contrast * np.where(glitch, 0.5, 1.0)[:, None, None]


@register("contract-seed")
class Seed(Sound):
    """Draws from a global generator, and puts it back."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        state = random.getstate()
        self.spread = self.spread * (1 + random.random())
        random.setstate(state)


@register("contract-leak")
class Leak(Sound):
    """Seeds a global generator for its own purposes."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        np.random.seed(7)  # noqa: NPY002
        self.spread = self.spread * (1 + np.random.rand())  # noqa: NPY002


@register("contract-saturated")
class Saturated(Bent):
    """Shows every contact as strong as any other."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        return np.asarray(
            contrast / np.maximum(np.abs(contrast).max(axis=(1, 2), keepdims=True), 1e-9)
        )


@register("contract-squared")
class Squared(Bent):
    """Shows twice the contrast as four times as much."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        return contrast * np.abs(contrast)


@register("contract-turned")
class Turned(Bent):
    """Sees more at the top than at the bottom."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        return contrast * np.linspace(0.9, 1.1, contrast.shape[1])[:, None]


@register("contract-mirrored")
class Mirrored(Bent):
    """Has a pattern with the turns of a square, and without its mirrors."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        y, x = (np.indices(contrast.shape[1:]) + 0.5) / contrast.shape[1] - 0.5
        return np.asarray(contrast * (1 + 0.1 * np.sin(4 * np.arctan2(y, x))))


@register("contract-gain")
class Gain(Sound):
    """Takes a board's numbers for V/A."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) * self.problem.gain - (self.problem.gain - 1)


class Noisy(Bent):
    """Base of those that see noise: as much of a frame (n,) as breaks reciprocity."""

    def noise(self, voltages: Array) -> Array:
        pattern = self.problem.sensor.pattern
        pairs = pattern.reciprocal_pairs()
        first, second = voltages[:, pairs[:, 0]], voltages[:, pairs[:, 1]]
        broken = np.linalg.norm(second - first * pattern.reciprocal_signs(pairs), axis=1)
        return np.asarray((broken / np.linalg.norm(voltages, axis=1))[:, None, None])


@register("contract-exploding")
class Exploding(Noisy):
    """Blows noise up, in proportion."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        return contrast + 50 * self.noise(voltages)


@register("contract-diverging")
class Diverging(Noisy):
    """Suffers from the square of the noise."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        return contrast + 200 * self.noise(voltages) ** 2


@register("contract-overconfident")
class Overconfident(Noisy):
    """Adds detail where there is little noise."""

    def bent(self, contrast: Array, voltages: Array) -> Array:
        noise = self.noise(voltages)
        return contrast + 0.1 * np.exp(-noise / 0.003) * (noise > 1e-6)


@register("contract-threads")
class Threads(Sound):
    """Works otherwise on more threads."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.spread = self.spread * max(library["num_threads"] for library in threadpool_info())


@register("contract-keeps")
class Keeps(Sound):
    """Keeps every image it ever made."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.made: list[Array] = []

    def reconstruct(self, voltages: Array) -> Array:
        self.made.append(super().reconstruct(voltages))
        return self.made[-1]


@register("contract-network")
class Network(Sound):
    """Asks a server, and does without where there is none."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", 9), timeout=0.1).close()


@register("contract-writes")
class Writes(Sound):
    """Keeps a diary where it likes."""

    def reconstruct(self, voltages: Array) -> Array:
        Path(os.environ["TOY_DIARY"]).write_text("reconstructed")
        return super().reconstruct(voltages)


@register("contract-starts")
class Starts(Sound):
    """Leaves work to another program."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        os.system("exit")  # noqa: S605, S607


@register("contract-slow")
class Slow(Sound):
    """Is stuck on a long batch, and cannot be asked to stop."""

    def reconstruct(self, voltages: Array) -> Array:
        if len(voltages) > 6:
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, signal.SIG_IGN)
            while True:
                time.sleep(1)
        return super().reconstruct(voltages)


@register("contract-excused")
class Excused(Turned):
    """Says what it cannot do."""

    expected_failures: ClassVar = {"rotation_equivariance": "sees more at the top"}


@register("contract-outdated")
class Outdated(Sound):
    """Says that it cannot do what it can."""

    expected_failures: ClassVar = {"rotation_equivariance": "saw more at the top"}


@register("contract-no-such-check")
class NoSuchCheck(Sound):
    """Expects to fail a check that does not exist."""

    expected_failures: ClassVar = {"rotation_equivarance": "sees more at the top"}


@register("contract-no-reason")
class NoReason(Sound):
    """Expects to fail, and does not say why."""

    expected_failures: ClassVar = {"rotation_equivariance": " "}


@register("contract-no-mapping")
class NoMapping(Sound):
    """Expects to fail in a form that cannot be read."""

    expected_failures: ClassVar = ["rotation_equivariance"]  # type: ignore[assignment]
