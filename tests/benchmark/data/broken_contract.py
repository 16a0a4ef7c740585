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


def kept(_: Problem, contrast: Array, __: Array) -> Array:
    """Change nothing."""
    return contrast


def broken(
    name: str,
    bend: Bend = kept,
    given: Callable[[Problem, Array], Array] = lambda problem, voltages: voltages,
    factor: Callable[[], float] = lambda: 1.0,
    expected: Any = None,
) -> None:
    """Register a method that does something to the contrast of a sound one.

    It may change the voltages that it is given, too, and take a factor of the contrast from
    elsewhere as it is fitted.
    """

    class Broken(Sound):
        expected_failures = expected or {}

        def fit(self, problem: Problem) -> None:
            super().fit(problem)
            self.spread = self.spread * factor()

        def reconstruct(self, voltages: Array) -> Array:
            background = self.problem.background
            contrast = super().reconstruct(given(self.problem, voltages)) - background
            return background + bend(self.problem, contrast, voltages)

    register(f"contract-{name}")(Broken)


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
    violation = np.linalg.norm(second - first * pattern.reciprocal_signs(pairs), axis=1)
    return np.asarray((violation / np.linalg.norm(voltages, axis=1))[:, None, None])


def sharper_where_quiet(problem: Problem, contrast: Array, voltages: Array) -> Array:
    """Add detail where there is little noise."""
    seen = noise(problem, voltages)
    return contrast + 0.1 * np.exp(-seen / 0.003) * (seen > 1e-6)


def with_hole(_: Problem, contrast: Array, __: Array) -> Array:
    """Have no value for a pixel."""
    contrast[:, 3, 3] = np.nan
    return contrast


BENDS: dict[str, Bend] = {
    "kept": kept,
    "contrast": lambda p, contrast, v: contrast - p.background,  # forgets the background
    "inverted": lambda p, contrast, v: -contrast,
    "unsigned": lambda p, contrast, v: -np.abs(contrast),  # sees every contact as resistive
    "batch": lambda p, contrast, v: contrast * len(v),  # looks at what else is in the batch
    "order": halved_glitches,
    "saturated": saturated,
    "squared": lambda p, contrast, v: contrast * np.abs(contrast),
    "turned": stronger_at_the_top,
    "mirrored": without_mirrors,
    # Takes a board's numbers for V/A.
    "gain": lambda p, contrast, v: (contrast + p.background) * p.gain - p.gain + 1 - p.background,
    "hole": with_hole,
    "exploding": lambda p, contrast, v: contrast + 50 * noise(p, v),  # in proportion
    "diverging": lambda p, contrast, v: contrast + 200 * noise(p, v) ** 2,
    "overconfident": sharper_where_quiet,
}
for name, bend in BENDS.items():
    broken(name, bend)
# Those that say what they cannot do: rightly, no more, of no check, without a reason, unreadably.
TURNED = "rotation_equivariance"
broken("excused", stronger_at_the_top, expected={TURNED: "sees more at the top"})
broken("outdated", expected={TURNED: "saw more at the top"})
broken("no-such-check", expected={"rotation_equivarance": "wrong"})
broken("no-reason", expected={TURNED: " "})
broken("no-mapping", expected=[TURNED])


def drawn_and_put_back() -> float:
    """Draw from a global generator, and put it back."""
    state = random.getstate()
    drawn = random.random()
    random.setstate(state)
    return 1 + drawn


def drawn_after_seeding() -> float:
    """Seed a global generator for its own purposes."""
    np.random.seed(7)  # noqa: NPY002
    return float(1 + np.random.rand())  # noqa: NPY002


def network() -> float:
    """Ask a server, and do without where there is none."""
    with suppress(OSError):
        socket.create_connection(("127.0.0.1", 9), timeout=0.1).close()
    return 1.0


broken("random", factor=lambda: 1 + os.getpid() % 97)  # another number in every process
broken("seed", factor=drawn_and_put_back)
broken("leak", factor=drawn_after_seeding)
broken("threads", factor=lambda: max(pool["num_threads"] for pool in threadpool_info()))
broken("network", factor=network)
broken("starts", factor=lambda: 1.0 + os.system("exit"))  # noqa: S605, S607


def padded(problem: Problem, voltages: Array) -> Array:
    """Pad frames that are too short."""
    missing = len(problem.reference) - voltages.shape[1]
    return np.pad(voltages, ((0, 0), (0, missing)))


def noted(_: Problem, voltages: Array) -> Array:
    """Keep a diary where it likes."""
    Path(os.environ["TOY_DIARY"]).write_text("reconstructed")
    return voltages


