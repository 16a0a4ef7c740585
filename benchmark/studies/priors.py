"""Priors: how much of a method's score rests on what it was told, one prior taken away at a time.

The classical methods reconstruct the same frames again without one of their priors, so that
differences are paired. Networks know the phantoms that they were trained on: their lead over total
variation is measured on these families and on shapes that no training had.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import joblib
import numpy as np
import pandas as pd

from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.statistics import Interval, bootstrap
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

MATCHED, UNSEEN, CLEAN = "noise-50db", "shapes", "noise-clean"
"""Scenarios: with the families of the training, with other shapes, and without noise."""
CLASSICAL = ("tikhonov", "noser", "laplacian", "greit", "tv")
NETWORKS, RIVAL = ("dnn", "phydnn", "learned-gn"), "tv"
WIDE = (0.05, 20.0)
"""A conductivity range that says nothing of the sign of a touch, in multiples of the background."""
WRONG_IMPEDANCE = 10.0
"""The contact impedance that a method is told, in multiples of that of the data."""


@dataclass(frozen=True, eq=False)
class Told:
    """What a method is told: the sensor, and hyper-parameters."""

    sensor: Sensor
    parameters: Mapping[str, Any]


def _any_conductivity(told: Told, _: str) -> Told:
    return replace(told, sensor=replace(told.sensor, conductivity_range=WIDE))


def _linear_in_conductivity(told: Told, _: str) -> Told:
    return replace(told, parameters={**told.parameters, "variable": "conductivity"})


def _tuned_without_noise(told: Told, method: str) -> Told:
    return replace(told, parameters=_selected(CLEAN, method))


def _wrong_impedance(told: Told, _: str) -> Told:
    electrodes = tuple(
        replace(e, contact_impedance=WRONG_IMPEDANCE * e.contact_impedance)
        for e in told.sensor.electrodes
    )
    return replace(told, sensor=replace(told.sensor, electrodes=electrodes))


PRIORS: Mapping[str, Callable[[Told, str], Told]] = {
    "conductivity range": _any_conductivity,
    "Clausius-Mossotti": _linear_in_conductivity,
    "noise level in tuning": _tuned_without_noise,
    "contact impedance": _wrong_impedance,
}
"""What takes a prior away, by the prior's name."""
PHANTOMS = "training phantoms"


def worth_of_priors(*, samples: int, jobs: int = 1) -> pd.DataFrame:
    """Measure the score S with and without each prior.

    Returns:
        One row per prior and method: `prior`, `method`, `known` and `unknown` (mean S with the
        prior and without it; of networks their lead over total variation), and the difference
        `worth` with its 95 % interval `low` to `high`; `n` samples.

    Args:
        samples: test samples of each scenario.
        jobs: processes.

    Raises:
        InputError: a network has no weights.
    """
    asked: list[tuple[str | None, str, str]] = [
        (None, method, MATCHED) for method in (*CLASSICAL, *NETWORKS)
    ]
    asked += [(prior, method, MATCHED) for prior in PRIORS for method in CLASSICAL]
    asked += [(None, method, UNSEEN) for method in (RIVAL, *NETWORKS)]
    found = worker_pool(jobs)(joblib.delayed(_scores)(*one, samples) for one in asked)
    scores = dict(zip(asked, found, strict=True))
    rows = [
        _paired(prior, method, scores[None, method, MATCHED], scores[prior, method, MATCHED])
        for prior in PRIORS
        for method in CLASSICAL
    ]
    rows += [
        _unpaired(
            method,
            *(scores[None, method, s] - scores[None, RIVAL, s] for s in (MATCHED, UNSEEN)),
        )
        for method in NETWORKS
    ]
    return pd.DataFrame(rows)


def _scores(prior: str | None, method: str, scenario: str, samples: int) -> Array:
    """S (n,) of a method on the first test samples of a scenario, without a prior."""
    data = load(scenario, "test", samples)
    told = Told(data.sensor, _selected(scenario, method))
    if prior is not None:
        told = PRIORS[prior](told, method)
    reconstruction = create(method, **told.parameters)
    problem = Problem(told.sensor, data.references[0], no_split)
    reconstruction.fit(problem)
    return evaluate(data, reconstructed(reconstruction, problem, data))["score"].to_numpy()


def _selected(scenario: str, method: str) -> Mapping[str, Any]:
    found = scenario_by_name(scenario)
    if not isinstance(found, SimulatedScenario):
        raise InputError(f"Scenario {scenario!r} is not simulated.")
    return selected_parameters(found, method) or {}


def _paired(prior: str, method: str, known: Array, unknown: Array) -> dict[str, Any]:
    (worth,) = bootstrap((known - unknown)[:, None], _sessions(known))
    return _row(prior, method, known, unknown, worth)


def _unpaired(method: str, known: Array, unknown: Array) -> dict[str, Any]:
    """The difference of means over two sets of samples; their intervals add in quadrature."""
    one, other = (bootstrap(values[:, None], _sessions(values))[0] for values in (known, unknown))
    value = one.value - other.value
    low = value - np.hypot(one.value - one.low, other.high - other.value)
    high = value + np.hypot(one.high - one.value, other.value - other.low)
    return _row(PHANTOMS, method, known, unknown, Interval(value, float(low), float(high)))


def _sessions(values: Array) -> Index:
    return np.arange(len(values)) // TOUCHES


def _row(prior: str, method: str, known: Array, unknown: Array, worth: Interval) -> dict[str, Any]:
    return {
        "prior": prior,
        "method": method,
        "known": float(known.mean()),
        "unknown": float(unknown.mean()),
        "worth": worth.value,
        "low": worth.low,
        "high": worth.high,
        "n": len(known),
    }
