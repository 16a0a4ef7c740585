"""Small sensors, problems and suites for tests of methods."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eitbench.methods import Method, Problem
from eitbench.methods.problem import no_split
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import pair_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.suites.scenario import SimulatedScenario

Pairs = Iterable[tuple[int, int]]
PAIRS = [(i, (i + 1) % 8) for i in range(8)]


def foam(pixels: tuple[int, int] = (12, 12)) -> Sensor:
    """The default sensor on a coarser grid."""
    return replace(sensor("foam16"), image_shape=pixels)


def round_board(drives: Pairs = PAIRS[:5], senses: Pairs = PAIRS) -> Sensor:
    """A round sensor of 8 electrodes whose board reports magnitudes only."""
    electrodes = even_electrodes(Disc(0.07), 8, 0.01, 1e-3)
    pattern = replace(pair_pattern(drives, senses), magnitudes=True)
    return Sensor("round", Disc(0.07), electrodes, pattern, background=0.4, image_shape=(13, 11))


def clean_problem(s: Sensor, gain: float = 1.0) -> Problem:
    """The problem of a board with a `gain` that measures what the model does, without noise."""
    model = forward_model(s)
    return Problem(s, gain * model.voltages(model.background), no_split)


def touch(
    s: Sensor, at: tuple[float, float] = (0.065, 0.04), radius: float = 0.02, factor: float = 0.4
) -> NDArray[np.float64]:
    """Conductivity (H, W) [S/m] that falls to `factor` of the background in a disc."""
    x, y = s.pixel_centres
    inside = np.hypot(x - at[0], y - at[1]) < radius
    return np.where(inside & s.mask, factor * s.background, s.background)


TINY = SimulatedScenario(
    name="tiny", image_shape=(16, 16), families=("circle",), train=240, validation=60, test=60
)


def tiny_problem(s: Sensor = TINY.nominal_sensor) -> Problem:
    """The problem of `TINY`, with its data; a method may be told that its sensor is `s`."""
    return Problem(s, load(TINY).references[0], lambda split, limit: load(TINY, split, limit))


def tiny_mse(method: Method) -> float:
    """Mean squared error of a method on the test split of `TINY`."""
    test = load(TINY)
    method.fit(tiny_problem())
    assert test.conductivity is not None
    return float(np.mean((method.reconstruct(test.voltages) - test.conductivity) ** 2))


def suite_of(folder: Path, *scenarios: SimulatedScenario | str) -> str:
    """Path of a suite file of scenarios, each declared or the lines of a file."""
    parts = ['name = "tiny"\ntitle = "tiny"\nmethods = ["noser"]']
    for scenario in scenarios:
        if isinstance(scenario, SimulatedScenario):
            fields = scenario.model_dump(mode="json", exclude_defaults=True) | {"kind": "simulated"}
            toml = json.JSONEncoder(separators=(", ", " = ")).encode  # tables as TOML has them
            lines = (f"{name} = {toml(value)}" for name, value in fields.items())
            scenario = "\n".join(["[[scenarios]]", *lines])
        parts.append(scenario)
    path = folder / "tiny.toml"
    path.write_text("\n".join(parts))
    return str(path)
