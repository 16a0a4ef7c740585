"""Tables of what methods state of their images: uncertainty and novelty."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import TYPE_CHECKING, Any

from eitbench.reports.site.pages import Cell, Table, Text, link

if TYPE_CHECKING:
    from eitbench.reports.findings.finding import Finding
    from eitbench.reports.site.edition import Edition, SuitePart

MOST_STATED = 60
"""Rows of a track that a suite's page shows."""
STATED = ("uncertainty", "novelty")


def stated_tables(suite: SuitePart) -> list[Table]:
    """The tracks of a suite on stated uncertainty and on novelty, unless they are very long."""
    return [
        _finding_table(found)
        for found in suite.found
        if found.stem in STATED and len(found.grid) <= MOST_STATED
    ]


def _finding_table(found: Finding) -> Table:
    """A finding with its methods first."""
    heads, *rows = found.grid
    first = heads.index("Method")
    words = {"Scenario", "Score", "Ties"}
    table: list[list[Text | Cell]] = [
        [
            row[first],
            *(
                Cell(text, "" if head in words else "number")
                for k, (head, text) in enumerate(zip(heads, row, strict=True))
                if k != first
            ),
        ]
        for row in rows
    ]
    others = [head for k, head in enumerate(heads) if k != first]
    note = f"{found.legend} The figure is in the full report."
    return Table(found.title, ["Method", *others], table, note)


def method_stated_table(name: str, edition: Edition) -> Table | None:
    """How far what a method states of its images can be relied on; None where it states nothing."""
    said: dict[tuple[str, str], dict[Hashable, Any]] = {}
    files = {suite.name: suite.file for suite in edition.suites}
    for suite in edition.suites:
        for found in suite.found:
            if found.stem not in STATED:
                continue
            for row in found.table[found.table["method"] == name].to_dict("records"):
                of = said.setdefault((suite.name, str(row["scenario"])), {})
                if row.get("score", "novelty") == "novelty":  # others are not of the method
                    of |= row
    rows: list[list[Text | Cell]] = [
        [link(suite, files[suite], "../"), scenario, *_stated_cells(of)]
        for (suite, scenario), of in said.items()
        if of
    ]
    if not rows:
        return None
    heads = ["Suite", "Scenario", "Rank", "CRPS [S/m]", "In 95 %", "Place in 95 %", "AUROC"]
    note = (
        "Rank by CRPS, a proper score of stated uncertainty: the lower, the better. In 95 %: share "
        "of pixels and of places whose truth lies in the region of that level. AUROC: how often "
        "the novelty that it states is greater for a frame of a condition that it does not know "
        "than for a familiar one; 0.5 is a coin."
    )
    return Table("What it says beside its images", heads, rows, note)


def _stated_cells(row: Mapping[Hashable, Any]) -> list[Text | Cell]:
    """Rank, CRPS, coverages and AUROC of a row of a finding, as far as it has them."""
    forms = {
        "rank": ".0f",
        "crps": ".5f",
        "coverage_95": ".1%",
        "place_coverage_95": ".1%",
        "auroc": ".3f",
    }
    found = ((row.get(key, math.nan), form) for key, form in forms.items())
    return [
        Cell("–" if value is None or math.isnan(value) else format(value, form), "number")
        for value, form in found
    ]
