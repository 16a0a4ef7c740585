"""The rows of a leaderboard: figures of every method or operator on every scenario, ranked."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_float_dtype

from eitbench.benchmark.analysis.results import (
    NOTES,
    Run,
    describe_actions,
    describe_prior_knowledge,
)
from eitbench.benchmark.ceiling.record import below_ceiling
from eitbench.benchmark.metrics.aggregation import aggregate, numbers
from eitbench.benchmark.metrics.statistics import once
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.kinds import RunKind
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import SNR_COLUMNS
from eitbench.scenarios.errors import InputError

Row = dict[str, Any]
"""Plain values by column: `suite`, `scenario`, `method` or `operator`, `run`, `n`, `coverage`,
`rank`, a figure for each metric and cost of its `RunKind` and more, see `Standing`."""

SAME = 1e-3
"""Repeats may differ by this share of a figure: the rounding of another machine's arithmetic."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A method or operator on a board.

    Attributes:
        run: where it was run, the newest of its repeats.
        row: its row of the leaderboard.
        cell: its samples.
        runs: names of the runs that repeat it, the oldest first, and of `run` at the end.
        rivals: number of methods among which it is compared: those that its suite lists, or that a
            run of it holds on the scenario, if these are more.
    """

    run: Run
    row: Row
    cell: pd.DataFrame
    runs: tuple[str, ...]
    rivals: int


def leaderboard_rows(runs: Sequence[Run]) -> list[Row]:
    """Return a row per run, scenario and method (or operator), ranked among those of the same data.

    Repeats are one row, that of the newest run: the same method, parameters, weights and plugin on
    the same data with the same results. `repeats` names the others; it is None without any.

    Figures are what each metric makes of the samples, a mean, a median or another (see its
    `aggregate`); failed samples are charged what an image of the untouched sensor gets. They are
    None where not defined, or where all failed. The best value has rank 1, those that lack samples
    come after those that have all, those without a figure last, and equals share a rank. Operators
    have figures of their valid samples only, and rank after those that lost none.

    Raises:
        InputError: some of the runs rank methods and others operators.
    """
    return [entry.row for board in ranked_boards(runs) for entry in board]


def ranked_boards(runs: Sequence[Run]) -> list[list[Entry]]:
    """Return the rows of `leaderboard_rows` with their runs and samples, grouped by data.

    Raises:
        InputError: some of the runs rank methods and others operators, or two share a name.
    """
    for run in runs:
        if run.kind.name != runs[0].kind.name:
            raise InputError(
                f"{runs[0].path} ranks {runs[0].kind.name}s and {run.path} {run.kind.name}s: ask "
                "for their leaderboards one after the other."
            )
    for one, other in combinations([run.path for run in runs], 2):
        if one.resolve() == other.resolve():
            raise InputError(f"{one} is given twice.")
        if one.name == other.name:
            raise InputError(
                f"Two runs lie in folders of the same name {one.name!r} ({one}, {other}): rename "
                "one."
            )
    entries = []
    for run in runs:
        names = ["suite", "scenario", run.kind.name, *run.kind.labels]
        known, rivals = _known(run), _rivals(run)
        for values, cell in () if run.samples.empty else _filled(run).groupby(names, sort=False):
            of = dict(zip(names, map(str, values), strict=True))
            row = _row(run, of, cell, known.get(tuple(of.values())[1:], {}))
            entries.append(Entry(run, row, cell, (run.path.name,), rivals[row["scenario"]]))
    ranked = []
    for data in dict.fromkeys(_data_of(entry.row) for entry in entries):
        board = _without_repeats([entry for entry in entries if _data_of(entry.row) == data])
        kind = runs[0].kind
        by = ranking_figure([entry.row for entry in board], kind)
        keys = [_place(entry.row, by, kind) for entry in board]
        for entry, key in zip(board, keys, strict=True):
            entry.row["rank"] = 1 + sum(other < key for other in keys)
        board.sort(key=lambda entry: (entry.row["rank"], entry.row[entry.run.kind.name]))
        ranked.append(board)
    return ranked


def _filled(run: Run) -> pd.DataFrame:
    """The samples of a run without numbers that none of them has: most suites fill a part."""
    floats = [name for name in run.samples if is_float_dtype(run.samples[name])]
    empty = [name for name in floats if run.samples[name].isna().all()]
    return run.samples.drop(columns=empty)


def _without_repeats(entries: Sequence[Entry]) -> list[Entry]:
    """The entries, those that repeat one another together."""
    found: list[Entry] = []
    for entry in sorted(entries, key=lambda e: (e.run.manifest["started"], e.runs)):
        k = next((k for k, other in enumerate(found) if _repeats(entry, other)), None)
        if k is None:
            found.append(entry)
        else:
            rivals = max(entry.rivals, found[k].rivals)
            found[k] = replace(entry, runs=found[k].runs + entry.runs, rivals=rivals)
    for entry in found:
        entry.row["repeats"] = ", ".join(entry.runs[:-1]) or None
    return found


def _rivals(run: Run) -> dict[str, int]:
    """Number of methods among which those of each scenario are compared, see `Entry`."""
    if run.samples.empty:
        return {}
    listed = len(run.manifest["plan"]["suite"].get(f"{run.kind.name}s") or ())
    held = run.samples.groupby("scenario")[run.kind.name].nunique()
    return {str(name): max(int(count), listed) for name, count in held.items()}


def _repeats(entry: Entry, other: Entry) -> bool:
    """True if two entries are one method with the same parameters, code and results."""
    if entry.run is other.run or made_with(entry) != made_with(other):
        return False
    cells = [of.cell.sort_values("sample") for of in (entry, other)]
    if any(list(cells[0][name]) != list(cells[1][name]) for name in ("sample", "status")):
        return False
    # What a run has of other scenarios alone is not known of this one.
    one, same = (
        {n: numbers(c, n) for n in entry.run.kind.metrics if n in c and c[n].notna().any()}
        for c in cells
    )
    return one.keys() == same.keys() and all(
        np.allclose(one[name], same[name], rtol=SAME, atol=0, equal_nan=True) for name in one
    )


def made_with(entry: Entry) -> tuple[Any, ...]:
    """Return what a method's results are made with: name, track, parameters, weights, code."""
    kind, about = entry.run.kind, entry.run.manifest
    name, scenario = entry.row[kind.name], entry.row["scenario"]
    settings = ("variant", "track", "parameters", "weights")
    cells = [
        [cell.get(setting) for setting in settings]
        for cell in about["cells"]
        if (cell.get("scenario"), cell.get("name")) == (scenario, name)
    ]
    labels = [entry.row[label] for label in kind.labels]
    return name, labels, cells, manifests.code_sha256(about, name)


