"""The method of places under test on a simulated skin, and the service of its worker."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from eitbench.benchmark.checks.harness import CheckWorker, array_of, require
from eitbench.benchmark.checks.method_under_test import (
    REASONS,
    changed_generators,
    limit_threads,
    memory_growth,
    seed_generators,
    thread_count,
)
from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.method_service import Frames
from eitbench.benchmark.workers.place_service import PlaceService
from eitbench.methods.registry import PLACE_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.transfer import Learnable, Presses
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.suites.scenario import SimulatedScenario

SCENARIO = SimulatedScenario(
    name="check-places",
    image_shape=(40, 40),
    families=("circle",),
    imperfections=Imperfections(mesh="fine"),
    train=64,
    validation=120,
    test=0,
)
LABELLED, LOCATED = 60, 40
GAIN = 1e-3
"""Units of the board per V/A, which no method is told."""


@lru_cache(maxsize=1)
def skin() -> tuple[Learnable, Presses]:
    """What is given of the skin, with labelled presses and another skin, and what is located."""
    simulated = load(SCENARIO, "validation")
    other = load(SCENARIO, "train")
    presses, seen = _presses(simulated, GAIN), _presses(other, 1.0)
    given = Learnable(
        simulated.sensor,
        GAIN * simulated.references[0],
        presses[:LABELLED],
        presses.differences[:-LOCATED],
        {"another": seen},
    )
    return given, presses[-LOCATED:]


def _presses(data: Dataset, gain: float) -> Presses:
    assert data.conductivity is not None  # simulated
    places = locate(data.conductivity - data.sensor.background, data.sensor)
    return Presses(gain * (data.voltages - data.references), places)


class PlaceUnderTest:
    """The method of places under test on one skin, in a worker that is replaced when it is lost.

    Attributes:
        worker: to be asked directly where the same question must be asked again.
        log, watch, limit_s: as for `MethodUnderTest`.
        located: presses whose places the method is not told.
    """

    def __init__(self, method: str, plugin: Path | None, limit_s: float, folder: Path) -> None:
        given, self.located = skin()
        self.sensor, self.limit_s = given.sensor, limit_s
        self.log, self.watch = folder / "log", Watch(folder)
        service = PlaceTestService(given, method, {}, simulated, plugin, watch=self.watch)
        self.worker = CheckWorker(service, limit_s, self.log)
        self.answer = self.worker.answer

    @property
    def differences(self) -> Frames:
        """Differences (n, M) of the presses to be located."""
        return self.located.differences

    @cached_property
    def places(self) -> Array:
        """Places (n, 2) [m] that the method says."""
        return self.ask(self.differences)

    def ask(self, differences: Frames) -> Array:
        """Return places (n, 2) [m].

        Raises:
            BrokenError: there are none.
        """
        return self.places_of(self.worker.request("locate", differences), len(differences))

    def refit(self, *, labelled: bool = True, seed: int | None = None, threads: int = 1) -> Array:
        """Return the places by another instance, see `PlaceTestService.refit`."""
        reply = self.worker.request("refit", self.differences, labelled, seed, threads)
        return self.places_of(reply, len(self.differences))

    @staticmethod
    def places_of(reply: Reply, n: int) -> Array:
        """Return the `n` places of a reply."""
        return np.asarray(array_of(reply, np.float64, (n, 2), "locate"))

    def close(self, one: Array, other: Array, allowed_mm: float, what: str) -> str:
        """Require that places differ by no more than `allowed_mm`."""
        apart = 1e3 * float(np.max(np.hypot(*(one - other).T)))
        said = f"{what} differ by up to {apart:.2g} mm; {allowed_mm:g} is allowed."
        require(apart <= allowed_mm, said)
        return said


def simulated(split: str, limit: int | None) -> Dataset:
    """Return simulated presses of the skin."""
    return load(SCENARIO, split=split, limit=limit)


@dataclass(eq=False, kw_only=True)
class PlaceTestService(PlaceService):
    """The worker's side: the method, asked for places under chosen conditions and watched."""

    watch: Watch

    def set_up(self) -> Reply:
        """Fit the method."""
        self.watch.begin()
        return super().set_up()

    def expected_failures(self) -> Reply:
        """Return the declaration of its class, which must map names to reasons."""
        declared = PLACE_REGISTRY.known()[self.method].expected_failures
        return Reply(REASONS.validate_python(declared), 0.0)

    def refit(self, differences: Frames, labelled: bool, seed: int | None, threads: int) -> Reply:
        """Return places by another instance, fitted with or without labelled presses.

        Args:
            seed: of the global generators meanwhile; None: as for all requests.
            threads: that libraries may use meanwhile.
        """
        with thread_count(threads):
            if seed is not None:
                seed_generators(seed)
            other = self._other(labelled)
            other.set_up()
            limit_threads(threads)  # of libraries that fitting loaded
            return other.locate(differences)

    def random_state(self, differences: Frames) -> Reply:
        """Return the global generators that fitting, and locating, leave in another state."""
        other = self._other(labelled=True)
        fitting, _ = changed_generators(other.set_up)
        asking, reply = changed_generators(lambda: other.locate(differences))
        if reply.failure is not None:
            return reply
        return Reply({"fit": fitting, "locate": asking}, reply.seconds)

    def repeat(self, differences: Frames, again: int = 0) -> Reply:
        """Return how often a press was located, and how memory grew by it [MiB]."""
        return memory_growth(lambda: self.locate(differences[:1]), again)

    def _other(self, labelled: bool) -> PlaceService:
        given = self.given if labelled else replace(self.given, labelled=self.given.labelled[:0])
        # The plugin is loaded already.
        return PlaceService(given, self.method, self.parameters, self.splits)
