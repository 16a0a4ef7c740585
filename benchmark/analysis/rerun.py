"""Methods of a submission, run again on some samples: do they make the stored images?

Built-in methods run as they are here, plugins from the copy that lies in the run directory, each in
a new worker: nothing of what the directory says of them is needed. What was run so is kept in a
file beside the run directories, by a digest of all that was compared.
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from random import SystemRandom
from typing import Any

import numpy as np

from eitbench.benchmark.analysis.results import NOTES_FILE, describe_actions
from eitbench.benchmark.analysis.submission import Check, Submission
from eitbench.benchmark.run.cell import BatchRunner
from eitbench.benchmark.run.cell_task import CellPlan, StoredSamples
from eitbench.benchmark.run.method_cell import MethodCellTask, MethodData
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.plan import sha256
from eitbench.benchmark.rundir.run_arrays import read_validation
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS, RunStore
from eitbench.benchmark.workers.confinement import check_isolation
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.storage.atomic_write import atomic_write

VERIFIED = "verified.json"
"""Beside the run directories: what was run again, by digest."""

ROUNDING = 1e-3
"""Difference of images, as a share of the background, that another processor may cause."""


def rerun(submission: Submission, n: int, *, isolate: bool = False) -> list[Check]:
    """Run every method again on `n` samples of each scenario, in whole batches drawn at random.

    Args:
        isolate: keep methods from the network, and from reading files that are not theirs.

    Raises:
        InputError: methods cannot be isolated on this machine.
        DataUnavailableError, DataCorruptError: our data cannot be had.
    """
    if isolate:
        check_isolation()
    checks = []
    for entry in submission.run.manifest["cells"]:
        what = f"{entry['name']!r} makes the stored images of {entry['scenario']!r} again"
        checks.append(Check(what, _problem(submission, entry, n, isolate)))
    return checks


def _problem(submission: Submission, entry: Mapping[str, Any], n: int, isolate: bool) -> str:
    run, name, scenario = submission.run, entry["name"], entry["scenario"]
    data, plugin = submission.data[scenario], submission.plan.origins.get(name)
    copy = None if plugin is None else run.path / plugin.kept
    if plugin is not None and not (copy and copy.is_file() and sha256(copy) == plugin.sha256):
        return "The run directory lacks a copy of the method's plugin: run the suite again."
    cell, suite = Cell(scenario, name), submission.plan.suite
    plan = CellPlan(
        cell, entry["track"], entry["parameters"], entry["spent"], suite, copy, data.batch
    )
    with tempfile.TemporaryDirectory() as folder:
        task = MethodCellTask(plan, RunStore.create(Path(folder), METHOD_RUNS), data)
        runner = BatchRunner(task, lambda done: None, threading.Event(), isolate=isolate)
        # Nobody can foresee which; a batch of another size has other last bits.
        tested = [rows for split, rows in runner.pending if split == "test"]
        drawn = SystemRandom().sample(tested, min(len(tested), _batches(n)))
        runner.pending = [
            (split, rows) for split, rows in runner.pending if split != "test" or rows in drawn
        ]
        row = runner.run()
        made = {split: StoredSamples(task, split) for split in task.sizes}
    samples = np.flatnonzero(made["test"].status != "")
    stored = run.estimates(scenario, name, samples.tolist())
    if stored is None:
        return "It holds no images."
    allowed = 0.0 if _same_machine(submission) else ROUNDING * data.test.sensor.background
    pairs = [(stored, made["test"].values["conductivity"][samples])]
    if data.validation is not None:
        images = made["validation"].values["conductivity"]
        arrays = run.path / METHOD_RUNS.arrays
        pairs.append((read_validation(arrays, scenario, name, images.shape), images))
    for theirs, ours in pairs:
        if not np.allclose(theirs, ours, rtol=0, atol=allowed, equal_nan=True):
            away = np.abs(theirs - ours).max(axis=(1, 2))
            reasons = [message for message in made["test"].message if message]
            return (
                f"{np.count_nonzero(~(away <= allowed))} of {len(away)} images differ from those "
                f"that it makes here{f' ({reasons[0]})' if reasons else ''}."
            )
    known = run.cells[(run.cells["scenario"] == scenario) & (run.cells["method"] == name)]
    for column in ("prior_knowledge", "differs"):
        if known[column].tolist() != [row.get(column, "")]:
            what = column.replace("_", " ")
            return f"Its {what}, as noted here, is not what the run directory says."
    did = describe_actions(row.get("actions"))
    return f"Run again, it {did}." if did else ""


def _batches(n: int) -> int:
    """Number of batches that hold `n` samples."""
    return math.ceil(n / MethodData.batch)


def _same_machine(submission: Submission) -> bool:
    """True if the same kind of processor and the same libraries made the images."""
    theirs = submission.run.manifest
    return bool(
        theirs["machine"].get("cpu") == manifests.cpu_model()
        and theirs["versions"] == manifests.versions()
    )


def digest(run: Path) -> str:
    """Return the SHA-256 (hex) of what a run directory says: all but figures and leaderboards."""
    names = (
        manifests.FILE_NAME,
        SAMPLES,
        TRACKS,
        METHOD_RUNS.table,
        METHOD_RUNS.arrays,
        NOTES_FILE,
    )
    # A run of operators has no rows of methods.
    paths = [path for name in names if (path := run / name).is_file()]
    paths += sorted((run / "plugins").glob("*.py"))
    return hashlib.sha256("".join(map(sha256, paths)).encode()).hexdigest()


def note_verified(submission: Submission, n: int) -> Path:
    """Note beside the run directory that `n` samples of each scenario were run again.

    Returns:
        The file. It says so as "32 of 36 samples", with those of the largest scenario.
    """
    run = submission.run.path
    total = max(len(data.test) for data in submission.data.values())
    told = f"{min(total, MethodData.batch * _batches(n))} of {total} samples"
    file = run.resolve().parent / VERIFIED
    known = verified(file.parent) | {digest(run): told}
    atomic_write(file, (json.dumps(known, indent=1) + "\n").encode())
    return file


def verified(runs: Path) -> dict[str, str]:
    """Return what was run again of the runs in the folder `runs`, by digest.

    Raises:
        DataCorruptError: the file is damaged.
    """
    file = runs / VERIFIED
    if not file.is_file():
        return {}
    try:
        return {str(of): str(told) for of, told in json.loads(read_json_file(file)).items()}
    except (AttributeError, RecursionError, ValueError) as error:
        raise DataCorruptError(f"{file} is damaged: delete it and check the runs again.") from error