def boards(rows: Sequence[Row]) -> list[list[Row]]:
    """Group the rows that may be compared: those of one suite, scenario and data."""
    different = dict.fromkeys(map(_data_of, rows))
    return [[row for row in rows if _data_of(row) == data] for data in different]


def _data_of(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("suite", "scenario", "data_hash", "data_n"))


def _known(run: Run) -> dict[tuple[str, ...], Row]:
    """What is known of each cell as a whole, by scenario, method (or operator) and labels."""
    if run.cells.empty:
        return {}
    keys = ["scenario", run.kind.name, *run.kind.labels]
    shown = run.cells[run.cells["scenario"].isin(run.scenarios())]
    # Of several rows the first one counts.
    rows = [{str(name): value for name, value in row.items()} for row in shown.to_dict("records")]
    return {tuple(str(row[key]) for key in keys): row for row in rows[::-1]}


def _row(run: Run, keys: Row, cell: pd.DataFrame, known: Row) -> Row:
    kind = run.kind
    valid = cell if (ok := cell["status"] == "ok").all() else cell[ok]
    data = run.manifest["data"][keys["scenario"]]
    row: Row = {
        **keys,
        "run": run.path.name,
        "n": len(cell),
        "coverage": len(valid) / len(cell),
        "rank": None,
    }
    # Failed samples of methods hold what an image of the untouched sensor gets.
    counted = cell if kind.name == "method" and len(valid) else valid
    specs = tuple(kind.metrics.values())
    figures = once(lambda counts: aggregate(counted, specs, counts), len(counted))
    for spec, value in zip(specs, figures, strict=True):
        if spec.aggregate is not None:
            row[spec.name] = _plain(value)
            continue
        for end in ("", "_low", "_high"):
            row[f"{spec.name}{end}"] = _plain(known.get(f"{spec.name}{end}"))
    for name in kind.costs:
        row[name] = _plain(known.get(name))
    for name in kind.facts:
        row[name] = str(known.get(name, ""))
    row |= {"data_hash": data["hash"], "data_n": data["n"]}
    row |= {name: data[name] for name in ("inverse_crime", "sensor")}
    machine = known.get("machine")
    row["machine"] = machine if isinstance(machine, str) and machine else None
    row["busy"] = known.get("busy") is True
    if kind.name == "method":
        solve = known.get("calibration_ms")
        frame = row["frame_ms_p50"]
        row["frame_solves"] = _plain(frame / solve if solve and frame is not None else None)
        noted = run.notes.get(keys["scenario"], {})
        row |= {name: _plain(noted.get(name)) for name in NOTES}
        levels = {n: _known_numbers(cell, n) for n in SNR_COLUMNS}
        row |= {n: _plain(np.median(of) if len(of) else None) for n, of in levels.items()}
        for end, most in (("min", np.min), ("max", np.max)):
            row[f"snr_db_{end}"] = _plain(most(of) if len(of := levels["snr_db"]) else None)
        row["prior_knowledge"] = describe_prior_knowledge(known.get("prior_knowledge"))
        row["overlap"] = _plain(known.get("overlap"))
        row["actions"] = describe_actions(known.get("actions"))
        row |= _below_ceiling(keys["scenario"], data.get("hash"), counted)
    return row


