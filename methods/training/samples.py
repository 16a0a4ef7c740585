"""Samples to train on: simulated voltages and the conductivities that belong to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench.methods.problem import Problem, no_split
from eitbench.methods.weights.weight_files import sensor_key
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import Suite

if TYPE_CHECKING:
    from eitbench.scenarios.suites.scenario import Split


def training_scenario(suite: Suite, name: str | None = None) -> SimulatedScenario:
    """Return a suite's simulated scenario with training and validation samples.

    Args:
        suite: to look in.
        name: of the scenario; by default the first one, if all are of one sensor.

    Raises:
        InputError: there is none, or none of that name, or none is named and several sensors are
            simulated.
    """
    simulated = [
        scenario
        for scenario in suite.scenarios
        if isinstance(scenario, SimulatedScenario) and scenario.train and scenario.validation
    ]
    if not simulated:
        raise InputError(
            f"Suite {suite.name!r} has no simulated scenario with training and validation samples."
        )
    if name is not None:
        named = {scenario.name: scenario for scenario in simulated}
        if name not in named:
            raise unknown_name(f"scenario of suite {suite.name!r} to train on:", name, named)
        return named[name]
    others = {sensor_key(s.nominal_sensor): s.nominal_sensor.name for s in simulated}
    if len(others) > 1:
        raise InputError(
            f"Suite {suite.name!r} simulates {len(others)} sensors ({', '.join(others.values())}): "
            "a training is for one, so name a scenario with --scenario."
        )
    return simulated[0]


def nominal_problem(scenario: SimulatedScenario) -> Problem:
    """The problem of a scenario's nominal sensor, with the model's own reference frame [V/A]."""
    model = forward_model(scenario.nominal_sensor)
    return Problem(scenario.nominal_sensor, model.voltages(model.background), no_split)


def images(scenario: SimulatedScenario, split: Split, count: int) -> Tensor:
    """Conductivities (count, H, W) [S/m] of the first samples, in float32.

    Outside the sensor they are the background.
    """
    sensor = scenario.nominal_sensor
    drawn = np.empty((count, *sensor.image_shape), dtype=np.float32)
    for sample, image in enumerate(drawn):
        image[:] = rasterise(phantom(scenario, split, sample), sensor)
    drawn[:, ~sensor.mask] = sensor.background
    return torch.from_numpy(drawn)
