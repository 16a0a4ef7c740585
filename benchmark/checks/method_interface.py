"""Checks of a method's interface: shapes, refusals, and images that depend on frames alone."""

import numpy as np

from eitbench.benchmark.checks.harness import BrokenError, require, require_answer
from eitbench.benchmark.checks.method_under_test import MethodUnderTest
from eitbench.benchmark.workers.method_service import Frames
from eitbench.benchmark.workers.worker import Failure

# Fractions of the sensor's data range: what float32 rounds; what an iteration that stops at a
# tolerance may make of sums taken in another order.
SAME_RUN, SAME_FRAME = 1e-5, 1e-3
OTHER_SEED = 12345


def shape(tested: MethodUnderTest) -> None:
    """Require images (n, H, W)."""
    failure = _failure(tested, "shape")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def dtype(tested: MethodUnderTest) -> None:
    """Require real numbers."""
    failure = _failure(tested, "dtype")
    require(failure is None, f"reconstruct {failure.message}." if failure else "")


def unchanged_input(tested: MethodUnderTest) -> None:
    """Require that the input voltages stay as they are."""
    failure = _failure(tested, "mutated")
    require(failure is None, "reconstruct changed its input voltages in place: work on a copy.")


def _failure(tested: MethodUnderTest, kind: str) -> Failure | None:
    """Return the failure of `kind` that plain frames cause, if any; another breaks the check."""
    failure = tested.ask(tested.frames).failure
    if failure is not None and kind not in failure.kinds:
        raise BrokenError(f"{failure.message}.")
    return failure


def finite(tested: MethodUnderTest) -> None:
    """Require a finite number in every pixel inside the sensor."""
    images = tested.images(tested.frames)[:, tested.sensor.mask]
    bad = int((~np.isfinite(images)).sum())
    require(bad == 0, f"{bad} of {images.size} pixels are NaN or infinite.")


def batch_equals_single(tested: MethodUnderTest) -> str:
    """Require that an image does not depend on the other frames of its batch."""
    frames = tested.frames
    together = tested.images(frames)
    alone = np.concatenate([tested.images(frame[None]) for frame in frames])
    return tested.close(together, alone, SAME_FRAME, "a frame alone and in a batch")


def order(tested: MethodUnderTest) -> str:
    """Require that a batch in another order gives the same images in that order."""
    frames = tested.frames
    backwards = tested.images(np.ascontiguousarray(frames[::-1]))[::-1]
    what = "images of a batch and of the same frames backwards"
    return tested.close(tested.images(frames), backwards, SAME_FRAME, what)


def deterministic(tested: MethodUnderTest) -> str:
    """Require the same images from another process."""
    frames = tested.frames
    first = tested.images(frames)
    tested.worker.renew()
    what = "two fits on the same problem"
    return tested.close(first, tested.again(frames), SAME_RUN, what)


def seed(tested: MethodUnderTest) -> str:
    """Require images that do not depend on the state of the global generators."""
    first = tested.images(tested.contact)
    other = tested.refit(tested.contact, seed=OTHER_SEED)
    what = "images under two seeds of the global generators"
    return tested.close(first, other, SAME_RUN, what)


def random_state(tested: MethodUnderTest) -> None:
    """Require that the global generators stay as they are, as others depend on them."""
    reply = require_answer(tested.worker.request("random_state", tested.contact))
    for step, generators in reply.value.items():
        require(
            not generators,
            f"{step} leaves the global generator of {' and '.join(generators)} in another state: "
            "use a generator of your own.",
        )


def wrong_length(tested: MethodUnderTest) -> None:
    """Require a `ValueError` for a frame of another pattern."""
    _refused(tested, tested.frames[:, :-1], "frames with a value too few")


def nan_voltages(tested: MethodUnderTest) -> None:
    """Require a `ValueError` for a frame with a NaN."""
    frames = tested.frames.copy()
    frames[1, 0] = np.nan
    _refused(tested, frames, "frames with a NaN")


def _refused(tested: MethodUnderTest, frames: Frames, what: str) -> None:
    failure = tested.ask(frames).failure
    advice = "Problem.difference(voltages) raises one."
    require(
        failure is not None and "ValueError" in failure.kinds,
        f"{what} should raise a ValueError that says what is wrong; {advice}",
    )
