"""Service of a worker: a method of places, which is fitted to a skin and asked for places."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.method_service import Frames, FrameService, known_parameters
from eitbench.benchmark.workers.worker import timed_answer
from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.problem import Splits
from eitbench.methods.registry import PLACE_REGISTRY
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.transfer import Learnable
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.scenario import TransferScenario
from eitbench.scenarios.suites.suite import learned_from


@dataclass(eq=False)
class PlaceService(FrameService):
    """Makes and fits a method of places, and locates presses.

    Attributes:
        given: all that the worker knows of the skin; no press that is located is among it.
        splits: gives simulated presses.
        plugin, definition: as for `MethodService`.
    """

    registry: ClassVar = PLACE_REGISTRY

    given: Learnable
    method: str
    parameters: Mapping[str, Any]
    splits: Splits
    plugin: Path | None = None
    definition: Callable[[], type[PlaceMethod]] | None = None
    _method: PlaceMethod | None = field(default=None, init=False)

    @cached_property
    def problem(self) -> PlaceProblem:
        """The problem of the method."""
        return PlaceProblem(self.given, self.splits)

    def set_up(self) -> Reply:
        """Fit the method; the reply holds its `parameters`, and attributes for the cell."""
        self.load_plugin()
        method = create_place_method(self.method, **self.parameters)
        start = time.perf_counter()
        method.fit(self.problem)
        seconds = time.perf_counter() - start
        self._method = method
        said = {
            "parameters": known_parameters(method) | dict(self.parameters),
            "train_s": float(method.train_s),
            "differs": method.differs,
        }
        return Reply(said, seconds)

    def locate(self, differences: Frames) -> Reply:
        """Return places (n, 2) [m] of `differences` (n, M)."""
        assert self._method is not None
        return timed_answer(self._method.locate, [differences], (len(differences), 2))

    def prior_knowledge(self) -> Reply:
        """Return what the method read of the skin's model and presses, and `trained_on`."""
        assert self._method is not None
        access = asdict(self.problem.physics.access_record())
        real = dict(self.problem.read)
        said = {"access": access, "trained_on": dict(self._method.trained_on), "real": real}
        return Reply(said, 0.0)


def simulated_presses(scenario: TransferScenario, split: str, limit: int | None) -> Dataset:
    """Return simulated presses of the skin's nominal sensor.

    Raises:
        InputError: another split than "train" was asked for.
    """
    if split != "train":
        raise InputError(
            f"A method of places may ask for the train split, not for {split!r}: its labelled "
            "presses are all that it may choose by."
        )
    return load(learned_from(scenario), split=split, limit=limit)
