"""Does a method keep the contract? Small checks that a plugin's own tests can run.

Every check asks a worker process, so a method that hangs or dies fails its checks and nothing else.
"""

import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from eitbench.benchmark.checking import (
    LIMIT_S,
    BrokenError,
    CheckReport,
    RenewedWorker,
    SkippedError,
    all_outcomes,
    require,
)
from eitbench.benchmark.method_worker import (
    Frames,
    Images,
    MethodServant,
    MethodTask,
    scenario_splits,
)
from eitbench.benchmark.process import THREADS
from eitbench.benchmark.worker import Failure, Reply
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
# For methods that exist for certain sensors only, such as those that weights were trained for.
OWN_GRID = SCENARIO.model_copy(update={"image_shape": None, "conductivity_range": None})
# Fractions of the sensor's data range: float32 rounding; iterative methods; "no contrast".
SAME_RUN, SAME_FRAME, NO_CONTRAST = 1e-5, 1e-3, 0.05


class _Subject:
    """The method under test on one problem, in a worker that is renewed when it is lost."""

    def __init__(
        self,
        scenario: SimulatedScenario,
        method: str,
        plugin: Path | None,
        limit_s: float,
        log: Path,
    ) -> None:
        self.sensor = scenario.nominal_sensor
        self.model = scenario.data_model("test")
        self.log = log
        self.reference = self.simulate(np.full(self.model.sensor.image_shape, 1.0))[0]
        task = MethodTask(
            self.sensor, self.reference, scenario_splits(scenario), method, {}, plugin
        )
        self.worker = RenewedWorker(MethodServant(task), limit_s, log)

    def simulate(self, contrast_factor: NDArray[np.float64]) -> Frames:
        """One frame (1, M) of the background times `contrast_factor`, from the finer mesh."""
        with threadpool_limits(THREADS):  # more threads make so small a solve slower
            return self.model.voltages(self.sensor.background * contrast_factor)[None]

    def inclusion(self, factor: float) -> Frames:
        """A frame (1, M) with the conductivity multiplied by `factor` inside a disc."""
        return self.simulate(np.where(_disc(self.model.sensor.image_shape), factor, 1.0))

    @cached_property
    def frames(self) -> Frames:
        """Three different frames (3, M)."""
        return np.concatenate([self.inclusion(0.5), self.inclusion(0.8), self.inclusion(1.3)])

    def ask(self, frames: Frames) -> Reply:
        """What the fitted method answers to `frames`.

        Raises:
            BrokenError: it could not be fitted, hung or died.
        """
        return self.worker.ask("reconstruct", frames)

    @property
    def refuses_sensor(self) -> bool:
        """Whether the method says that it cannot be fitted here."""
        with suppress(BrokenError):
            self.ask(self.reference[None])
        return self.worker.refused("EitbenchError")

    def images(self, frames: Frames) -> Images:
        """Images (n, H, W) of `frames`.

        Raises:
            BrokenError: there are none.
        """
        answer = self.ask(frames)
        if answer.failure is not None:
            raise BrokenError(f"{answer.failure.message}.")
        images: Images = answer.value
        return images


def _disc(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W): a disc off the centre, in fractions of the image."""
    y, x = (np.indices(shape) + 0.5) / np.array(shape)[:, None, None]
    return np.asarray(np.hypot(x - 0.35, y - 0.6) < 0.18)


def _failure(subject: _Subject, kind: str) -> Failure | None:
    """The failure of `kind` that plain frames provoke, if any; another failure breaks the check."""
    failure = subject.ask(subject.frames).failure
    if failure is not None and kind not in failure.kinds:
        raise BrokenError(f"{failure.message}.")
    return failure


def _shape(subject: _Subject) -> None:
    failure = _failure(subject, "shape")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def _dtype(subject: _Subject) -> None:
    failure = _failure(subject, "dtype")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def _unchanged_input(subject: _Subject) -> None:
    failure = _failure(subject, "mutated")
    require(failure is None, "reconstruct changed its input voltages in place: work on a copy.")


def _finite(subject: _Subject) -> None:
    images = subject.images(subject.frames)[:, subject.sensor.mask]
    bad = int((~np.isfinite(images)).sum())
    require(bad == 0, f"{bad} of {images.size} pixels are NaN or infinite.")


def _batch_equals_single(subject: _Subject) -> None:
    frames = subject.frames
    together = subject.images(frames)
    alone = np.concatenate([subject.images(frame[None]) for frame in frames])
    _close(subject, together, alone, SAME_FRAME, "a frame alone and in a batch")


def _deterministic(subject: _Subject) -> None:
    frames = subject.frames
    first = subject.images(frames)
    subject.worker.restart()
    _close(subject, first, subject.images(frames), SAME_RUN, "two fits on the same problem")


def _close(subject: _Subject, one: Images, other: Images, fraction: float, what: str) -> None:
    mask = subject.sensor.mask
    apart = float(np.max(np.abs(one[:, mask] - other[:, mask])))
    allowed = fraction * subject.sensor.data_range
    require(apart <= allowed, f"{what} differ by up to {apart:.3g} S/m; {allowed:.1g} is allowed.")


def _zero_contrast(subject: _Subject) -> None:
    image = subject.images(subject.reference[None])[0]
    off = float(np.max(np.abs(image - subject.sensor.background)[subject.sensor.mask]))
    require(
        off <= NO_CONTRAST * subject.sensor.data_range,
        f"the reference frame gives an image up to {off:.3g} S/m off the background of "
        f"{subject.sensor.background:g} S/m: return absolute conductivity.",
    )


def _resistive(subject: _Subject) -> None:
    inside, outside = _contrast(subject, 0.5)
    require(
        inside < 0 and inside < outside,
        f"where conductivity halves, the mean contrast is {inside:.3g} S/m "
        f"({outside:.3g} elsewhere); it should be negative and lower.",
    )


def _conductive(subject: _Subject) -> None:
    if subject.sensor.conductivity_range[1] <= 1:
        raise SkippedError("on this sensor, conductivity can only fall.")
    inside, outside = _contrast(subject, 1.5)
    require(
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
    require(
        failure is not None and "ValueError" in failure.kinds,
        f"{what} should raise a ValueError that says what is wrong; {advice}",
    )


def _quiet(subject: _Subject) -> None:
    subject.images(subject.frames)
    before = subject.log.stat().st_size
    subject.images(subject.frames)
    text = subject.log.read_text(errors="replace")[before:].strip()
    require(not text, f"reconstruct prints: {text[:80]!r}.")


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


def check_method(name: str, *, plugin: Path | None = None, limit_s: float = LIMIT_S) -> CheckReport:
    """Run every check on the method `name`, taken from the file `plugin` if one is given.

    Args:
        limit_s: seconds that fitting, and each reconstruction, may take.

    Raises:
        InputError: an unknown method (the nearest name is suggested).
    """
    if plugin is None and name not in (known := known_methods()):
        raise unknown_name("method", name, known)
    with tempfile.TemporaryDirectory() as folder:
        subject = _Subject(SCENARIO, name, plugin, limit_s, Path(folder) / "log")
        if subject.refuses_sensor:
            subject = _Subject(OWN_GRID, name, plugin, limit_s, Path(folder) / "log")
        try:
            results = all_outcomes(
                (title, partial(check, subject)) for title, check in CHECKS.items()
            )
        finally:
            subject.worker.restart()
    height, width = subject.sensor.image_shape
    return CheckReport("method", name, f"{subject.sensor.name}, {height} x {width}", results)