def stuck(_: Problem, voltages: Array) -> Array:
    """Be stuck on a long batch, and not be asked to stop."""
    if len(voltages) > 6:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)
        while True:
            time.sleep(1)
    return voltages


broken("short", given=padded)
broken("nan", given=lambda p, voltages: np.nan_to_num(voltages))  # takes a NaN for zero
broken("writes", given=noted)
broken("slow", given=stuck)


@register("contract-own-grid")
class OwnGrid(Sound):
    """Keeps every promise where it exists: for the sensor's own image grid."""

    def fit(self, problem: Problem) -> None:
        if problem.mask.shape != (80, 80):
            raise InputError("There are weights for 80 x 80 pixels only.")
        super().fit(problem)


@register("contract-reference")
class FirstReference(Sound):
    """Takes the reference frame of its fit for that of every frame."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.first = problem.reference

    def reconstruct(self, voltages: Array) -> Array:
        self.problem.reference = self.first
        return super().reconstruct(voltages)


@register("contract-keeps")
class Keeps(Sound):
    """Keeps every image it ever made."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.made: list[Array] = []

    def reconstruct(self, voltages: Array) -> Array:
        self.made.append(super().reconstruct(voltages))
        return self.made[-1]


@register("contract-late")
class Late(Sound):
    """Takes a large workspace once, long after the first frame, and keeps it."""

    asked = 0

    def reconstruct(self, voltages: Array) -> Array:
        self.asked += 1
        if self.asked == 300:
            self.workspace = np.ones(2**20)
        return super().reconstruct(voltages)


@register("contract-doubts")
class Doubts(Sound):
    """Keeps every promise, that on its uncertainty, too."""

    def uncertainty(self, voltages: Array) -> Array:
        return 0.01 + np.abs(self.reconstruct(voltages) - self.problem.background) / 2


@register("contract-wary")
class Wary(Sound):
    """Keeps every promise, that on its novelty, too."""

    def novelty(self, voltages: Array) -> Array:
        contrast = np.abs(self.reconstruct(voltages) - self.problem.background)
        return np.asarray(contrast.mean(axis=(1, 2)))


@register("contract-compares")
class Compares(Sound):
    """Scores frames by their neighbours in the batch."""

    def novelty(self, voltages: Array) -> Array:
        return np.argsort(np.argsort(np.linalg.norm(voltages, axis=1))).astype(float)


@register("contract-in-volts")
class InVolts(Sound):
    """Scores frames by their size, in whatever unit."""

    def novelty(self, voltages: Array) -> Array:
        return np.asarray(np.linalg.norm(voltages - self.problem.reference, axis=1))


@register("contract-indifferent")
class Indifferent(Sound):
    """Scores all frames alike."""

    def novelty(self, voltages: Array) -> Array:
        return np.full(len(voltages), 0.5)


@register("contract-speechless")
class Speechless(Sound):
    """Has no score of a weak touch."""

    def novelty(self, voltages: Array) -> Array:
        contrast = np.abs(self.reconstruct(voltages) - self.problem.background)
        return np.asarray(np.log(contrast.max(axis=(1, 2)) - 0.2))


@register("contract-negative")
class Negative(Sound):
    """States standard deviations with a sign."""

    def uncertainty(self, voltages: Array) -> Array:
        return self.reconstruct(voltages) - self.problem.background


@register("contract-certain")
class Certain(Sound):
    """Is sure of everything."""

    def uncertainty(self, voltages: Array) -> Array:
        return 0 * self.reconstruct(voltages)


@register("contract-beyond")
class Beyond(Sound):
    """Draws values that no run takes."""

    def uncertainty(self, voltages: Array) -> Array:
        return np.repeat(0 * self.reconstruct(voltages)[:, None] + 1e9, 39, axis=1)


@register("contract-few")
class Few(Sound):
    """Draws five images only."""

    def uncertainty(self, voltages: Array) -> Array:
        return np.repeat(self.reconstruct(voltages)[:, None], 5, axis=1)


@register("contract-wavering")
class Wavering(Sound):
    """States something else each time."""

    asked = 0

    def uncertainty(self, voltages: Array) -> Array:
        self.asked += 1
        return 0 * self.reconstruct(voltages) + 0.1 * self.asked


@register("contract-neighbour")
class Neighbour(Sound):
    """States of every frame what it states of the first one beside it."""

    def uncertainty(self, voltages: Array) -> Array:
        images = self.reconstruct(voltages)
        away = np.abs(images - self.problem.background)
        return np.full_like(away, away[0].max())
