"""What a report says, as plain values: statistics and images of runs, gathered once.

The page, the tables and the figures are made of this alone, so that they can be made again without
reading the runs.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark import DataCorruptError, InputError
from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.analysis.results import Run, failures, read_run
from eitbench.benchmark.analysis.sensitivity import SAMPLES, sensitivity
from eitbench.benchmark.analysis.standings import Standing, score_weights, standings
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.scores import anchored
from eitbench.benchmark.metrics.specs import ANCHORS, METRIC_COLUMNS, METRICS
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.claims.claims import CLAIMS
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.verdicts import Verdict
from eitbench.reports.page.images import packed_images
from eitbench.reports.tables.columns import printable, shown_columns
from eitbench.reports.tables.leaderboard import (
    costs_of_failures,
    differences,
    overlaps,
    prior_knowledge,
    tracks_table,
)
from eitbench.reports.tables.published import comparison

Gathered = dict[str, Any]

PRESSES = 150
"""Drawn of a recorded scenario; more would hide each other."""


def gather(paths: Sequence[Path]) -> Gathered:
    """Everything that a report shows of the run directories.

    What is missing of a run (images, samples, columns) is left out and said under `missing`.

    Raises:
        InputError: no run directory, one without results, or runs of methods and of operators.
        DataCorruptError: a table of a run is damaged.
    """
    missing: list[str] = []
    runs = [_with_all_columns(read_run(path), missing) for path in paths]
    kinds = {
        kind: [run for run in runs if run.kind.name == kind] for kind in ("method", "operator")
    }
    boards: list[Gathered] = []
    for of in filter(None, kinds.values()):
        for standing in standings(of):
            boards.append(_board(standing, of, missing))
    for run in runs:
        missing += _incomplete(run)
    if not boards:
        raise InputError(
            f"There are no results in {', '.join(map(str, paths))}: nothing to report."
        )
    found: Gathered = _plain(
        {
            "boards": boards,
            "cards": [spec.card() for spec in METRICS.values() if _any_has(boards, spec.name)],
            "score_weights": score_weights(),
            "claims": _claims(runs, missing),
            "missing": list(dict.fromkeys(missing)),
            "runs": [_provenance(run) for run in runs],
        }
    )
    return found


def _with_all_columns(run: Run, missing: list[str]) -> Run:
    """The run with empty columns where figures are missing that a run of methods has."""
    if run.kind != METHOD_RUNS or run.samples.empty:
        return run
    lacking = [name for name in METRIC_COLUMNS if name not in run.samples]
    missing += [
        f"{run.path.name} has no column {name!r}, and nothing that rests on it is shown: score it "
        f"again with `eitbench rescore {run.path}`."
        for name in lacking
    ]
    return replace(run, samples=run.samples.assign(**dict.fromkeys(lacking, np.nan)))


def _claims(runs: Sequence[Run], missing: list[str]) -> list[Gathered]:
    """What the runs say of the published claims, of which they can say something."""
    evidence = Evidence(runs)
    found = []
    for claim in CLAIMS:
        try:
            finding = claim.finding(evidence)
        except InputError as error:  # several runs hold the same method
            missing.append(f"Claim {claim.name}: {error}")
            continue
        if finding.verdict != Verdict.untestable:
            found.append(
                {"claim": claim.says, "verdict": finding.verdict.value, "why": finding.why}
            )
    return found


def _plain(value: Any) -> Any:
    """The same with None for what is no finite number, as JSON wants it."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _any_has(boards: Sequence[Gathered], name: str) -> bool:
    return any(row.get(name) is not None for board in boards for row in board["views"][0]["rows"])


def _incomplete(run: Run) -> list[str]:
    said = list(run.manifest.get("skipped", {}).values()) + failures(run)
    status = run.manifest.get("status", "finished")
    if status != "finished":
        said.append(f"The run {run.path.name} is {status}: it has some of its samples only.")
    return said


def _board(standing: Standing, runs: Sequence[Run], missing: list[str]) -> Gathered:
    first = standing.rows[0]
    scenario, kind = first["scenario"], "operator" if "operator" in first else "method"
    of_board = [run for run in runs if run.path.name in {row["run"] for row in standing.rows}]
    board: Gathered = {
        "suite": first["suite"],
        "scenario": scenario,
        "kind": kind,
        "n": first["data_n"] or first["n"],
        "data_hash": first["data_hash"],
        "inverse_crime": first["inverse_crime"],
        "phantoms": standing.phantoms,
        "why_not": standing.why_not,
        "ranked_by": first.get("ranked_by") or "mse",
        "columns": [vars(column) for column in shown_columns(standing.rows)],
        "notes": [
            *comparison(standing.rows),
            *costs_of_failures(standing.rows),
            *overlaps(standing.rows),
            *differences(standing.rows),
        ],
        "prior_knowledge": prior_knowledge(standing.rows),
        "tracks": tracks_table(standing.rows),
        "views": [_view("all samples", standing, runs)],
        "pairs": [vars(pair) for pair in standing.pairs],
        "snr_db": None,
        "sensitivity": [],
        "images": None,
        "presses": [],
    }
    if kind == "operator":
        return board
    of = {run.path.name: run for run in of_board}
    methods = {row["label"]: (of[row["run"]], row["method"]) for row in board["views"][0]["rows"]}
    cells = {label: run.cell(scenario, name) for label, (run, name) in methods.items()}
    rows = pd.concat([_rows(run, scenario) for run in of_board], ignore_index=True)
    board["views"] += _parts(of_board, scenario, rows)
    if first["score"] is not None and "snr_db" in rows:
        levels = rows["snr_db"].unique()
        board["snr_db"] = None if len(levels) > 1 else "clean" if np.isnan(levels[0]) else levels[0]
    board["presses"] = _presses(cells)
    for row in board["views"][0]["rows"]:
        row["anchored"] = _anchored(cells[row["label"]])
    with_images = {label: of for label, of in methods.items() if _has_images(of[0], missing)}
    try:
        board["sensitivity"] = [vars(found) for found in sensitivity(with_images, scenario)]
        if with_images:
            board["images"] = packed_images(with_images, scenario, first["ranked_by"])
    except DataCorruptError as error:
        missing.append(str(error))
    board["sensitivity_samples"] = min(SAMPLES, first["n"])
    return board


