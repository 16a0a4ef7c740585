"""The data of a report as plain values: statistics and images of runs, read once.

The page, the tables and the figures are made of these alone.
"""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
import pandas as pd

from eitbench.benchmark import DataCorruptError, EitbenchError, InputError
from eitbench.benchmark.analysis.catalogue import suite_options
from eitbench.benchmark.analysis.leaderboard import Row, is_whole
from eitbench.benchmark.analysis.overall import overall
from eitbench.benchmark.analysis.results import (
    Run,
    code_place,
    describe_training,
    failures,
)
from eitbench.benchmark.analysis.sensitivity import SAMPLES, sensitivity
from eitbench.benchmark.analysis.standings import Standing, score_weights, standings
from eitbench.benchmark.findings.acuity_seen import has_acuity
from eitbench.benchmark.findings.acuity_specs import ACUITY_SPECS
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES
from eitbench.benchmark.metrics.specs import ANCHORS, METRICS, anchored
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import kept_open
from eitbench.reports.claims.claim import Verdict
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.page.error_maps import error_maps
from eitbench.reports.page.images import packed_images, shown_families
from eitbench.reports.tables.boards import notes, prior_knowledge, told_apart, tracks_table
from eitbench.reports.tables.columns import printable, shown_columns

PRESSES = 150
"""Drawn of a recorded scenario; more would hide each other."""

MOST_SINGLE = 12
"""Scenarios of a report that has boards of parts of each, what orders depend on, and figures as
files: those of more would take minutes."""

VARIED_SAMPLES = 600
"""Samples of all boards whose figures are computed in other ways."""

PAGE_COLUMNS = ("command", "label", "anchored", "training", "code")
"""Columns that the rows of a view have beside those of `Standing.rows`: the command that makes the
cell again; the name of the method or operator, with that of the run where several have it; means of
SSIM, CC, RIE and PSNR between their anchors; its training data, see `describe_training`, None where
nothing is known; and where its code is."""


class View(TypedDict):
    """The standing over all samples of a board or over a part of them; see `Standing`."""

    label: str
    clusters: int
    why_not: str
    rows: list[Row]


class BoardData(TypedDict):
    """Methods, or operators, on the same data of a scenario.

    `kind` is "method" or "operator". `name` is of suite and scenario, with `apart` where others
    share both: size and hash of the data, "" where none do. `columns`, `pairs` and `sensitivity`
    hold the fields of `Column`, `Pair` and `Sensitivity`. The first of `views` is that of all
    samples. `snr_db` is "clean" for data without noise, and None for several levels or unknown
    ones; `touch_snr_db` is the median over samples. `sensor` is "" where it is not known,
    `recorded` true if the data are of a real one. `presses` holds for each method the places of
    presses and those that it found [m], in the coordinates of its image. `maps` is what
    `error_maps` returns.
    """

    suite: str
    scenario: str
    name: str
    apart: str
    kind: str
    n: int
    data_hash: str
    inverse_crime: bool
    sensor: str
    recorded: bool
    clusters: int
    why_not: str
    ranked_by: str
    columns: list[dict[str, Any]]
    notes: list[str]
    prior_knowledge: list[str]
    tracks: list[list[str]]
    views: list[View]
    pairs: list[dict[str, Any]]
    snr_db: float | str | None
    touch_snr_db: float | None
    sensitivity: list[dict[str, Any]]
    images: dict[str, Any] | None
    presses: list[dict[str, Any]]
    maps: dict[str, Any] | None
    sensitivity_samples: NotRequired[int]


_PROVENANCE = (
    "command_line", "started", "finished", "status", "git_commit", "versions", "machine", "threads",
    "seeds", "calibration_ms", "data", "cells", "plan", "added",
)  # fmt: skip


