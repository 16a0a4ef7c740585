"""The worker's side of a method that is checked: asked for images under chosen conditions."""

import gc
import os
import random
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import psutil
from threadpoolctl import threadpool_limits

from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.benchmark.workers.method_service import Frames, MethodService, MethodSpec
from eitbench.benchmark.workers.process import PINNED, THREADS
from eitbench.benchmark.workers.worker import Failure, Reply
from eitbench.methods.registry import methods

# How often one frame is asked for, at most, and for how long, to see memory grow.
REPEATS, LEAST_REPEATS, REPEAT_S = 600, 4, 0.4


class Growth(NamedTuple):
    """What resident memory did over repeated reconstructions of one frame.

    Attributes:
        calls: how many were made, after some to warm up.
        mib: by how much memory grew [MiB].
    """

    calls: int
    mib: float


class MethodTestService(MethodService):
    """Makes, fits and asks the method of a task, in a process that is watched."""

    def __init__(self, task: MethodSpec, watch: Watch) -> None:
        super().__init__(task)
        self._watch = watch
        self._fit_s = 0.0

    def set_up(self) -> Reply:
        """Fit the method."""
        self._watch.begin()
        reply = super().set_up()
        self._fit_s = reply.seconds
        return reply

    def fit_s(self) -> Reply:
        """How long fitting took [s]."""
        return Reply(self._fit_s, 0.0)

    def expected_failures(self) -> Reply:
        """What its class declares, if it is a mapping of names to reasons; else None."""
        declared = methods()[self.task.method].expected_failures
        try:
            plain = dict(declared)
        except (TypeError, ValueError):
            return Reply(None, 0.0)
        texts = all(isinstance(text, str) for pair in plain.items() for text in pair)
        return Reply(plain if texts else None, 0.0)

    def refit(self, frames: Frames, gain: float, seed: int | None, threads: int) -> Reply:
        """Images of `frames` by another of its kind, fitted to the reference frame times `gain`.

        Args:
            seed: of the global generators while it is fitted and asked; None: as for all requests.
            threads: that libraries may use meanwhile.
        """
        with _thread_count(threads):
            if seed is not None:
                random.seed(seed)
                np.random.seed(seed)  # noqa: NPY002
                if "torch" in sys.modules:
                    sys.modules["torch"].manual_seed(seed)
            other = self._other(gain)
            other.set_up()
            _limit_threads(threads)  # of libraries that fitting loaded
            return other.reconstruct(frames)

    def random_state(self, frames: Frames) -> Reply:
        """Which global generators fitting, and then reconstructing, leaves in another state."""
        other = self._other(1.0)
        fitting, _ = _changed_generators(other.set_up)
        asking, reply = _changed_generators(lambda: other.reconstruct(frames))
        if reply.failure is not None:
            return reply
        return Reply({"fit": fitting, "reconstruct": asking}, reply.seconds)

    def repeat(self, frame: Frames) -> Reply:
        """The `Growth` of memory while `frame` (1, M) is reconstructed again and again."""
        _, failure = self._repeat(frame, REPEATS // 4, LEAST_REPEATS // 2, REPEAT_S / 4)
        before = _resident()
        calls, later = self._repeat(frame, REPEATS, LEAST_REPEATS, REPEAT_S)
        return Reply(Growth(calls, _resident() - before), 0.0, failure or later)

    def _repeat(
        self, frame: Frames, most: int, least: int, seconds: float
    ) -> tuple[int, Failure | None]:
        end = time.perf_counter() + seconds
        calls = 0
        while calls < least or (calls < most and time.perf_counter() < end):
            failure = self.reconstruct(frame).failure
            calls += 1
            if failure is not None:
                return calls, failure
        return calls, None

    def _other(self, gain: float) -> MethodService:
        # The plugin is loaded already.
        return MethodService(replace(self.task, reference=self.task.reference * gain, plugin=None))


def _resident() -> float:
    """Resident memory of this process [MiB] without what Python is about to free."""
    gc.collect()
    return float(psutil.Process().memory_info().rss) / 2**20


@contextmanager
def _thread_count(threads: int) -> Iterator[None]:
    """BLAS, OpenMP and torch, loaded already or meanwhile, use so many threads."""
    try:
        os.environ.update(dict.fromkeys(PINNED, str(threads)))
        _limit_threads(threads)
        yield
    finally:
        os.environ.update(PINNED)
        _limit_threads(THREADS)


def _limit_threads(threads: int) -> None:
    threadpool_limits(threads)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(threads)


def _changed_generators(action: Callable[[], Reply]) -> tuple[list[str], Reply]:
    """The global generators that `action` leaves in another state, and what it answers."""
    before = _generators()
    reply = action()
    after = _generators()
    return [name for name, state in before.items() if state != after[name]], reply


def _generators() -> dict[str, Any]:
    """The state of every global generator, as values that can be compared."""
    kind, keys, *position = np.random.get_state(legacy=True)  # noqa: NPY002
    states: dict[str, Any] = {
        "random": random.getstate(),
        "numpy.random": (kind, np.asarray(keys).tobytes(), *position),
    }
    if "torch" in sys.modules:
        states["torch"] = sys.modules["torch"].get_rng_state().numpy().tobytes()
    return states
