"""Small sensors and suites for tests of methods."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import Dataset
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


def no_split(split: str, limit: int | None) -> Dataset:
    """Refuse data, which most methods need not read."""
    raise AssertionError(f"a method asked for the {split} split")


def suite_of(folder: Path, *scenarios: SimulatedScenario | str) -> str:
    """Path of a suite file of scenarios, each declared or the lines of a file."""
    parts = ['name = "tiny"\ntitle = "tiny"\nmethods = ["noser"]']
    for scenario in scenarios:
        if isinstance(scenario, SimulatedScenario):
            fields = scenario.model_dump(mode="json", exclude_defaults=True) | {"kind": "simulated"}
            lines = (f"{name} = {json.dumps(value)}" for name, value in fields.items())
            scenario = "\n".join(["[[scenarios]]", *lines])
        parts.append(scenario)
    path = folder / "tiny.toml"
    path.write_text("\n".join(parts))
    return str(path)
