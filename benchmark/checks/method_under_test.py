"""The method under test on one problem: the frames it is shown, and its worker's service."""

import gc
import os
import random
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import psutil
from numpy.typing import NDArray
from pydantic import StringConstraints, TypeAdapter
from threadpoolctl import threadpool_limits

from eitbench.benchmark.checks.harness import (
    BrokenError,
    CheckWorker,
    answered,
    images_of,
    require,
)
from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.benchmark.workers.messages import Failure, Reply
from eitbench.benchmark.workers.method_service import Frames, MethodService, learning_splits
from eitbench.benchmark.workers.process import PINNED, THREADS
from eitbench.methods.registry import methods
from eitbench.scenarios.arrays import Images
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.symmetry import Motion, motions
from eitbench.scenarios.suites.scenario import SimulatedScenario

# A small image on which electrodes still begin and end at pixel corners, and a finer mesh for data.
SCENARIO = SimulatedScenario(
    name="check",
    image_shape=(40, 40),
    conductivity_range=(0.05, 20.0),  # contacts of both signs are shown
    families=("circle", "rectangle"),
    imperfections=Imperfections(mesh="fine"),
    train=64,
    validation=16,
    test=0,
)
# For methods that exist for certain sensors only, such as those that weights were trained for.
OWN_GRID = SCENARIO.model_copy(update={"image_shape": None, "conductivity_range": None})

GAIN = 1000.0
"""Between V/A and the units of a board: to the numbers that recorded sets hold, about."""

CONTRAST = 0.5
"""Fall of conductivity inside the contact that most checks show."""

# How often one frame is asked for, at most, to see memory grow: for so long [s] of processor time,
# which does not depend on what else the computer does, and so much of the clock for what sleeps.
REPEATS, LEAST_REPEATS, REPEAT_S, WAIT_S = 600, 4, 1.5, 6.0

Statement = Literal["uncertainty", "novelty"]
Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
REASONS = TypeAdapter(dict[str, Reason])


class MethodUnderTest:
    """The method under test on one problem, in a worker that is replaced when it is lost.

    Attributes:
        sensor: the nominal sensor.
        worker: to be asked directly where the same question must be asked again.
        answer: asks it.
        log: file with the output of the method.
        watch: notes of its writes, calls and programs.
        limit_s: seconds that fitting, and each answer, may take.
    """

    def __init__(
        self,
        scenario: SimulatedScenario,
        method: str,
        plugin: Path | None,
        limit_s: float,
        folder: Path,
    ) -> None:
        self.sensor = scenario.nominal_sensor
        self.log = folder / "log"
        self.watch = Watch(folder)
        self.limit_s = limit_s
        self._scenario = scenario
        splits = partial(learning_splits, scenario)
        service = MethodTestService(
            self.sensor, self.reference[0], splits, method, {}, plugin, watch=self.watch
        )
        self.worker = CheckWorker(service, limit_s, self.log)
        self.answer = self.worker.answer
        self._replies: dict[bytes, Reply] = {}

    @property
    def reference(self) -> Frames:
        """The reference frame (1, M)."""
        return self.inclusion(1.0)

    def inclusion(self, factor: float) -> Frames:
        """Return a frame (1, M) with the conductivity multiplied by `factor` inside a disc."""
        return _inclusion(self._scenario, factor)

    @property
    def contact(self) -> Frames:
        """A frame (1, M) of a contact of the contrast `CONTRAST`."""
        return self.inclusion(1 - CONTRAST)

    @cached_property
    def frames(self) -> Frames:
        """Three different frames (3, M)."""
        return np.concatenate([self.contact, self.inclusion(0.8), self.inclusion(1.3)])

    @cached_property
    def motions(self) -> list[Motion]:
        """The symmetries of the nominal sensor; the first changes nothing."""
        model = forward_model(self.sensor)
        return motions(model.sensor, model.jacobian(model.background))

    def ask(self, frames: Frames) -> Reply:
        """Return the answer of the fitted method to `frames`; each is asked for once.

        Raises:
            BrokenError: it could not be fitted, hung or died.
        """
        key = repr(frames.shape).encode() + frames.tobytes()
        if key not in self._replies:
            self._replies[key] = self.worker.request(
                "reconstruct", frames, _of_each(self.reference, frames)
            )
        return self._replies[key]

    @property
    def refuses_sensor(self) -> bool:
        """True if the method says that it cannot be fitted to this sensor."""
        with suppress(BrokenError):
            self.ask(self.frames)
        lost = self.worker.history.lost
        return lost is not None and "EitbenchError" in lost.kinds

    def images(self, frames: Frames) -> Images:
        """Return images (n, H, W) of `frames`.

        Raises:
            BrokenError: there are none.
        """
        return self._images(frames, self.ask(frames))

    def again(self, frames: Frames) -> Images:
        """Return the same, asked for again."""
        references = _of_each(self.reference, frames)
        return self._images(frames, self.worker.request("reconstruct", frames, references))

    def _images(self, frames: Frames, reply: Reply) -> Images:
        return images_of(reply, (len(frames), *self.sensor.image_shape), "reconstruct")

    def stated(self, what: Statement, frames: Frames) -> NDArray[np.float32] | None:
        """Return the uncertainty or novelty that it states of `frames`; None where it has none.

        Raises:
            BrokenError: its shape is wrong, see `Method`.
        """
        references = _of_each(self.reference, frames)
        said = answered(self.worker.request("state", what, frames, references))
        stated: NDArray[np.float32] | None = said.get(what) if isinstance(said, dict) else None
        return stated

    def stated_in_other_units(self, what: Statement, frames: Frames) -> NDArray[np.float32]:
        """Return what another instance states of `frames`, all of whose units are `GAIN` larger."""
        said = answered(self.worker.request("state_in_other_units", frames, GAIN))
        stated: NDArray[np.float32] = said[what]
        return stated

    def refit(
        self, frames: Frames, *, gain: float = 1.0, seed: int | None = None, threads: int = THREADS
    ) -> Images:
        """Return images of `frames` by another instance, see `MethodTestService.refit`."""
        return self._images(frames, self.worker.request("refit", frames, gain, seed, threads))

    def with_other_reference(self, frames: Frames, reference: Frames) -> Images:
        """Return images (2, n, H, W), see `MethodTestService.with_other_reference`."""
        what = "with_other_reference"
        reply = self.worker.request(what, frames, reference)
        return images_of(reply, (2, len(frames), *self.sensor.image_shape), what)

    def contrast(self, frames: Frames) -> NDArray[np.float64]:
        """Return the contrast (n, P) [S/m] of the pixels inside the sensor."""
        images = self.images(frames)[:, self.sensor.mask]
        return np.asarray(images, dtype=np.float64) - self.sensor.background

    def close(self, one: Images, other: Images, fraction: float, what: str) -> str:
        """Require that images differ by no more than a `fraction` of the sensor's data range."""
        mask = self.sensor.mask
        apart = float(np.max(np.abs(one[:, mask] - other[:, mask])))
        allowed = fraction * self.sensor.data_range
        said = f"{what} differ by up to {apart:.2g} S/m; {allowed:.1g} is allowed."
        require(apart <= allowed, said)
        return said


