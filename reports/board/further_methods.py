"""Cells that are run after a record was made: their rows, beside those that it has.

A record stays what it is. A newer one takes the rows of what nobody ran again, with images and
checksums, as they stand in the older one; its manifest is that of the older one, and names under
`ADDED` the runs that later rows are from.
"""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.rundir.manifest import ADDED, Manifest, suite_of
from eitbench.benchmark.tuning.outdated import outdated

_OF_A_RUN = (
    *("started", "finished", "resumed", "versions", "machine", "git_commit"),
    *("calibration_ms", "jobs", "command_line"),
)
"""What a manifest says of how a run was made."""


def without_replaced(kept: Run, run: Run) -> Run:
    """The record without rows that have no place beside those of a later `run`.

    These are of scenarios of which it has other frames, and all their methods, and of cells that it
    left out, for a method cannot run there.
    """
    ran = {_name(cell) for cell in run.manifest["cells"]}
    before = kept.manifest
    other = {
        name
        for name, data in run.manifest["data"].items()
        if name in before["data"] and before["data"][name]["hash"] != data["hash"]
    }
    other -= {cell["scenario"] for cell in before["cells"] if _name(cell) not in ran}
    left_out = run.manifest["skipped"].keys()

    def stay(rows: pd.DataFrame) -> pd.DataFrame:
        cells = rows["scenario"].astype(str) + "/" + rows[kept.kind.name].astype(str)
        return rows[~rows["scenario"].isin(other) & ~cells.isin(left_out)]

    return replace(
        kept,
        manifest=before
        | {
            "data": {name: data for name, data in before["data"].items() if name not in other},
            "cells": [
                cell
                for cell in before["cells"]
                if cell["scenario"] not in other and _name(cell) not in left_out
            ],
        },
        samples=stay(kept.samples),
        cells=stay(kept.cells),
    )


def check_joins(kept: Run, run: Run) -> None:
    """Check that the rows of a record and those of a run can stand beside each other.

    Raises:
        InputError: a scenario has other frames in the record, or is new and not run; or something
            that was to be run again was left out, or is not run and has other parameters now.
    """
    declared = {scenario.name: scenario for scenario in suite_of(kept.manifest).scenarios}
    for scenario in suite_of(run.manifest).scenarios:
        name = scenario.name
        if name not in run.manifest["plan"]["scenarios"]:
            same = declared.get(name) == scenario
        else:
            hashes = [of.manifest["data"].get(name, {}).get("hash") for of in (run, kept)]
            same = hashes[1] is None or hashes[0] == hashes[1]
        if not same:
            raise InputError(
                f"The frames of {name!r} are others than in {kept.path}: run it with all methods."
            )
    there = {_name(cell) for cell in kept.manifest["cells"]}
    for cell, why in run.manifest["skipped"].items():
        if cell in there:
            raise InputError(f"{cell} was to be run again, and was left out: {why}")
    ran = {_name(cell) for cell in run.manifest["cells"]}
    if stale := [cell for cell in outdated(kept.manifest) if cell not in ran]:
        raise InputError(f"{stale[0]} has other parameters now than in {kept.path}: run it, too.")


def on_frames_of(kept: Run, samples: pd.DataFrame) -> pd.DataFrame:
    """The `samples` of a run with the hashes of frames that a record has.

    On another kind of processor the same frames differ in their last bits, and so their hashes:
    those of the record name its frames.

    Raises:
        InputError: the record lacks some of the frames.
    """
    frames = ["scenario", "sample"]
    known = kept.samples.drop_duplicates(frames).set_index(frames)["input_hash"]
    index = pd.MultiIndex.from_frame(samples[frames])
    new = ~samples["scenario"].isin(kept.scenarios())
    if not (index.isin(known.index) | new).all():
        raise InputError(f"{kept.path} lacks frames of this run: run the whole suite.")
    named = known.reindex(index).array
    return samples.assign(input_hash=samples["input_hash"].where(new, named))


def joined(run: Run, older: pd.DataFrame, newer: pd.DataFrame) -> pd.DataFrame:
    """Rows of a table of a record that `run` has not again, and its own, in the suite's order."""
    suite = suite_of(run.manifest)
    scenarios = [scenario.name for scenario in suite.scenarios]
    tables = [table for table in (older, newer) if not table.empty]
    if not tables:
        return newer
    table = pd.concat(tables, ignore_index=True)
    cell = ["scenario", run.kind.name]
    if not older.empty and not newer.empty:
        ran = pd.MultiIndex.from_frame(newer[cell].drop_duplicates())
        again = pd.MultiIndex.from_frame(table[cell]).isin(ran)
        table = table[~again | (table.index >= len(older))]
    table = table[table["scenario"].isin(scenarios)]
    order = {
        column: {name: k for k, name in enumerate(names)}
        for column, names in zip(cell, (scenarios, suite.names), strict=True)
    }
    # What is of no method, as of raw voltages, comes first.
    return table.sort_values(
        cell, key=lambda c: c.map(order[str(c.name)]).fillna(-1), kind="stable"
    )


def joined_manifest(kept: Manifest, about: Manifest, same_bits: bool) -> Manifest:
    """The manifest of a record with the rows of a run with the manifest `about` beside its own.

    `same_bits` is true if the frames of both are the same to the last bit.
    """
    suite = suite_of(about)
    scenarios = [scenario.name for scenario in suite.scenarios]
    ran = [_name(cell) for cell in about["cells"]]

    def stays(cell: str) -> bool:
        return cell not in ran and cell.split("/")[0] in scenarios

    before = [
        of | {"cells": [cell for cell in of["cells"] if stays(cell)]} for of in kept.get(ADDED, [])
    ]
    run = {name: about[name] for name in _OF_A_RUN} | {"cells": ran, "same_bits": same_bits}
    names = dict.fromkeys([*kept["plan"]["names"], *about["plan"]["names"]])
    chosen = {"suite": about["plan"]["suite"], "names": list(names), "scenarios": scenarios}
    data = kept["data"] | {k: v for k, v in about["data"].items() if k not in kept["data"]}
    return kept | {
        "plan": kept["plan"] | chosen,
        "data": {name: data[name] for name in scenarios if name in data},
        "cells": [*(cell for cell in kept["cells"] if stays(_name(cell))), *about["cells"]],
        "skipped": {k: v for k, v in kept["skipped"].items() if stays(k)} | about["skipped"],
        "refused": {k: v for k, v in kept["refused"].items() if stays(k)} | about["refused"],
        ADDED: [*(of for of in before if of["cells"]), run],
    }


def _name(cell: Manifest) -> str:
    return f"{cell['scenario']}/{cell['name']}"
