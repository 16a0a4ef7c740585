"""Services of a worker: a forward operator, and the model it is compared with."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitbench.benchmark.metrics.operator_metrics import coarse_gradient
from eitbench.benchmark.workers.worker import Failure, Reply, as_array, shortcoming
from eitbench.methods.operator import Operator
from eitbench.methods.registry import load_plugin, operator, operators
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

GRADIENTS_AT_ONCE = 8  # the fields of more images of a fine mesh would fill the memory


@dataclass(frozen=True)
class Evaluation:
    """Answer of an operator for n images.

    Attributes:
        voltages: (n, M) [V/A].
        gradients: (n, H, W), J^T g.
        forward_s, grad_s: time for all of them.
    """

    voltages: Array
    gradients: Array
    forward_s: float
    grad_s: float


@dataclass(frozen=True, eq=False)
class OperatorSpec:
    """An operator to make in a worker, and its sensor.

    Attributes:
        plugin: the file that the operator is registered in; no other is loaded.
    """

    sensor: Sensor
    operator: str
    plugin: Path | None = None

    def make(self) -> tuple[Operator, float]:
        """Return the operator, and the time it took to make it [s] without loading libraries."""
        if self.plugin is not None:
            load_plugin(self.plugin)
        operators()  # imports their libraries
        start = time.perf_counter()
        made = operator(self.operator, self.sensor)
        return made, time.perf_counter() - start


class OperatorService:
    """Makes and asks the operator of a task."""

    def __init__(self, task: OperatorSpec) -> None:
        self.task = task
        self._operator: Operator | None = None

    def set_up(self) -> Reply:
        """Make the operator; the reply holds the cost of its training."""
        made, seconds = self.task.make()
        self._operator = made
        return Reply({"train_s": float(made.train_s), "trained_on": str(made.trained_on)}, seconds)

    def evaluate(self, images: Array, cotangents: Array) -> Reply:
        """Return the `Evaluation` of `images` (n, H, W) with `cotangents` (n, M)."""
        if self._operator is None:
            raise InputError("The operator was not made.")
        precision = self._operator.precision
        images, cotangents = images.astype(precision), cotangents.astype(precision)
        given = images.copy(), cotangents.copy()
        arrays: list[Array] = []
        times: list[float] = []
        for function, arguments, shape in (
            (self._operator.voltages, given[:1], cotangents.shape),
            (self._operator.vjp, given, images.shape),
        ):
            start = time.perf_counter()
            answer: object = function(*arguments)
            array = as_array(answer)
            times.append(time.perf_counter() - start)
            failure = shortcoming(answer, array, shape)
            if not (np.array_equal(given[0], images) and np.array_equal(given[1], cotangents)):
                failure = Failure("error", "changed its input in place", ("mutated",))
            if failure is not None or array is None:
                return Reply(None, sum(times), failure)
            arrays.append(array.astype(np.float64))
        evaluation = Evaluation(arrays[0], arrays[1], forward_s=times[0], grad_s=times[1])
        return Reply(evaluation, sum(times))


class ReferenceModelService:
    """Gradients of the model that a scenario's data come from."""

    def __init__(self, scenario: SimulatedScenario) -> None:
        self.scenario = scenario

    def set_up(self) -> Reply:
        """Make the model, and compile what it compiles."""
        model = self.scenario.data_model("test")
        voltages, fields = model.voltages_and_fields(model.background[None])
        model.pullback(fields, voltages)
        return Reply({}, 0.0)

    def gradients(self, rows: slice, cotangents: Array) -> Reply:
        """Return J(t)^T g (n, H, W) on the nominal grid for test samples `rows`, float32.

        The image t is the phantom on the model's own grid. Rounding to float32 changes a
        cosine by less than 1e-14.
        """
        model, scenario = self.scenario.data_model("test"), self.scenario
        shape = scenario.nominal_sensor.image_shape
        found = np.empty((len(cotangents), *shape), dtype=np.float32)
        for first in range(0, len(cotangents), GRADIENTS_AT_ONCE):
            part = slice(first, first + GRADIENTS_AT_ONCE)
            samples = range(rows.start, rows.stop)[part]
            images = [rasterise(phantom(scenario, "test", k), model.sensor) for k in samples]
            _, fields = model.voltages_and_fields(np.array(images))
            found[part] = coarse_gradient(model.pullback(fields, cotangents[part]), shape)
        return Reply(found, 0.0)
