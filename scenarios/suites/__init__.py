"""Scenarios and suites: declared parameters of simulated and recorded data."""

from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario, SimulatedScenario, Split
from eitbench.scenarios.suites.suite import Suite, load_suite, scenario_by_name, suites

__all__ = [
    "RecordedScenario",
    "Scenario",
    "SimulatedScenario",
    "Split",
    "Suite",
    "load_suite",
    "scenario_by_name",
    "suites",
]
