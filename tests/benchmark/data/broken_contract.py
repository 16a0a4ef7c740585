"""A plugin whose methods each break one promise of the contract."""

import os
import random
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

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


Bend = Callable[[Problem, Array, Array], Array]
"""Makes another contrast (n, H, W) of a problem, the contrast and the voltages (n, M)."""


def bent(name: str, bend: Bend, expected: Any = None) -> None:
    """Register a method that does something to the contrast of a sound one."""

    class Bent(Sound):
        expected_failures = expected or {}

        def reconstruct(self, voltages: Array) -> Array:
            background = self.problem.background
            contrast = super().reconstruct(voltages) - background
            return background + bend(self.problem, contrast, voltages)

    register(name)(Bent)


def halved_glitches(problem: Problem, contrast: Array, voltages: Array) -> Array:
    """Take a frame that is suddenly stronger for a glitch."""
    strength = np.linalg.norm(problem.difference(voltages), axis=1)
    glitch = np.append(False, strength[1:] > 2 * strength[:-1])
    return contrast * np.where(glitch, 0.5, 1.0)[:, None, None]


def saturated(_: Problem, contrast: Array, __: Array) -> Array:
    """Show every contact as strong as any other."""
    largest = np.abs(contrast).max(axis=(1, 2), keepdims=True)
    return np.asarray(contrast / np.maximum(largest, 1e-9))


def stronger_at_the_top(_: Problem, contrast: Array, __: Array) -> Array:
    return contrast * np.linspace(0.9, 1.1, contrast.shape[1])[:, None]


def without_mirrors(_: Problem, contrast: Array, __: Array) -> Array:
    """Have a pattern with the turns of a square, and without its mirrors."""
    y, x = (np.indices(contrast.shape[1:]) + 0.5) / contrast.shape[1] - 0.5
    return np.asarray(contrast * (1 + 0.1 * np.sin(4 * np.arctan2(y, x))))


def noise(problem: Problem, voltages: Array) -> Array:
    """Noise that is seen: as much of a frame (n, 1, 1) as breaks reciprocity."""
    pattern = problem.sensor.pattern
    pairs = pattern.reciprocal_pairs()
    first, second = voltages[:, pairs[:, 0]], voltages[:, pairs[:, 1]]
    broken = np.linalg.norm(second - first * pattern.reciprocal_signs(pairs), axis=1)
    return np.asarray((broken / np.linalg.norm(voltages, axis=1))[:, None, None])


def sharper_where_quiet(problem: Problem, contrast: Array, voltages: Array) -> Array:
    """Add detail where there is little noise."""
    seen = noise(problem, voltages)
    return contrast + 0.1 * np.exp(-seen / 0.003) * (seen > 1e-6)


BENDS: dict[str, Bend] = {
    "kept": lambda p, contrast, v: contrast,
    "contrast": lambda p, contrast, v: contrast - p.background,  # forgets the background
    "inverted": lambda p, contrast, v: -contrast,
    "unsigned": lambda p, contrast, v: -np.abs(contrast),  # sees every contact as resistive
    "batch": lambda p, contrast, v: contrast * len(v),  # looks at what else is in the batch
    "order": halved_glitches,
    "saturated": saturated,
    "squared": lambda p, contrast, v: contrast * np.abs(contrast),
    "turned": stronger_at_the_top,
    "mirrored": without_mirrors,
    "exploding": lambda p, contrast, v: contrast + 50 * noise(p, v),  # in proportion
    "diverging": lambda p, contrast, v: contrast + 200 * noise(p, v) ** 2,
    "overconfident": sharper_where_quiet,
}
for name, bend in BENDS.items():
    bent(f"contract-{name}", bend)
# Those that say what they cannot do: rightly, no more, of no check, without a reason, unreadably.
TURNED = "rotation_equivariance"
bent("contract-excused", stronger_at_the_top, {TURNED: "sees more at the top"})
bent("contract-outdated", BENDS["kept"], {TURNED: "saw more at the top"})
bent("contract-no-such-check", BENDS["kept"], {"rotation_equivarance": "wrong"})
bent("contract-no-reason", BENDS["kept"], {TURNED: " "})
bent("contract-no-mapping", BENDS["kept"], [TURNED])


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


@register("contract-gain")
class Gain(Sound):
    """Takes a board's numbers for V/A."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) * self.problem.gain - (self.problem.gain - 1)


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
