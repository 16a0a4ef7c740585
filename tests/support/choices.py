"""A choice of a method for foam16, made without running a method."""

from typing import Any

from eitbench.benchmark.choice.decision import Choice, Figure, Pick, Tried, sensor_hash
from eitbench.scenarios.sensors.sensor import foam16


def tried(method: str, place: float, frame_ms: float | None, **changes: Any) -> Tried:
    """A method with errors `place` [mm], 2 mm more after drift."""
    figure = Figure(value=place, low=place - 1, high=place + 1)
    drift = Figure(value=place + 2, low=place + 1, high=place + 3)
    values: dict[str, Any] = {
        "method": method,
        "parameters": {},
        "chosen_by": "record",
        "place": figure,
        "with_drift": drift,
        "touches": figure,
        "drift": drift,
        "score": 5.0,
        "bounded": 0.7,
        "frame_ms": frame_ms,
        "in_time": frame_ms is not None and frame_ms <= 100,
        "coverage": 1.0,
    }
    return Tried(**values | changes)


def made_choice(**changes: Any) -> Choice:
    """`noser` before `greit`, on simulated touches."""
    values: dict[str, Any] = {
        "asked": "foam16",
        "sensor_sha256": sensor_hash(foam16()),
        "decided_on": "touches",
        "presses": 60,
        "drift": "simulated",
        "frame_rate": 10.0,
        "time_limit_s": 300.0,
        "processor": "Some CPU",
        "best": Pick(method="noser"),
        "best_with_drift": Pick(method="noser"),
        "tried": (tried("noser", 5.0, 0.7, parameters={"weight": 0.5}), tried("greit", 8.0, 0.6)),
        "not_tried": (),
        "unusable": {},
    }
    return Choice(**values | changes)
