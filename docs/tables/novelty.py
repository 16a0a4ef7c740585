"""Tables of novelty, from the record in `docs/studies/novelty`."""

import math

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES
from eitbench.reports.findings.novelty import by_condition

_OUT = STUDIES / "novelty"
_PSNR = ".1f"
_SHOWN = ("familiar", "conductive", "dead-electrode", "stale-reference", "other-sensor")


def _condition(scenario: str) -> str:
    return scenario.removeprefix("novelty-").replace("-", " ")


def _text(value: float, form: str) -> str:
    return "–" if math.isnan(value) else format(value, form)


def _by_condition(figure: str) -> str:
    stored = pd.read_csv(_OUT / "novelty.csv")
    auroc = by_condition(stored)
    stored["auroc"] = stored[figure]
    wide = by_condition(stored).loc[auroc.index]  # in the order of the mean AUROC
    heads = ["Method", "Score", *map(_condition, wide.columns[:-1]), "Mean"]
    rows = [
        [f"`{method}`", SCORES[score].title.lower(),
         *(_text(value, NOVELTY[figure].form) for value in values)]
        for (method, score), values in zip(wide.index, wide.to_numpy(), strict=True)
    ]  # fmt: skip
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


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
    "novelty by condition": lambda: _by_condition("auroc"),
    "novelty caught": lambda: _by_condition("caught"),
    "images of conditions not known": _images,
}
