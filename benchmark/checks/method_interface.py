"""Checks of a method's interface and process.

Shapes, refusals, images that depend on frames alone; output, threads, memory, time, files, network
and programs.
"""

import numpy as np

from eitbench.benchmark.checks.harness import BrokenError, require, require_answer
from eitbench.benchmark.checks.method_under_test import Growth, MethodUnderTest
from eitbench.benchmark.workers.audit_hook import Kind
from eitbench.benchmark.workers.method_service import Frames
from eitbench.benchmark.workers.worker import Failure

# Fractions of the sensor's data range: what float32 rounds; what an iteration that stops at a
# tolerance may make of sums taken in another order.
SAME_RUN, SAME_FRAME = 1e-5, 1e-3
OTHER_SEED = 12345
MEMORY_MIB = 4.0
"""Allowed growth of memory, which allocators keep for later.

It is two huge pages of Linux. A method that keeps its images of 40 x 40 pixels grows by 7 MiB over
600 frames; a slow one is asked for fewer, so that it has to keep more of each to be found.
"""

BATCH = 8


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


def quiet(tested: MethodUnderTest) -> None:
    """Require that nothing is printed, as it would stand between others' output."""
    tested.images(tested.contact)
    before = tested.log.stat().st_size
    tested.again(tested.contact)
    text = tested.log.read_text(errors="replace")[before:].strip()
    require(not text, f"reconstruct prints: {text[:80]!r}.")


def threads(tested: MethodUnderTest) -> str:
    """Require the same images on two threads as on one."""
    one = tested.again(tested.contact)
    two = tested.refit(tested.contact, threads=2)
    return tested.close(one, two, SAME_FRAME, "images made on one thread and on two")


def memory(tested: MethodUnderTest) -> str:
    """Require that frames leave nothing in memory."""
    tested.images(tested.contact)
    growth: Growth = require_answer(tested.worker.request("repeat", tested.contact)).value
    said = (
        f"memory grows by {max(growth.mib, 0.0):.2g} MiB over {growth.calls} frames; "
        f"{MEMORY_MIB:g} is allowed."
    )
    require(growth.mib <= MEMORY_MIB, said)
    return said


def no_network(tested: MethodUnderTest) -> None:
    """Require that no network is used."""
    _require_unseen(tested, "network", "it uses the network", "methods work without one")


def no_writing(tested: MethodUnderTest) -> None:
    """Require that files are written to the temporary folder or eitbench's cache only."""
    advice = "`tempfile` and eitbench's cache are where a method may write"
    _require_unseen(tested, "write", "it writes or changes files elsewhere", advice)


def no_programs(tested: MethodUnderTest) -> None:
    """Require that no other program is started, as no check can see what it does."""
    advice = "what they do is not seen, so that a reason is needed"
    _require_unseen(tested, "program", "it starts other programs", advice)


def _require_unseen(tested: MethodUnderTest, kind: Kind, what: str, advice: str) -> None:
    """Require that nothing of the `kind` was noted while the method was loaded, fitted, asked."""
    tested.images(tested.contact)
    noted = tested.watch.noted(kind)
    more = f" and {len(noted) - 1} more" if len(noted) > 1 else ""
    require(not noted, f"{what} ({noted[0]}{more}): {advice}." if noted else "")


def in_time(tested: MethodUnderTest) -> str:
    """Require an answer to a batch within the limit."""
    factors = np.linspace(0.4, 0.9, BATCH)
    frames = np.concatenate([tested.inclusion(float(factor)) for factor in factors])
    reply = require_answer(tested.worker.request("reconstruct", frames))
    fit_s = tested.worker.request("fit_s").value
    return (
        f"fitted in {fit_s:.2g} s, {BATCH} frames in {reply.seconds:.2g} s; "
        f"{tested.limit_s:g} s each are allowed."
    )
