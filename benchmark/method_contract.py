"""Checks of a method's interface: shapes, refusals, and that images depend on frames alone."""

import numpy as np

from eitbench.benchmark.checking import BrokenError, require
from eitbench.benchmark.method_subject import Subject
from eitbench.benchmark.method_worker import Frames
from eitbench.benchmark.worker import Failure

# Fractions of the sensor's data range: what float32 rounds; what an iteration that stops at a
# tolerance may make of sums taken in another order.
SAME_RUN, SAME_FRAME = 1e-5, 1e-3
OTHER_SEED = 12345


def shape(subject: Subject) -> None:
    """Images are (n, H, W)."""
    failure = _failure(subject, "shape")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def dtype(subject: Subject) -> None:
    """Images are real numbers."""
    failure = _failure(subject, "dtype")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def unchanged_input(subject: Subject) -> None:
    """What comes in is the caller's."""
    failure = _failure(subject, "mutated")
    require(failure is None, "reconstruct changed its input voltages in place: work on a copy.")


def _failure(subject: Subject, kind: str) -> Failure | None:
    """The failure of `kind` that plain frames provoke, if any; another failure breaks the check."""
    failure = subject.ask(subject.frames).failure
    if failure is not None and kind not in failure.kinds:
        raise BrokenError(f"{failure.message}.")
    return failure


def finite(subject: Subject) -> None:
    """Every pixel inside the sensor is a number."""
    images = subject.images(subject.frames)[:, subject.sensor.mask]
    bad = int((~np.isfinite(images)).sum())
    require(bad == 0, f"{bad} of {images.size} pixels are NaN or infinite.")


def batch_equals_single(subject: Subject) -> str:
    """An image does not depend on what is asked beside it."""
    frames = subject.frames
    together = subject.images(frames)
    alone = np.concatenate([subject.images(frame[None]) for frame in frames])
    return subject.close(together, alone, SAME_FRAME, "a frame alone and in a batch")


def order(subject: Subject) -> str:
    """Nor on what was asked before it: a batch in another order gives images in that order."""
    frames = subject.frames
    backwards = subject.images(np.ascontiguousarray(frames[::-1]))[::-1]
    what = "images of a batch and of the same frames backwards"
    return subject.close(subject.images(frames), backwards, SAME_FRAME, what)


def deterministic(subject: Subject) -> str:
    """Another process fits the same and sees the same."""
    frames = subject.frames
    first = subject.images(frames)
    subject.worker.restart()
    what = "two fits on the same problem"
    return subject.close(first, subject.again(frames), SAME_RUN, what)


def seed(subject: Subject) -> str:
    """The state of the global generators decides nothing."""
    first = subject.images(subject.contact)
    other = subject.refit(subject.contact, seed=OTHER_SEED)
    what = "images under two seeds of the global generators"
    return subject.close(first, other, SAME_RUN, what)


def random_state(subject: Subject) -> None:
    """Nor does a method change it under those who depend on it."""
    reply = subject.worker.ask("random_state", subject.contact)
    require(reply.failure is None, f"{reply.failure.message}." if reply.failure else "")
    for step, generators in reply.value.items():
        require(
            not generators,
            f"{step} leaves the global generator of {' and '.join(generators)} in another state: "
            "use a generator of your own.",
        )


def wrong_length(subject: Subject) -> None:
    """A frame of another pattern is refused."""
    _refused(subject, subject.frames[:, :-1], "frames with a value too few")


def nan_voltages(subject: Subject) -> None:
    """A frame with a hole is refused."""
    frames = subject.frames.copy()
    frames[1, 0] = np.nan
    _refused(subject, frames, "frames with a NaN")


def _refused(subject: Subject, frames: Frames, what: str) -> None:
    failure = subject.ask(frames).failure
    advice = "Problem.difference(voltages) raises one."
    require(
        failure is not None and "ValueError" in failure.kinds,
        f"{what} should raise a ValueError that says what is wrong; {advice}",
    )
