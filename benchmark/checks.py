"""Does a method keep the contract? Small checks that a plugin's own tests can run.

Every check asks a worker process, so a method that hangs or dies fails its checks and nothing else.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from eitbench.benchmark.process import THREADS
from eitbench.benchmark.worker import (
    Failure,
    Frames,
    Images,
    Reply,
    Task,
    Worker,
    WorkerLostError,
    plugin_methods,
    scenario_splits,
    serve_method,
)
from eitbench.methods.registry import methods as known_methods
from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.scenario import SimulatedScenario

# A small image on which electrodes still begin and end at pixel corners, and a finer mesh for data.
SCENARIO = SimulatedScenario(
    name="check",
    image_shape=(40, 40),
    conductivity_range=(0.05, 20.0),  # contacts of both signs are shown
    families=("circle", "rectangle"),
    mesh_refinement=2,
    train=64,
    validation=16,
    test=0,
)
LIMIT_S = 60.0
# Fractions of the sensor's data range: float32 rounding; iterative methods; "no contrast".
SAME_RUN, SAME_FRAME, NO_CONTRAST = 1e-5, 1e-3, 0.05


@dataclass(frozen=True)
class CheckResult:
    """One check; `message` says what was wrong, or is empty."""

    name: str
    passed: bool
    message: str = ""


@dataclass(frozen=True)
class CheckReport:
    """Every check of one method."""

    method: str
    results: tuple[CheckResult, ...]

    @property
    def failed(self) -> tuple[CheckResult, ...]:
        """The checks that did not pass."""
        return tuple(result for result in self.results if not result.passed)

    @property
    def passed(self) -> bool:
        """Whether all passed."""
        return not self.failed

    def describe(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            "method": self.method,
            "ran": len(self.results),
            "failed": len(self.failed),
            "checks": [vars(result) for result in self.results],
        }

    def summary(self) -> str:
        """One line: how many ran, passed and failed."""
        ran, failed = len(self.results), len(self.failed)
        return f"{self.method}: {ran} checks ran, {ran - failed} passed, {failed} failed."


class _BrokenError(Exception):
    """A check's finding, as a sentence."""


class _Subject:
    """The method under test on the small problem, in a worker that is renewed when it is lost."""

    def __init__(self, method: str, plugin: Path | None, limit_s: float, log: Path) -> None:
        self.sensor = SCENARIO.nominal_sensor
        self.limit_s = limit_s
        self.log = log
        self.reference = self.simulate(np.full(SCENARIO.data_model.sensor.image_shape, 1.0))[0]
        self._task = Task(
            self.sensor,
            self.reference,
            scenario_splits(SCENARIO),
            method,
            {},
            plugin,
        )
        self._worker: Worker | None = None
        self._given_up = ""

    def simulate(self, contrast_factor: NDArray[np.float64]) -> Frames:
        """One frame (1, M) of the background times `contrast_factor`, from the finer mesh."""
        with threadpool_limits(THREADS):  # more threads make so small a solve slower
            return SCENARIO.data_model.voltages(self.sensor.background * contrast_factor)[None]

    def inclusion(self, factor: float) -> Frames:
        """A frame (1, M) with the conductivity multiplied by `factor` inside a disc."""
        return self.simulate(np.where(_disc(SCENARIO.data_model.sensor.image_shape), factor, 1.0))

    @cached_property
    def frames(self) -> Frames:
        """Three different frames (3, M)."""
        return np.concatenate([self.inclusion(0.5), self.inclusion(0.8), self.inclusion(1.3)])

    def ask(self, frames: Frames) -> Reply:
        """What the fitted method answers to `frames`.

        Raises:
            _BrokenError: it could not be fitted, hung or died; one that cannot be fitted or hangs
                is not tried again.
        """
        if self._given_up:
            raise _BrokenError(self._given_up)
        try:
            if self._worker is None:
                self._worker = self._fitted()
            return self._worker.ask("reconstruct", frames, limit=self.limit_s, what="reconstruct")
        except WorkerLostError as lost:
            self.restart()
            if lost.failure.status == "timeout":
                self._given_up = f"{lost.failure.message}."
            raise _BrokenError(f"{lost.failure.message}.") from lost

    def _fitted(self) -> Worker:
        worker = Worker(serve_method, self._task, log=self.log)
        try:
            reply = worker.ask("fit", limit=self.limit_s, what="fit")
        except WorkerLostError as lost:
            self._given_up = f"{lost.failure.message}."
            raise
        if reply.failure is not None:
            worker.close()
            self._given_up = f"fit failed with {reply.failure.message}."
            raise _BrokenError(self._given_up)
        return worker

    def images(self, frames: Frames) -> Images:
        """Images (n, H, W) of `frames`.

        Raises:
            _BrokenError: there are none.
        """
        answer = self.ask(frames)
        if answer.failure is not None:
            raise _BrokenError(f"{answer.failure.message}.")
        images: Images = answer.value
        return images

    def restart(self) -> None:
        """Forget the worker; the next question starts and fits another."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None


def _disc(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W): a disc off the centre, in fractions of the image."""
    y, x = (np.indices(shape) + 0.5) / np.array(shape)[:, None, None]
    return np.asarray(np.hypot(x - 0.35, y - 0.6) < 0.18)


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise _BrokenError(sentence)


def _failure(subject: _Subject, kind: str) -> Failure | None:
    """The failure of `kind` that plain frames provoke, if any; another failure breaks the check."""
    failure = subject.ask(subject.frames).failure
    if failure is not None and kind not in failure.kinds:
        raise _BrokenError(f"{failure.message}.")
    return failure


