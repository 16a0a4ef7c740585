"""What is measured: sensors, patterns, forward physics, phantoms, noise, recordings, suites."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eitbench.scenarios.data.datasets import Dataset, load
    from eitbench.scenarios.errors import EitbenchError, InputError
    from eitbench.scenarios.physics.forward import ForwardModel, forward_model
    from eitbench.scenarios.recordings.catalogue import sensor
    from eitbench.scenarios.sensors.sensor import Sensor
    from eitbench.scenarios.suites.scenario import RecordedScenario, SimulatedScenario
    from eitbench.scenarios.suites.suite import Suite, load_suite

# Imported when first used: the command line must answer before numpy and pandas are loaded.
_HOMES = {
    "Dataset": "data.datasets",
    "EitbenchError": "errors",
    "ForwardModel": "physics.forward",
    "InputError": "errors",
    "RecordedScenario": "suites.scenario",
    "Sensor": "sensors.sensor",
    "SimulatedScenario": "suites.scenario",
    "Suite": "suites.suite",
    "forward_model": "physics.forward",
    "load": "data.datasets",
    "load_suite": "suites.suite",
    "sensor": "recordings.catalogue",
}

__all__ = [
    "Dataset",
    "EitbenchError",
    "ForwardModel",
    "InputError",
    "RecordedScenario",
    "Sensor",
    "SimulatedScenario",
    "Suite",
    "forward_model",
    "load",
    "load_suite",
    "sensor",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