def _known_numbers(cell: pd.DataFrame, name: str) -> Array:
    """The values (k,) of a column that are numbers, in its unit; none without the column."""
    values = numbers(cell, name) if name in cell else np.empty(0)
    return values[~np.isnan(values)]


def _below_ceiling(scenario: str, data_hash: str, cell: pd.DataFrame) -> Row:
    found = None
    if "psnr" in cell:  # columns of nothing but NaN are left out
        psnr, samples = numbers(cell, "psnr"), cell["sample"].to_numpy()
        found = below_ceiling(scenario, data_hash, samples, psnr, cell["cluster"])
    ends = ("below_ceiling_db", "below_ceiling_db_low", "below_ceiling_db_high")
    return dict.fromkeys(ends) if found is None else dict(zip(ends, found, strict=True))


def _plain(value: Any) -> float | None:
    number = float("nan") if value is None else float(value)
    return number if np.isfinite(number) else None


def is_whole(row: Row) -> bool:
    """True if a row is of all samples of its scenario, as far as is known of published ones."""
    return row["data_n"] is None or row["n"] >= row["data_n"]


def ranking_figure(board: Iterable[Row], kind: RunKind) -> str | None:
    """Name the figure that ranks the rows of one scenario; None where no row has one."""
    rows = list(board)
    return next((n for n in kind.ranked_by if any(row[n] is not None for row in rows)), None)


def _place(row: Row, name: str | None, kind: RunKind) -> tuple[bool, bool, float]:
    """Sorts rows from the best to the worst."""
    value = None if name is None else row[name]
    if name is None or value is None:
        return True, True, 0.0
    lost = not is_whole(row) or (kind.name != "method" and row["coverage"] < 1)
    return False, lost, -kind.metrics[name].sign * value