def _shape(subject: _Subject) -> None:
    failure = _failure(subject, "shape")
    _require(failure is None, f"reconstruct {failure.message}." if failure else "")


def _dtype(subject: _Subject) -> None:
    failure = _failure(subject, "dtype")
    _require(failure is None, f"reconstruct {failure.message}." if failure else "")


def _unchanged_input(subject: _Subject) -> None:
    failure = _failure(subject, "mutated")
    _require(failure is None, "reconstruct changed its input voltages in place: work on a copy.")


def _finite(subject: _Subject) -> None:
    images = subject.images(subject.frames)[:, subject.sensor.mask]
    bad = int((~np.isfinite(images)).sum())
    _require(bad == 0, f"{bad} of {images.size} pixels are NaN or infinite.")


def _batch_equals_single(subject: _Subject) -> None:
    frames = subject.frames
    together = subject.images(frames)
    alone = np.concatenate([subject.images(frame[None]) for frame in frames])
    _close(subject, together, alone, SAME_FRAME, "a frame alone and in a batch")


def _deterministic(subject: _Subject) -> None:
    frames = subject.frames
    first = subject.images(frames)
    subject.restart()
    _close(subject, first, subject.images(frames), SAME_RUN, "two fits on the same problem")


def _close(subject: _Subject, one: Images, other: Images, fraction: float, what: str) -> None:
    mask = subject.sensor.mask
    apart = float(np.max(np.abs(one[:, mask] - other[:, mask])))
    allowed = fraction * subject.sensor.data_range
    _require(apart <= allowed, f"{what} differ by up to {apart:.3g} S/m; {allowed:.1g} is allowed.")


def _zero_contrast(subject: _Subject) -> None:
    image = subject.images(subject.reference[None])[0]
    off = float(np.max(np.abs(image - subject.sensor.background)[subject.sensor.mask]))
    _require(
        off <= NO_CONTRAST * subject.sensor.data_range,
        f"the reference frame gives an image up to {off:.3g} S/m off the background of "
        f"{subject.sensor.background:g} S/m: return absolute conductivity.",
    )


def _resistive(subject: _Subject) -> None:
    inside, outside = _contrast(subject, 0.5)
    _require(
        inside < 0 and inside < outside,
        f"where conductivity halves, the mean contrast is {inside:.3g} S/m "
        f"({outside:.3g} elsewhere); it should be negative and lower.",
    )


def _conductive(subject: _Subject) -> None:
    inside, outside = _contrast(subject, 1.5)
    _require(
        inside > 0 and inside > outside,
        f"where conductivity is 1.5 times higher, the mean contrast is {inside:.3g} S/m "
        f"({outside:.3g} elsewhere); it should be positive and higher.",
    )


def _contrast(subject: _Subject, factor: float) -> tuple[float, float]:
    image = subject.images(subject.inclusion(factor))[0] - subject.sensor.background
    disc, mask = _disc(subject.sensor.image_shape), subject.sensor.mask
    return float(image[disc & mask].mean()), float(image[~disc & mask].mean())


def _wrong_length(subject: _Subject) -> None:
    _refused(subject, subject.frames[:, :-1], "frames with a value too few")


def _nan_voltages(subject: _Subject) -> None:
    frames = subject.frames.copy()
    frames[1, 0] = np.nan
    _refused(subject, frames, "frames with a NaN")


def _refused(subject: _Subject, frames: Frames, what: str) -> None:
    failure = subject.ask(frames).failure
    advice = "Problem.difference(voltages) raises one."
    _require(
        failure is not None and "ValueError" in failure.kinds,
        f"{what} should raise a ValueError that says what is wrong; {advice}",
    )


def _quiet(subject: _Subject) -> None:
    subject.images(subject.frames)
    before = subject.log.stat().st_size
    subject.images(subject.frames)
    text = subject.log.read_text(errors="replace")[before:].strip()
    _require(not text, f"reconstruct prints: {text[:80]!r}.")


CHECKS: dict[str, Callable[[_Subject], None]] = {
    "returns (n, H, W)": _shape,
    "returns real numbers": _dtype,
    "returns finite values": _finite,
    "a batch equals its single frames": _batch_equals_single,
    "the same twice": _deterministic,
    "leaves its input unchanged": _unchanged_input,
    "zero contrast gives the background": _zero_contrast,
    "a resistive contact is negative": _resistive,
    "a conductive contact is positive": _conductive,
    "refuses frames of the wrong length": _wrong_length,
    "refuses frames with NaN": _nan_voltages,
    "prints nothing": _quiet,
}


def check_target(target: str) -> list[CheckReport]:
    """Check a method by name, or every method that the file `target` (.py) registers.

    Raises:
        InputError: an unknown method, or a file that does not load.
    """
    if not target.endswith(".py"):
        return [check_method(target)]
    plugin = Path(target).resolve()
    return [check_method(name, plugin=plugin) for name in plugin_methods(plugin)]


def check_method(name: str, *, plugin: Path | None = None, limit_s: float = LIMIT_S) -> CheckReport:
    """Run every check on the method `name`, taken from the file `plugin` if one is given.

    Args:
        limit_s: seconds that fitting, and each reconstruction, may take.

    Raises:
        InputError: an unknown method (the nearest name is suggested).
    """
    if plugin is None and name not in (known := known_methods()):
        raise unknown_name("method", name, known)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        subject = _Subject(name, plugin, limit_s, Path(folder) / "log")
        try:
            for title, check in CHECKS.items():
                try:
                    check(subject)
                except _BrokenError as broken:
                    results.append(CheckResult(title, False, str(broken)))
                else:
                    results.append(CheckResult(title, True))
        finally:
            subject.restart()
    return CheckReport(name, tuple(results))
