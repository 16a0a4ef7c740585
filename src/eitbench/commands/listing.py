"""Rows of `eitbench list`: plain values, one row for each thing that has a name."""

from collections.abc import Callable, Mapping
from typing import Any

from eitbench.methods.registry import PLACE_REGISTRY, methods, operators
from eitbench.scenarios.catalogue import sensors
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.sensors.outlines import Disc, is_rectangle
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite, suites

Row = dict[str, str | int | None]


def _described(known: Mapping[str, type[Any]], *columns: str) -> list[Row]:
    return [
        {"name": name, "description": first_line(cls)} | {c: getattr(cls, c) for c in columns}
        for name, cls in known.items()
    ]


def _boards() -> list[Row]:
    from eitbench.hardware.registry import board_rows  # which needs pySerial

    return board_rows()


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
    rows: list[Row] = []
    for name, sensor in ((name, build()) for name, build in sensors().items()):
        x0, y0, x1, y1 = (1e3 * bound for bound in sensor.outline.bounds)
        outline = "disc" if isinstance(sensor.outline, Disc) else "polygon"
        widths = sorted({1e3 * electrode.width for electrode in sensor.electrodes})
        rows.append(
            {
                "name": name,
                "outline": "rectangle" if is_rectangle(sensor.outline) else outline,
                "size_mm": f"{x1 - x0:.4g} x {y1 - y0:.4g}",
                "electrodes": sensor.n_electrodes,
                "width_mm": " to ".join(
                    dict.fromkeys(f"{width:.3g}" for width in (widths[0], widths[-1]))
                ),
                "pattern": sensor.pattern.title,
                "measurements": sensor.n_measurements,
                "image": "{} x {}".format(*sensor.image_shape),
            }
        )
    return rows


def _families() -> list[Row]:
    return [
        {
            "name": family.name,
            "shape": " or ".join(
                f"{shape.name} ({', '.join(f'{n} {_span(s)}' for n, s in shape.sizes.items())})"
                for shape in family.shapes
            ),
            "count": family.count,
            "conductivity": _span(family.conductivity) if family.pressure is None else None,
            "pressure_kpa": family.pressure and _span(tuple(p / 1e3 for p in family.pressure)),
        }
        for family in FAMILIES.values()
    ]


def _span(ends: tuple[float, ...]) -> str:
    return " to ".join(f"{end:g}" for end in ends)


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
    "place-methods": lambda: _described(PLACE_REGISTRY.known(), "source"),
    "operators": lambda: _described(operators(), "source"),
    "families": _families,
    "scenarios": _scenarios,
    "sensors": _sensors,
    "suites": _suites,
    "recordings": _recordings,
    "boards": _boards,
}
