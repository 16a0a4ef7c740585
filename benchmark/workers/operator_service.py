"""Services of a worker: a forward operator, and the model it is compared with."""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from eitbench.benchmark.metrics.operator_metrics import coarse_gradient
from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.worker import timed_answer
from eitbench.methods.operator import Operator
from eitbench.methods.registry import load_plugin, operator, operators
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.guard import close_test_split
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

GRADIENTS_AT_ONCE = 8  # the fields of more images of a fine mesh would fill the memory


@dataclass(eq=False)
class OperatorService:
    """Makes an operator for a sensor, and asks it.

    Attributes:
        plugin: the file that the operator is registered in; no other is loaded.
    """

    sensor: Sensor
    operator: str
    plugin: Path | None = None
    _operator: Operator | None = field(default=None, init=False)

    def set_up(self) -> Reply:
        """Make the operator; the reply holds the cost of its training.

        Its time is that of making the operator, without loading libraries.
        """
        close_test_split()
        if self.plugin is not None:
            load_plugin(self.plugin)
        operators()  # imports their libraries
        start = time.perf_counter()
        made = operator(self.operator, self.sensor)
        seconds = time.perf_counter() - start
        self._operator = made
        said = {
            "train_s": float(made.train_s),
            "trained_on": made.trained_on,
        }
        return Reply(said, seconds)

    def evaluate(self, images: Array, cotangents: Array) -> Reply:
        """Evaluate `images` (n, H, W) with `cotangents` (n, M).

        The reply holds `voltages` (n, M) [V/A], `gradients` (n, H, W), which are J^T g, and the
        times for all of them, `forward_s` and `grad_s`.
        """
        assert self._operator is not None
        precision = self._operator.precision
        images, cotangents = images.astype(precision), cotangents.astype(precision)
        voltages = timed_answer(self._operator.voltages, [images], cotangents.shape)
        if voltages.failure is not None:
            return voltages
        gradients = timed_answer(self._operator.vjp, [images, cotangents], images.shape)
        seconds = voltages.seconds + gradients.seconds
        if gradients.failure is not None:
            return replace(gradients, seconds=seconds)
        evaluation = {
            "voltages": voltages.value.astype(np.float64),
            "gradients": gradients.value.astype(np.float64),
            "forward_s": voltages.seconds,
            "grad_s": gradients.seconds,
        }
        return Reply(evaluation, seconds)


class ReferenceModelService:
    """Gradients of the model that a scenario's data come from."""

    def __init__(self, scenario: SimulatedScenario) -> None:
        self.scenario = scenario

    def set_up(self) -> Reply:
        """Make the model, and compile what it compiles."""
        model = self._model()
        for count in (1, 2):
            voltages, fields = model.voltages_and_fields(np.array([model.background] * count))
            model.pullback(fields, voltages)
        return Reply({}, 0.0)

    def _model(self) -> ForwardModel:
        model = self.scenario.data_model("test")
        assert isinstance(model, ForwardModel)  # no slab is run
        return model

    def gradients(self, rows: slice, cotangents: Array) -> Reply:
        """Return J(t)^T g (n, H, W) on the nominal grid for test samples `rows`, float32.

        The image t is the phantom on the model's own grid. Rounding to float32 changes a
        cosine by less than 1e-14.
        """
        model, scenario = self._model(), self.scenario
        shape = scenario.nominal_sensor.image_shape
        found = np.empty((len(cotangents), *shape), dtype=np.float32)
        for first in range(0, len(cotangents), GRADIENTS_AT_ONCE):
            part = slice(first, first + GRADIENTS_AT_ONCE)
            samples = range(rows.start, rows.stop)[part]
            images = [rasterise(phantom(scenario, "test", k), model.sensor) for k in samples]
            _, fields = model.voltages_and_fields(np.array(images))
            found[part] = coarse_gradient(model.pullback(fields, cotangents[part]), shape)
        return Reply(found, 0.0)
