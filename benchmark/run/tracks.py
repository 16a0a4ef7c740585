"""Tracks that are run beside the ranked one; `analysis.standings.track_gaps` compares them.

`default` are a method's own parameters, `tuned` those selected on validation data, and `oracle` the
best on the test split among all that were tried: the limit of tuning. `given` are parameters of
the user's choice, which are ranked, and named so, in place of those. The oracle has seen the test
split, so that it is shown as a gap and never ranked.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark.metrics.aggregation import figure_of
from eitbench.benchmark.run.cell_task import CellData, CellPlan
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import Manifest
from eitbench.benchmark.rundir.store import TRACKS, RunStore
from eitbench.benchmark.tuning.selection import at_edge

if TYPE_CHECKING:
    from eitbench.benchmark.rundir.plan import Plan


def cell_entries(plan: "Plan", data: CellData, name: str) -> list[Manifest]:
    """Return manifest entries for the cells of `name`, the ranked one first."""
    given = plan.parameters.get(name)
    code = plan.code(name) if plan.suite.ranks != "operators" else ""
    selection = data.selection(name, code)
    tuned: dict[str, Any] = selection or {"parameters": {}, "spent": {}, "trials": []}
    ranked = tuned["parameters"] if given is None else given
    spent = tuned["spent"] | {"edges": at_edge(tuned)} if selection else {}
    track = "default" if selection is None else "tuned"
    if data.scenario.calibrated:
        track = "calibrated"
    if given is not None:
        track = "given"
    cells: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
        ("", track, ranked, spent if given is None else {})
    ]
    # Without a choice the ranked track is it.
    if "default" in plan.tracks and not (selection is None and given is None):
        cells.append(("default", "default", {}, {}))
    if "tuned" in plan.tracks and selection is not None and given is not None:
        cells.append(("tuned", "tuned", tuned["parameters"], spent))
    if "oracle" in plan.tracks:
        # The first trial is that of the defaults.
        tried = [t["parameters"] for t in tuned["trials"] if t["status"] != "failed"]
        others = [parameters for parameters in tried if parameters != ranked]
        cells += [
            (f"trial-{k:02d}", "oracle", parameters, {}) for k, parameters in enumerate(others)
        ]
    return [
        {
            "scenario": data.scenario.name,
            "name": name,
            "variant": variant,
            "track": track,
            "parameters": parameters,
            "spent": spent,
            "weights": data.weights(name),
        }
        for variant, track, parameters, spent in cells
    ]


def write_tracks(store: RunStore, cells: Sequence[CellPlan]) -> None:
    """Write the rows of the tracks beside the ranked one, where these were run to the end."""
    tables = []
    for main in (plan for plan in cells if not plan.cell.variant):
        others = [c for c in cells if c.cell.variant and replace(c.cell, variant="") == main.cell]
        if not others or not all(store.finished(c.cell) for c in (main, *others)):
            continue
        rows = {c.cell.variant: (c.parameters, store.rows(c.cell)) for c in (main, *others)}
        tables += [_labelled(of, *rows[of]) for of in ("default", "tuned") if of in rows]
        if any(c.track == "oracle" for c in others):
            best = max(rows.values(), key=lambda pair: _goodness(pair[1]))
            tables.append(_labelled("oracle", *best))
    if tables:
        store.write_table(TRACKS, pd.concat(tables, ignore_index=True))


def _labelled(track: str, parameters: dict[str, Any], rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(track=track, parameters=json.dumps(parameters, default=str))


def _goodness(rows: pd.DataFrame) -> float:
    """Return the figure that ranks, larger better."""
    for name in METHOD_RUNS.ranked_by:
        spec = METHOD_RUNS.metrics[name]
        value = figure_of(rows, spec)
        if np.isfinite(value):
            return spec.sign * value
    return -np.inf
