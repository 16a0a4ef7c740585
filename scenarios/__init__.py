"""Everything that is measured: sensors, physics, phantoms, imperfections, recordings, suites."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.scenarios.catalogue import sensor
    from eitbench.scenarios.data.datasets import Dataset, load
    from eitbench.scenarios.errors import EitbenchError, InputError
    from eitbench.scenarios.physics.forward import ForwardModel, forward_model
    from eitbench.scenarios.sensors.sensor import Sensor
    from eitbench.scenarios.suites.scenario import RecordedScenario, SimulatedScenario
    from eitbench.scenarios.suites.suite import Suite, load_suite

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

# The command line must answer before numpy and pandas are loaded.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
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
        "sensor": "catalogue",
    },
)