class ReportData(TypedDict):
    """Everything that a report shows.

    `cards` holds `MetricSpec.card` of each metric that a board has, and of acuity; `claims` the
    published claims that the runs can test, with their verdicts; `missing` sentences on what the
    runs lack; `runs` the origin of each as in its manifest, None where that lacks it, and the
    sources of methods. `overall` has the views of `overall_views`.
    """

    boards: list[BoardData]
    overall: dict[str, dict[str, Any]]
    cards: list[dict[str, Any]]
    score_weights: dict[str, float]
    claims: list[dict[str, str]]
    missing: list[str]
    runs: list[dict[str, Any]]


def report_of(runs: Sequence[Run]) -> ReportData:
    """Return everything that a report shows of runs.

    Images and samples that a run lacks are left out, and `missing` says so.

    Raises:
        InputError: runs without results, or of methods and of operators.
    """
    missing: list[str] = []
    found = [
        (standing, apart, of_kind)
        for kind in ("method", "operator")
        if (of_kind := [run for run in runs if run.kind.name == kind])
        for standing, apart in _told_apart(standings(of_kind))
    ]
    columns = sum(len(standing.rows) + 1 for standing, _, _ in found)  # of images, with the truth
    families = shown_families(columns)
    varied = min(SAMPLES, VARIED_SAMPLES // max(1, len(found)))
    single = len(found) <= MOST_SINGLE
    with ExitStack() as files:
        for run in runs:
            files.enter_context(kept_open(run.path / run.kind.arrays))
        boards = [_board(*of, missing, families, varied, parts=single) for of in found]
    name_kinds(boards)
    for run in runs:
        missing += _incomplete(run)
    if not single:
        missing.append(
            "Boards of single families and noise levels, and files of figures of single scenarios "
            f"(frontier, comparison, maps): a report of more than {MOST_SINGLE} scenarios has "
            f"none, and this one has {len(boards)}. A run has those figures in its folder figures."
        )
    if not boards:
        raise InputError(
            f"There are no results in {', '.join(str(run.path) for run in runs)}: nothing to "
            "report."
        )
    report = ReportData(
        boards=boards,
        overall=overall_views([board for board in boards if board["kind"] == "method"]),
        cards=[
            spec.card()
            for spec in METRICS.values()
            if any(row.get(spec.name) is not None for row in rows_of(boards))
        ]
        + [spec.card() for spec in ACUITY_SPECS.values() if any(map(has_acuity, runs))]
        + [
            spec.card()
            for spec in (SCORES | UNCERTAINTY).values()
            if any(spec.name in run.samples for run in runs)
        ]
        + [
            spec.card()
            for spec in NOVELTY.values()
            if any("residual" in run.samples for run in runs)
        ],
        score_weights=score_weights(),
        claims=_claims(runs, missing),
        missing=list(dict.fromkeys(missing)),
        runs=[_provenance(run) for run in runs],
    )
    plain: ReportData = _plain(report)
    return plain


FAST_MS = 10.0
"""A frame that takes less passes the filter of fast methods."""


def overall_views(boards: Sequence[BoardData]) -> dict[str, dict[str, Any]]:
    """The fields of `Overall` under each choice of the page's filters, where there are any.

    A key is "untrained" or "", "fast" or "", and a sensor or "", joined by "|": methods without
    training data, methods that take less than `FAST_MS` for a frame on every scenario, and the
    scenarios of one sensor. Rows without all samples or without a figure do not count; of several
    data sets of a scenario, the one with the most samples does.
    """
    views = {}
    sensors = dict.fromkeys(board["sensor"] for board in boards)
    choices = product(("", "untrained"), ("", "fast"), dict.fromkeys(["", *sensors]))
    for untrained, fast, sensor in choices:
        figures, guesses = {}, {}
        for board in largest(boards):
            if not sensor or board["sensor"] == sensor:
                rows = board["views"][0]["rows"]
                if board["ranked_by"] == "localisation_mm" and (guess := rows[0]["guess_mm"]):
                    guesses[board["name"]] = guess
                kept = {
                    row["label"]
                    for row in rows
                    if not (untrained and row["training"] != "")
                    and not (fast and not (row["frame_ms_p50"] or FAST_MS) < FAST_MS)
                }
                known = ranking_figures(board)
                figures[board["name"]] = {name: known[name] for name in known if name in kept}
        if found := overall(figures, guesses):
            views[f"{untrained}|{fast}|{sensor}"] = asdict(found)
    return views


def ranking_figures(board: BoardData) -> dict[str, float]:
    """The figure that ranks each method with all samples, by label; more is better."""
    by = board["ranked_by"]
    sign = METRICS[by].sign if by in METRICS else 1.0
    return {
        row["label"]: sign * row[by]
        for row in board["views"][0]["rows"]
        if row.get(by) is not None and is_whole(row)
    }


def largest(boards: Sequence[BoardData]) -> list[BoardData]:
    """Return the board with the most samples of each scenario."""
    largest: dict[tuple[str, str], BoardData] = {}
    for board in boards:
        of = largest.setdefault((board["suite"], board["scenario"]), board)
        if board["n"] > of["n"]:
            largest[board["suite"], board["scenario"]] = board
    return list(largest.values())


def counted_data(boards: Sequence[BoardData]) -> str:
    """Say which data sets count over all scenarios; "" where each scenario has but one."""
    methods = [board for board in boards if board["kind"] == "method"]
    named = [board["name"] for board in largest(methods) if board["apart"]]
    if not named:
        return ""
    return (
        "Where runs of a scenario used different data, the largest data set counts: "
        f"{printable(', '.join(named))}. Methods that ran on other data only are left out there."
    )


def _sensor(run: Run, scenario: str) -> tuple[str, bool]:
    """Return the sensor of a scenario, and if the data are recorded."""
    declared = run.manifest["plan"]["suite"]["scenarios"]
    recorded = any((s.get("name"), s.get("kind")) == (scenario, "recorded") for s in declared)
    return run.manifest["data"][scenario]["sensor"], recorded


def name_kinds(boards: Sequence[BoardData]) -> None:
    """Add what is ranked to the names that boards of methods and of operators share."""
    kinds: dict[str, set[str]] = {}
    for board in boards:
        kinds.setdefault(board["name"], set()).add(board["kind"])
    for board in boards:
        if len(kinds[board["name"]]) > 1:
            board["name"] += f" ({board['kind']}s)"


def _claims(runs: Sequence[Run], missing: list[str]) -> list[dict[str, str]]:
    """Return the verdicts on those published claims that the runs can test."""
    evidence = Evidence(runs)
    verdicts = []
    for claim in CLAIMS:
        try:
            judgement = claim.judgement(evidence)
        except InputError as error:  # several runs hold the same method
            missing.append(f"Claim {claim.name}: {error}")
            continue
        if judgement.verdict != Verdict.untestable:
            says = {"claim": claim.says, "verdict": judgement.verdict.value, "why": judgement.why}
            verdicts.append(says)
    return verdicts


def _plain(value: Any) -> Any:
    """Return a value as JSON wants it, with None for a number that is not finite."""
    if isinstance(value, str):
        return value
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def rows_of(boards: Sequence[BoardData]) -> list[Row]:
    """The rows of boards over all samples."""
    return [row for board in boards for row in board["views"][0]["rows"]]


def _incomplete(run: Run) -> list[str]:
    """Return sentences on the cells, samples and rest of a run that are missing."""
    sentences = [*run.manifest["skipped"].values(), *failures(run)]
    status = run.manifest["status"]
    if status != "finished":
        sentences.append(f"The run {run.path.name} is {status}: it has some of its samples only.")
    return sentences


def _told_apart(found: Sequence[Standing]) -> list[tuple[Standing, str]]:
    return list(zip(found, told_apart([of.rows[0] for of in found]), strict=True))


def _board(
    standing: Standing,
    apart: str,
    runs: Sequence[Run],
    missing: list[str],
    families: int,
    varied: int,
    *,
    parts: bool,
) -> BoardData:
    first = standing.rows[0]
    scenario, kind = first["scenario"], "operator" if "operator" in first else "method"
    view = _view("all samples", standing, runs)
    of_first = next(run for run in runs if run.path.name == first["run"])
    sensor, recorded = _sensor(of_first, scenario)
    board = BoardData(
        suite=first["suite"],
        scenario=scenario,
        name=f"{first['suite']} / {scenario}" + (f" ({apart})" if apart else ""),
        apart=apart,
        kind=kind,
        n=first["data_n"],
        data_hash=first["data_hash"],
        inverse_crime=first["inverse_crime"],
        sensor=sensor,
        recorded=recorded,
        clusters=standing.clusters,
        why_not=standing.why_not,
        ranked_by=first.get("ranked_by") or "mse",
        columns=[vars(column) for column in shown_columns(standing.rows)],
        notes=notes(standing.rows),
        prior_knowledge=prior_knowledge(standing.rows),
        tracks=tracks_table(standing.rows),
        views=[view],
        pairs=[vars(pair) for pair in standing.pairs],
        snr_db=None,
        touch_snr_db=first.get("touch_snr_db"),
        sensitivity=[],
        images=None,
        presses=[],
        maps=None,
    )
    if kind == "operator":
        return board
    run_of = {run.path.name: run for run in runs}
    methods = {row["label"]: (run_of[row["run"]], row["method"]) for row in view["rows"]}
    cells = {label: run.cell(scenario, name) for label, (run, name) in methods.items()}
    of_board = [run for run in runs if run.path.name in {row["run"] for row in view["rows"]}]
    samples = pd.concat([_samples(run, scenario) for run in of_board], ignore_index=True)
    if parts:
        board["views"] += _parts(of_board, scenario, samples)
    if first["score"] is not None and "snr_db" in samples:
        levels = samples["snr_db"].unique()
        board["snr_db"] = None if len(levels) > 1 else "clean" if np.isnan(levels[0]) else levels[0]
    board["presses"] = [
        _presses(label, cell) for label, cell in cells.items() if cell["expected_x_m"].notna().any()
    ]
    try:
        board["maps"] = error_maps(methods, cells, scenario)
    except EitbenchError as error:  # the sensor of one's own recording
        missing.append(str(error))
    for row in view["rows"]:
        row["anchored"] = _anchored(cells[row["label"]])
    with_images = {label: of for label, of in methods.items() if _has_images(of[0], missing)}
    try:
        if parts:
            found = sensitivity(with_images, scenario, varied)
            board["sensitivity"] = [vars(choice) for choice in found]
        if with_images:
            by = first["ranked_by"]
            board["images"] = packed_images(with_images, scenario, by, families)
    except DataCorruptError as error:
        missing.append(str(error))
    board["sensitivity_samples"] = min(varied, first["n"])
    return board


def _has_images(run: Run, missing: list[str]) -> bool:
    there = (run.path / run.kind.arrays).is_file()
    if run.kind != METHOD_RUNS:
        return False  # places are no images
    if not there:
        missing.append(f"{run.path.name} holds no {run.kind.arrays}: its images are not shown.")
    return there


def _anchored(cell: pd.DataFrame) -> list[float] | None:
    """Return means of SSIM, CC, RIE and PSNR between their anchors; None where one is unknown."""
    figures = {name: numbers(cell, name) for name in ANCHORS if name in cell}
    if len(figures) < len(ANCHORS) or any(np.isnan(of).any() for of in figures.values()):
        return None
    return list(anchored(figures).mean(axis=0))


def _samples(run: Run, scenario: str) -> pd.DataFrame:
    return run.samples[run.samples["scenario"] == scenario]


def _view(label: str, standing: Standing, runs: Sequence[Run]) -> View:
    run_of = {run.path.name: run for run in runs}
    scenario = standing.rows[0]["scenario"]
    training = {name: _training(run, scenario) for name, run in run_of.items()}
    names = [row.get("method") or row["operator"] for row in standing.rows]
    rows = [
        row
        | {
            "command": _command(run_of[row["run"]], row),
            "label": name if names.count(name) == 1 else f"{name} ({row['run']})",
            "training": training[row["run"]].get(name),
            "code": code_place(run_of[row["run"]], name),
        }
        for row, name in zip(standing.rows, names, strict=True)
    ]
    return View(label=label, clusters=standing.clusters, why_not=standing.why_not, rows=rows)


def _parts(runs: Sequence[Run], scenario: str, samples: pd.DataFrame) -> list[View]:
    """Return a view of the samples of each family, and of each noise level if there are several."""
    views = []
    for column, form in (("family", "{}"), ("snr_db", "{:g} dB")):
        values = [] if column not in samples else sorted(samples[column].dropna().unique())
        for value in values if len(values) > 1 else ():
            n = samples.loc[samples[column] == value, "sample"].nunique()
            parts = [_part(run, scenario, column, value, n) for run in runs]
            (standing,) = standings([run for run in parts if len(run.samples)])
            views.append(_view(form.format(value), standing, runs))
    return views


def _part(run: Run, scenario: str, column: str, value: Any, n: int) -> Run:
    """Return a run with only those `n` samples of a scenario whose `column` holds `value`."""
    rows = _samples(run, scenario)
    part = rows[rows[column] == value] if column in rows else rows[:0]
    data = run.manifest["data"][scenario] | {"n": n}
    return replace(run, samples=part, manifest={**run.manifest, "data": {scenario: data}})


def _command(run: Run, row: Row) -> str:
    """Return the command that makes the cell of a row again."""
    plan = run.manifest["plan"]
    kind = "operators" if "operator" in row else "methods"
    name = str(row.get("operator") or row["method"])
    scenario = str(row["scenario"])
    words = ["eitbench", "run", *suite_options(plan["suite"], scenario)]
    words += ["--scenarios", scenario, f"--{kind}", name]
    if plan["limit"] is not None:
        words += ["--limit", str(plan["limit"])]
    for plugin in plan["plugins"]:
        if name in plugin["names"]:
            words += ["--plugin", Path(plugin["path"]).name]
    if (given := run.parameters.get((row["scenario"], name))) is not None:
        words += ["--parameters", json.dumps({name: given}, default=str)]
    return shlex.join(words)


def _training(run: Run, scenario: str) -> dict[str, str]:
    """The training data of methods on a scenario by name, where something is known of them."""
    if "prior_knowledge" not in run.cells or run.kind.name != "method":
        return {}
    of = run.cells[run.cells["scenario"] == scenario]
    told = dict(zip(of["method"], of["prior_knowledge"], strict=True))
    return {
        n: describe_training(text) for n, text in told.items() if isinstance(text, str) and text
    }


def _presses(label: str, cell: pd.DataFrame) -> dict[str, Any]:
    rows = cell.sort_values("sample")[:PRESSES]
    names = ("expected_x_m", "expected_y_m", "found_x_m", "found_y_m", "localisation_mm")
    places = {name: [float(f"{v:.5g}") for v in numbers(rows, name)] for name in names}
    return {"method": label, **places}


def _provenance(run: Run) -> dict[str, Any]:
    content = {name: run.manifest.get(name) for name in _PROVENANCE}
    sources = run.cells["source"].fillna("")
    content["sources"] = dict(zip(run.cells[run.kind.name], sources, strict=True))
    # Whether its methods were run again is known where runs are collected, see `site`.
    return {"run": printable(run.path.name), "kind": run.kind.name, "checked": "", **content}