def disc(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask (H, W) of a disc off the centre, in fractions of the image."""
    y, x = (np.indices(shape) + 0.5) / np.array(shape)[:, None, None]
    return np.asarray(np.hypot(x - 0.35, y - 0.6) < 0.18)


# Checks of many methods in one process share what they are shown.
@lru_cache(maxsize=64)
def _inclusion(scenario: SimulatedScenario, factor: float) -> Frames:
    model, background = scenario.data_model("test"), scenario.nominal_sensor.background
    image = np.where(disc(model.sensor.image_shape), factor, 1.0)
    with threadpool_limits(THREADS):  # more threads make so small a solve slower
        frame = model.voltages(background * image)[None]
    frame.setflags(write=False)
    return frame


@dataclass(eq=False, kw_only=True)
class MethodTestService(MethodService):
    """The worker's side: the method, asked for images under chosen conditions and watched."""

    watch: Watch

    def set_up(self) -> Reply:
        """Fit the method."""
        self.watch.begin()
        return super().set_up()

    def expected_failures(self) -> Reply:
        """Return the declaration of its class, which must map names to reasons."""
        declared = methods()[self.method].expected_failures
        return Reply(REASONS.validate_python(declared), 0.0)

    def refit(self, frames: Frames, gain: float, seed: int | None, threads: int) -> Reply:
        """Return images of `frames` by another instance, fitted with the reference times `gain`.

        Args:
            seed: of the global generators while it is fitted and asked; None: as for all requests.
            threads: that libraries may use meanwhile.
        """
        with thread_count(threads):
            if seed is not None:
                seed_generators(seed)
            other = self._other(gain)
            other.set_up()
            limit_threads(threads)  # of libraries that fitting loaded
            return other.reconstruct(frames, _of_each(other.reference[None], frames))

    def state_in_other_units(self, frames: Frames, gain: float) -> Reply:
        """Return images of `frames` times `gain` with what is stated, by another instance."""
        other = self._other(gain)
        other.set_up()
        references = _of_each(other.reference[None], frames)
        return other.reconstruct_and_state(frames * gain, references)

    def with_other_reference(self, frames: Frames, reference: Frames) -> Reply:
        """Return images of `frames` with the `reference` (1, M): measured later, and from the fit.

        Two stacks (2, n, H, W): by the fitted method, which is given it now, and by another
        instance, which is fitted with it.
        """
        references = _of_each(reference, frames)
        later = self.reconstruct(frames, references)
        other = MethodService(self.sensor, reference[0], self.splits, self.method, self.parameters)
        other.set_up()
        begun = other.reconstruct(frames, references)
        failure = later.failure or begun.failure
        if failure is not None:
            return Reply(None, 0.0, failure)
        return Reply(np.stack([later.value, begun.value]), 0.0)

    def random_state(self, frames: Frames) -> Reply:
        """Return the global generators that fitting, and reconstructing, leave in another state."""
        other = self._other(1.0)
        fitting, _ = changed_generators(other.set_up)
        references = _of_each(other.reference[None], frames)
        asking, reply = changed_generators(lambda: other.reconstruct(frames, references))
        if reply.failure is not None:
            return reply
        return Reply({"fit": fitting, "reconstruct": asking}, reply.seconds)

    def state(self, what: Statement, frames: Frames, references: Frames) -> Reply:
        """Return `reconstruct_and_state` of one of the two alone, which may be all that works."""
        return self._images(frames, references, stating=(what,))

    def repeat(self, frame: Frames, again: int = 0) -> Reply:
        """Return how often `frame` (1, M) was reconstructed, and how memory grew by it [MiB]."""
        return memory_growth(lambda: self.reconstruct(frame, self.reference[None]), again)

    def _other(self, gain: float) -> MethodService:
        # The plugin is loaded already.
        reference = self.reference * gain
        return MethodService(self.sensor, reference, self.splits, self.method, self.parameters)


def _of_each(reference: Frames, frames: Frames) -> Frames:
    """Return the reference frame (1, M) of each of `frames` (n, M): the same for all, (n, M)."""
    return np.repeat(reference, len(frames), axis=0)


def memory_growth(ask: Callable[[], Reply], again: int) -> Reply:
    """Return how often `ask` was called, and how memory grew by it [MiB], after some to warm up.

    It is called `again` times, or for a while if that is 0. Growth above `MEMORY_MIB` is to be
    measured again with as many calls: a method that keeps what it sees grows as much once more, an
    allocator that took another arena does not.
    """
    failure = None if again else _repeat(ask, 4)[1]
    before = resident()
    if again:
        calls, answers = again, (ask().failure for _ in range(again))
        later = next((lost for lost in answers if lost is not None), None)
    else:
        calls, later = _repeat(ask, 1)
    return Reply((calls, resident() - before), 0.0, failure or later)


def _repeat(ask: Callable[[], Reply], part: int) -> tuple[int, Failure | None]:
    """Call `ask` for a `part`-th of the time, or until it fails; the calls, and the failure."""
    busy, end = time.process_time() + REPEAT_S / part, time.perf_counter() + WAIT_S / part
    for calls in range(1, REPEATS // part + 1):
        failure = ask().failure
        over = time.process_time() > busy or time.perf_counter() > end
        if failure is not None or (over and calls >= LEAST_REPEATS // min(part, 2)):
            break
    return calls, failure


def resident() -> float:
    """Return the resident memory of this process [MiB] after a garbage collection."""
    gc.collect()
    return float(psutil.Process().memory_info().rss) / 2**20


@contextmanager
def thread_count(threads: int) -> Iterator[None]:
    """Let BLAS, OpenMP and torch use so many threads, also those that are loaded meanwhile."""
    try:
        os.environ.update(dict.fromkeys(PINNED, str(threads)))
        limit_threads(threads)
        yield
    finally:
        os.environ.update(PINNED)
        limit_threads(THREADS)


def limit_threads(threads: int) -> None:
    """Let libraries that are loaded use so many threads."""
    threadpool_limits(threads)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def seed_generators(seed: int) -> None:
    """Seed every global generator."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def changed_generators(action: Callable[[], Reply]) -> tuple[list[str], Reply]:
    """Return the global generators that `action` leaves in another state, and its reply."""
    before = _generators()
    reply = action()
    after = _generators()
    return [name for name, state in before.items() if state != after[name]], reply


def _generators() -> dict[str, Any]:
    """Return the state of every global generator, as values that can be compared."""
    kind, keys, *position = np.random.get_state(legacy=True)  # noqa: NPY002
    states: dict[str, Any] = {
        "random": random.getstate(),
        "numpy.random": (kind, np.asarray(keys).tobytes(), *position),
    }
    if "torch" in sys.modules:
        states["torch"] = sys.modules["torch"].get_rng_state().numpy().tobytes()
    return states
