"""Tables of stated uncertainty."""

import math
from functools import cache

from docs.tables.record import printed, record

from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.findings.uncertainty import Stated, read_uncertainty
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.reports.findings.uncertainty import figure_text, first_columns

_PIXELS = (
    "crps", "coverage_50", "coverage_80", "coverage_95", "sharpness", "error_over_spread", "ause",
)  # fmt: skip
_PLACES = ("place_coverage_50", "place_coverage_80", "place_coverage_95", "place_radius_mm")
NOISE = ("noise-60db", "noise-50db", "noise-40db", "noise-30db")
CONFORMAL = "greit-conformal"
_RUNGS = (
    *("sim2real-noise", "sim2real-electrode-shift", "sim2real-gain", "sim2real-drift"),
    "sim2real-dead-electrode",
)


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
        (one.method, one.scenario): one.figures["coverage_95"].value
        for suite in ("noise", "sim2real")
        for one in stated(suite)
        if one.scenario in AIMS and one.method != CEILING
    }
    rows = []
    for method in dict.fromkeys(method for method, _ in held):
        shares = [held.get((method, scenario), math.nan) for scenario in AIMS]
        met = [low <= of <= high for of, (low, high) in zip(shares, AIMS.values(), strict=True)]
        told = [
            f"{of:.1%}, {'met' if ok else 'missed'}" for of, ok in zip(shares, met, strict=True)
        ]
        rows.append([f"`{method}`", *told])
    heads = [f"{name}: {low:.0%} to {high:.0%}" for name, (low, high) in AIMS.items()]
    return printed(["Aim of 95 % intervals", *heads], rows, [False, True, True])


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
    "uncertainty with imperfections": lambda: _table("sim2real", _PIXELS, _RUNGS),
    "regions of places on all skins": _skins,
    "uncertainty of places on skins": lambda: _table("novelty", _PLACES, ("ohmc16",)),
}
