"""Tables of novelty, from the record in `docs/studies/novelty`."""

import math

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES
from eitbench.reports.findings.novelty import by_condition

_OUT = STUDIES / "novelty"
_PSNR = ".1f"
_SHOWN = (
    "familiar", "conductive", "dead-electrode", "stale-reference", "other-sensor", "untouched",
)  # fmt: skip


def _condition(scenario: str) -> str:
    return scenario.removeprefix("novelty-").replace("-", " ")


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)


def _table(wide: pd.DataFrame, figure: str) -> str:
    heads = ["Method", "Score", *map(_condition, wide.columns[:-1]), "Mean of the simulated"]
    rows = [
        [f"`{method}`", SCORES[score].title.lower(),
         *(_text(value, NOVELTY[figure].form) for value in values)]
        for (method, score), values in zip(wide.index, wide.to_numpy(), strict=True)
    ]  # fmt: skip
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


def _aurocs() -> str:
    return _table(by_condition(pd.read_csv(_OUT / "novelty.csv")), "auroc")


def _caught() -> str:
    """Of the method with the best mean AUROC of each score."""
    stored = pd.read_csv(_OUT / "novelty.csv")
    best = by_condition(stored)["mean"].groupby("score", sort=False).idxmax()
    return _table(by_condition(stored, "caught").loc[best.tolist()], "caught")


def _ordered() -> str:
    """Means over the conditions of the simulated sensor, by method and score."""
    stored = pd.read_csv(_OUT / "novelty.csv")
    simulated = stored[stored["scenario"].str.startswith("novelty-") & stored["ordered"].notna()]
    wide = simulated.pivot_table("ordered", "method", "score", sort=False)
    wide = wide[[name for name in SCORES if name in wide]].sort_values("residual", ascending=False)
    rows = [
        [f"`{method}`", *(_text(value, NOVELTY["ordered"].form) for value in values)]
        for method, values in zip(wide.index, wide.to_numpy(), strict=True)
    ]
    heads = ["Method", *(SCORES[name].title for name in wide.columns)]
    return printed(heads, rows, [False, *[True] * (len(heads) - 1)])


def _images() -> str:
    stored = pd.read_csv(_OUT / "images.csv")
    wide = stored.pivot_table("psnr", "method", "scenario", sort=False)
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
