"""Rows of `eitbench list`: plain values, one row for each thing that has a name."""

from collections.abc import Callable, Mapping
from typing import Any

from eitbench.hardware.registry import board_rows
from eitbench.methods.registry import methods, operators
from eitbench.scenarios.catalogue import sensors
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite, suites

Row = dict[str, str | int | None]


def _described(known: Mapping[str, type[Any]], *columns: str) -> list[Row]:
    return [
        {"name": name, "description": first_line(cls)} | {c: getattr(cls, c) for c in columns}
        for name, cls in known.items()
    ]


def _suites() -> list[Row]:
    return [
        {"name": s.name, "ranks": s.ranks, "title": s.title, "scenarios": len(s.scenarios)}
        for s in map(load_suite, suites())
    ]


def _scenarios() -> list[Row]:
    return [
        {
            "name": scenario.name,
            "suite": name,
            "kind": scenario.kind,
            "sensor": scenario.nominal_sensor.name,
            "test": scenario.test if isinstance(scenario, SimulatedScenario) else None,
        }
        for name in suites()
        for scenario in load_suite(name).scenarios
    ]


def _sensors() -> list[Row]:
    return [
        {
            "name": name,
            "electrodes": sensor.n_electrodes,
            "measurements": sensor.n_measurements,
            "image": "{} x {}".format(*sensor.image_shape),
        }
        for name, sensor in ((name, build()) for name, build in sensors().items())
    ]


def _recordings() -> list[Row]:
    return [
        {
            "name": name,
            "title": recorded.title,
            "truth": recorded.truth,
            "licence": recorded.source.licence,
            "source": recorded.repository,
            "citation": recorded.citation,
        }
        for name, recorded in RECORDED_SETS.items()
    ]


LISTINGS: dict[str, Callable[[], list[Row]]] = {
    "methods": lambda: _described(methods(), "source", "differs"),
    "operators": lambda: _described(operators(), "source"),
    "scenarios": _scenarios,
    "sensors": _sensors,
    "suites": _suites,
    "recordings": _recordings,
    "boards": board_rows,
}
