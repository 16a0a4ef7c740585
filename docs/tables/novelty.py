"""Tables of novelty, from the record of the suite `novelty`."""

import math
from dataclasses import replace
from functools import cache

import pandas as pd
from docs.tables.record import printed, record

from eitbench.benchmark.findings.novelty import read_novelty
from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES
from eitbench.reports.findings.novelty import by_condition, to_table

_PSNR = ".1f"
UNTOUCHED = "novelty-untouched"
_SHOWN = (
    "familiar", "conductive", "dead-electrode", "stale-reference", "other-sensor", "untouched",
)  # fmt: skip


@cache
def _scores() -> pd.DataFrame:
    """Figures of all scores. No table shows intervals, which take most of the time."""
    return to_table(read_novelty(record("novelty"), with_intervals=False))


def _condition(scenario: str) -> str:
    return scenario.removeprefix("novelty-").replace("-", " ")


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)


def _table(wide: pd.DataFrame, figure: str) -> str:
    touched = [name for name in wide if name.startswith("novelty-") and name != UNTOUCHED]
    wide = wide.assign(touched=wide[touched].mean(axis=1))
    heads = ["Method", "Score", *map(_condition, wide.columns[:-2]), "Mean of the simulated"]
    heads.append("Without untouched")
    rows = [
        [f"`{method}`", SCORES[score].title.lower(),
         *(_text(value, NOVELTY[figure].form) for value in values)]
        for (method, score), values in zip(wide.index, wide.to_numpy(), strict=True)
    ]  # fmt: skip
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


def _aurocs() -> str:
    return _table(by_condition(_scores()), "auroc")


def _caught() -> str:
    """Of the method with the best mean AUROC of each score."""
    stored = _scores()
    best = by_condition(stored)["mean"].groupby("score", sort=False).idxmax()
    return _table(by_condition(stored, "caught").loc[best.tolist()], "caught")


def _ordered() -> str:
    """Means over the conditions of the simulated sensor, by method and score."""
    run = record("novelty")
    wide = _mean_order(_scores())
    wide = wide[[name for name in SCORES if name in wide]].sort_values("residual", ascending=False)
    # |v - v_ref| / |v_ref|, by which the two residuals differ, in the place of a residual.
    strength = run.samples["residual"] / run.samples["relative_residual"]
    by_strength = replace(run, samples=run.samples.assign(residual=strength))
    stored = to_table(read_novelty(by_strength, with_intervals=False))
    wide["strength"] = _mean_order(stored)["residual"]
    rows = [
        [f"`{method}`", *(_text(value, NOVELTY["ordered"].form) for value in values)]
        for method, values in zip(wide.index, wide.to_numpy(), strict=True)
    ]
    heads = ["Method", *(SCORES[name].title for name in wide.columns[:-1]), "Strength of the frame"]
    return printed(heads, rows, [False, *[True] * (len(heads) - 1)])


def _mean_order(stored: pd.DataFrame) -> pd.DataFrame:
    """The rank correlation with errors by method and score, as its mean over the simulated."""
    simulated = stored[stored["scenario"].str.startswith("novelty-") & stored["ordered"].notna()]
    return simulated.pivot_table("ordered", "method", "score", sort=False)


def _images() -> str:
    wide = record("novelty").samples.pivot_table("psnr", "method", "scenario", sort=False)
    columns = [f"novelty-{name}" for name in _SHOWN]
    wide = wide[columns].sort_values(columns[0], ascending=False)
    heads = ["Method", *map(_condition, columns)]
    rows = [
        [f"`{method}`", *(_text(value, _PSNR) for value in values)]
        for method, values in zip(wide.index, wide.to_numpy(), strict=True)
    ]
    return printed(heads, rows, [False, *[True] * len(columns)])


TABLES = {
    "novelty by condition": _aurocs,
    "novelty caught": _caught,
    "novelty and errors": _ordered,
    "images of conditions not known": _images,
}
