"""Service of a worker: a method, which is fitted and asked for images."""

import json
import time
from collections.abc import Mapping
from dataclasses import Field, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.workers.worker import Failure, Reply, as_array, shortcoming
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem, Splits
from eitbench.methods.registry import create, load_plugin
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.guard import close_test_split
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import learned_from

Frames = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MethodSpec:
    """A method to make in a worker, and its problem without the test split.

    Attributes:
        plugin: the file that the method is registered in; no other is loaded, since loading one
            may change what is there already.
    """

    sensor: Sensor
    reference: Frames
    splits: Splits
    method: str
    parameters: Mapping[str, Any]
    plugin: Path | None = None


class MethodService:
    """Makes and fits the method of a task, and reconstructs images."""

    def __init__(self, task: MethodSpec) -> None:
        self.task = task
        self._method: Method | None = None

    @cached_property
    def problem(self) -> Problem:
        """The problem of the method."""
        return Problem(self.task.sensor, self.task.reference, self.task.splits)

    def load_plugin(self) -> None:
        """Run the file that the method is registered in; from here on the test split is closed."""
        close_test_split()
        if self.task.plugin is not None:
            load_plugin(self.task.plugin)

    def set_up(self) -> Reply:
        """Fit the method; the reply holds its `parameters` as JSON, and attributes for the cell."""
        self.load_plugin()
        method, reply = self.fitted(self.task.parameters)
        declared = constructor_parameters(method) | dict(self.task.parameters)
        parameters = json.dumps(declared, default=str)
        said = {"train_s": float(method.train_s), "differs": str(method.differs)}
        return replace(reply, value={"parameters": parameters, **said})

    def fitted(self, parameters: Mapping[str, Any]) -> tuple[Method, Reply]:
        """Return the method, fitted with `parameters`, and a reply with the time it took."""
        method = create(self.task.method, **parameters)
        start = time.perf_counter()
        method.fit(self.problem)
        self._method = method
        return method, Reply(None, time.perf_counter() - start)

    def prior_knowledge(self) -> Reply:
        """Return the method's record of access to its problem, and the data behind its weights."""
        trained_on = {} if self._method is None else dict(self._method.trained_on)
        return Reply((self.problem.access_record(), trained_on), 0.0)

    def reconstruct(self, frames: Frames) -> Reply:
        """Return images (n, H, W) of `frames` (n, M), in float32."""
        if self._method is None:
            raise InputError("The method was not fitted.")
        given = frames.copy()
        start = time.perf_counter()
        answer = self._method.reconstruct(given)
        images = as_array(answer)
        seconds = time.perf_counter() - start
        failure = shortcoming(answer, images, (len(frames), *self.task.sensor.image_shape))
        if not np.array_equal(given, frames, equal_nan=True):
            failure = Failure("error", "changed its input voltages in place", ("mutated",))
        if failure is not None or images is None:
            return Reply(None, seconds, failure)
        with np.errstate(over="ignore"):  # what does not fit becomes inf and is reported as such
            return Reply(images.astype(np.float32), seconds)


def constructor_parameters(method: Method) -> dict[str, Any]:
    """Return every constructor parameter of a method that is a dataclass, with defaults."""
    declared: dict[str, Field[Any]] = getattr(method, "__dataclass_fields__", {})
    return {name: getattr(method, name) for name, field in declared.items() if field.init}


def learning_splits(scenario: Scenario, split: str, limit: int | None) -> Dataset:
    """Return training or validation data for `scenario`; a method is never given the test split.

    For recorded presses, simulated ones are learned from, see `learned_from`.

    Raises:
        InputError: any other split was asked for.
    """
    if split not in ("train", "validation"):
        raise InputError(f"A method may ask for the train or validation split, not for {split!r}.")
    source = learned_from(scenario) if split == "train" else scenario
    return load(source, split=split, limit=limit)


def scenario_splits(scenario: Scenario) -> Splits:
    """Return `learning_splits` of one scenario, as a function that can be sent to a worker."""
    return partial(learning_splits, scenario)
