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


def _of_the_best(figure: str) -> str:
    """Another figure of the method with the best mean AUROC of each score."""
    stored = pd.read_csv(_OUT / "novelty.csv")
    best = by_condition(stored)["mean"].groupby("score", sort=False).idxmax()
    wide = by_condition(stored, figure)
    return _table(wide.loc[[row for row in best if row in wide.index]], figure)


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
    "novelty caught": lambda: _of_the_best("caught"),
    "novelty and errors": lambda: _of_the_best("ordered"),
    "images of conditions not known": _images,
}
