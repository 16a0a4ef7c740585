"""Tables of stated uncertainty."""

import math
from functools import cache

import numpy as np
from docs.tables.record import printed, record

from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.findings.uncertainty import Stated, read_uncertainty
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.reports.findings.uncertainty import figure_text, first_columns
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

_PIXELS = (
    "crps", "coverage_50", "coverage_80", "coverage_95", "sharpness", "error_over_spread", "ause",
)  # fmt: skip
_PLACES = ("place_coverage_50", "place_coverage_80", "place_coverage_95", "place_radius_mm")
NOISE = ("noise-60db", "noise-50db", "noise-40db", "noise-30db")
CONFORMAL = "greit-conformal"
_SKIN = ("ohmc16", "ohmc16-stale")


@cache
def stated(suite: str) -> list[Stated]:
    """What methods state in the record of a suite."""
    return read_uncertainty(record(suite))


def _table(suite: str, names: tuple[str, ...], scenarios: tuple[str, ...]) -> str:
    found = [
        one
        for one in stated(suite)
        if one.scenario in scenarios and not math.isnan(one.figures[names[-1]].value)
    ]
    rows = []
    for one in found:
        method = "*ceiling*" if one.method == CEILING else f"`{one.method}`"
        rows.append(first_columns(one, found, method))
    texts = {"Scenario", "Method", "Ties"}
    right = [*(name not in texts for name in rows[0]), *[True] * len(names)]
    grid = [
        [*first.values(), *(figure_text(one, name) for name in names)]
        for first, one in zip(rows, found, strict=True)
    ]
    return printed([*rows[0], *(UNCERTAINTY[name].heading for name in names)], grid, right)


AIMS = {"noise-50db": (0.93, 0.97), "sim2real-drift": (0.85, 1.0)}
"""Shares of the truths that 95 % intervals of pixels aim to hold, by scenario."""


def _aims() -> str:
    """Who meets the aims, in the order of the first."""
    held = {
        (one.method, one.scenario): one
        for suite in ("noise", "sim2real")
        for one in stated(suite)
        if one.scenario in AIMS and one.method != CEILING
    }
    rows = []
    for method in dict.fromkeys(method for method, _ in held):
        told = []
        for scenario, aim in AIMS.items():
            one = held[method, scenario]
            told += [str(one.n), figure_text(one, "coverage_95"), _verdict(one, *aim)]
        rows.append([f"`{method}`", *told])
    heads = [
        head
        for name, (low, high) in AIMS.items()
        for head in ("n", f"{name}, in 95 %", f"{low:.0%} to {high:.0%}")
    ]
    return printed(["Method", *heads], rows, [False, *[True, True, False] * len(AIMS)])


def _verdict(one: Stated, low: float, high: float) -> str:
    """If the 95 % interval of the share held lies within the aim, or outside of it."""
    held = one.figures["coverage_95"]
    if math.isnan(held.low):
        return "too few sessions to tell"
    if low <= held.low and held.high <= high:
        return "met"
    return "missed" if held.high < low or held.low > high else "cannot be told"


def _rungs(name: str) -> str:
    """A figure on all rungs of sim2real as simulated, by method."""
    found = {
        (one.scenario.removeprefix("sim2real-"), one.method): one
        for one in stated("sim2real")
        if one.scenario.startswith("sim2real-") and not one.scenario.endswith("-calibrated")
    }
    scenarios, names = (list(dict.fromkeys(key[k] for key in found)) for k in (0, 1))
    # Those of all frames first, the ceiling last.
    most = {m: max(one.n for one in found.values() if one.method == m) for m in names}
    methods = sorted(names, key=lambda m: (m == CEILING, -most[m]))
    form, rows = UNCERTAINTY[name].form, []
    for scenario in scenarios:
        values = [
            found[scenario, method].figures[name].value if (scenario, method) in found else math.nan
            for method in methods
        ]
        rows.append([scenario, *("–" if math.isnan(v) else format(v, form) for v in values)])
    heads = []
    for method in methods:
        title = "*ceiling*" if method == CEILING else f"`{method}`"
        few = most[method] < max(most.values())
        heads.append(f"{title}, n = {most[method]}" if few else title)
    known = [k for k in range(len(heads)) if any(row[1 + k] != "–" for row in rows)]
    rows = [[row[0], *(row[1 + k] for k in known)] for row in rows]
    heads = ["rung", *(heads[k] for k in known)]
    return printed(heads, rows, [False, *[True] * len(known)])


def _of_untouched() -> str:
    """What certain images of the untouched sensor would get on `noise`, and who is worse."""
    scenario, found = scenario_by_name("noise-50db"), []
    assert isinstance(scenario, SimulatedScenario)
    sensor = scenario.nominal_sensor
    for sample in range(scenario.test):
        truth = rasterise(phantom(scenario, "test", sample), sensor)
        found.append(np.abs(truth - sensor.background)[sensor.mask].mean())
    certain = float(np.mean(found))
    here = [one for one in stated("noise") if one.scenario == scenario.name]
    worse = [f"`{one.method}`" for one in here if one.figures["crps"].value > certain]
    return (
        f"On `{scenario.name}` images of the untouched sensor, stated with certainty, would have a "
        f"CRPS of {certain:{UNCERTAINTY['crps'].form}} S/m. Worse than that: "
        f"{' and '.join(worse) or 'nobody'}."
    )


def _skins() -> str:
    heads = ["Skin", "n", "Error [mm]", *(UNCERTAINTY[name].heading for name in _PLACES)]
    found = {(one.scenario, one.method): one for one in stated("skins")}
    errors = record("skins").samples.groupby(["scenario", "method"])["localisation_mm"].median()
    ours = [one for one in found.values() if one.method == CONFORMAL]
    rows = [
        [f"`{one.scenario}`", str(one.n), f"{errors[one.scenario, CONFORMAL]:.1f}",
         *(figure_text(one, name) for name in _PLACES),
         figure_text(found[one.scenario, "noser"], "place_coverage_95")]
        for one in ours
    ]  # fmt: skip
    means = {name: sum(one.figures[name].value for one in ours) / len(ours) for name in _PLACES}
    shown = [format(mean, UNCERTAINTY[name].form) for name, mean in means.items()]
    rows.append(["mean", "", "", *shown, ""])
    return printed([*heads, "`noser` in 95 %"], rows, [False, *[True] * len(heads)])


TABLES = {
    "uncertainty on noise": lambda: _table("noise", _PIXELS, NOISE),
    "uncertainty of places on noise": lambda: _table("noise", _PLACES, NOISE),
    "aims of uncertainty": _aims,
    "CRPS of the untouched sensor": _of_untouched,
    "CRPS on rungs": lambda: _rungs("crps"),
    "pixels in intervals on rungs": lambda: _rungs("coverage_95"),
    "places in regions on rungs": lambda: _rungs("place_coverage_95"),
    "regions of places on all skins": _skins,
    "uncertainty of places on skins": lambda: _table("novelty", _PLACES, _SKIN),
}