def _has_images(run: Run, missing: list[str]) -> bool:
    there = (run.path / run.kind.arrays).is_file()
    if not there:
        missing.append(f"{run.path.name} holds no {run.kind.arrays}: its images are not shown.")
    return there


def _anchored(cell: pd.DataFrame) -> list[float] | None:
    """Means of SSIM, CC, RIE and PSNR between their anchors; None where they are not known."""
    if any(name not in cell or cell[name].isna().any() for name in ANCHORS):
        return None
    means: list[float] = (
        anchored({name: numbers(cell, name) for name in ANCHORS}).mean(axis=0).tolist()
    )
    return means


def _rows(run: Run, scenario: str) -> pd.DataFrame:
    return run.samples[run.samples["scenario"] == scenario]


def _view(label: str, standing: Standing, runs: Sequence[Run]) -> Gathered:
    """The rows of a board, or of a part of its samples, with the command that makes each.

    Their `label` is the name of the method or operator, with that of the run where several have it.
    """
    plans = {run.path.name: run for run in runs}
    names = [row.get("method") or row["operator"] for row in standing.rows]
    rows = [
        row
        | {
            "command": _command(plans[row["run"]], row),
            "label": name if names.count(name) == 1 else f"{name} ({row['run']})",
        }
        for row, name in zip(standing.rows, names, strict=True)
    ]
    return {
        "label": label,
        "phantoms": standing.phantoms,
        "why_not": standing.why_not,
        "rows": rows,
    }


def _parts(runs: Sequence[Run], scenario: str, rows: pd.DataFrame) -> list[Gathered]:
    """Standings of the samples of each family, and of each noise level if there are several."""
    found = []
    for name, form in (("family", "{}"), ("snr_db", "{:g} dB")):
        values = [] if name not in rows else sorted(rows[name].dropna().unique())
        for value in values if len(values) > 1 else ():
            n = rows.loc[rows[name] == value, "sample"].nunique()
            of_part = [_part(run, scenario, name, value, n) for run in runs]
            (standing,) = standings([run for run in of_part if len(run.samples)])
            found.append(_view(form.format(value), standing, runs))
    return found


def _part(run: Run, scenario: str, name: str, value: Any, n: int) -> Run:
    """A run with those `n` samples of a scenario alone whose column `name` holds `value`."""
    rows = _rows(run, scenario)
    part = rows[rows[name] == value] if name in rows else rows[:0]
    data = run.manifest["data"][scenario] | {"n": n}
    return replace(run, samples=part, manifest={**run.manifest, "data": {scenario: data}})


def _command(run: Run, row: Row) -> str:
    """What makes a cell again."""
    plan = run.manifest.get("plan", {})
    kind = "operators" if "operator" in row else "methods"
    words = ["eitbench", "run", str(row["suite"]), "--scenarios", str(row["scenario"])]
    words += [f"--{kind}", str(row.get("operator") or row["method"])]
    if plan.get("limit") is not None:
        words += ["--limit", str(plan["limit"])]
    for plugin in plan.get("plugins", ()):
        if (row.get("operator") or row["method"]) in plugin["names"]:
            words += ["--plugin", Path(plugin["path"]).name]
    return shlex.join(words)


def _presses(cells: Mapping[str, pd.DataFrame]) -> list[Gathered]:
    """Where presses were and where each method found them, in its image's frame [m]."""
    found = []
    for label, cell in cells.items():
        if cell["expected_x_m"].notna().any():
            rows = cell.sort_values("sample")[:PRESSES]
            names = ("expected_x_m", "expected_y_m", "found_x_m", "found_y_m", "localisation_mm")
            columns = {name: _plain_list(numbers(rows, name)) for name in names}
            found.append({"method": label, **columns})
    return found


def _plain_list(values: Any) -> list[float | None]:
    return [float(f"{v:.5g}") if np.isfinite(v) else None for v in values]


def _provenance(run: Run) -> Gathered:
    content: Mapping[str, Any] = run.manifest
    names = ("command_line", "started", "finished", "status", "git_commit", "versions", "machine",
             "threads", "seeds", "calibration_ms", "data", "cells", "plan")  # fmt: skip
    return {
        "run": printable(run.path.name),
        "kind": run.kind.name,
        **{name: content.get(name) for name in names},
        "registered": run.kind == METHOD_RUNS,
    }
