"""Methods of a submission, run again on some samples: do they make the stored images?

Built-in methods run as they are here, plugins from the copy that lies in the run directory, each in
a new worker: nothing of what the directory says of them is needed. What was run so is kept in a
file beside the run directories, by a digest of all that was compared.
"""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from random import SystemRandom
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import NOTES_FILE, ROUNDED, describe_actions
from eitbench.benchmark.checks.method_checks import SAME_FRAME
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.novelty import SCORES
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.run.cell import BatchRunner
from eitbench.benchmark.run.cell_task import NAN, CellPlan, StoredSamples
from eitbench.benchmark.run.method_cell import MethodCellTask, MethodData
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import read_validation, rounded_images
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS, RunStore
from eitbench.benchmark.submissions.check import Check
from eitbench.benchmark.submissions.submission import Submission
from eitbench.benchmark.workers.confinement import check_isolation
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.storage.atomic_write import atomic_write_json
from eitbench.scenarios.storage.files import sha256_of

REPRODUCED = "reproduced.json"
"""Beside the run directories: what was run again, by digest."""

LEAST_REPRODUCED = 32
"""Samples of each scenario, or all, that make a submission a reproduced one."""
ROUNDING = 1e-3
"""Difference of images that another processor may cause, as a share of an image's contrast."""
ULPS = 16 * 2.0**-24
"""The same, as a share of the background: what float32 rounds away in a few operations."""
STATED_APART, SHARES_APART = 0.05, 0.05
"""By how much stated figures may differ on another processor: relative, and of shares."""
MEANS_APART = 0.2
"""The same of their mean, as a part of what single frames may."""
FRAMES_APART = 0.1
"""Share of frames whose stated figures may differ by more there, beside one frame."""
FRAME_APART = 1.0
"""By how much they may, as a part of ours or of what is usual. The mean of all is ours, too."""
SAME_STATED = 1e-6
"""Relative difference of stated figures that storing them may cause."""
NEIGHBOURS = 2
"""Steps of a rounded image that a value moves at most where the image changes slightly: one, or two
where its largest contrast crosses a power of 2 and the steps double."""


def rerun(submission: Submission, n: int, *, isolate: bool = False) -> list[Check]:
    """Run every method again on `n` samples of each scenario that nobody can foresee.

    They are drawn twice: in whole batches, whose images and statements are compared closely, and
    one by one, since the frames of a batch are neighbours.

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
        try:
            problem = _problem(submission, entry, n, isolate)
            checks.append(Check(what, problem, refutes=bool(problem)))
        except _NotRunError as error:
            checks.append(Check(what, str(error)))
    return checks


class _NotRunError(Exception):
    """A method cannot be run again here."""


def _problem(submission: Submission, entry: Mapping[str, Any], n: int, isolate: bool) -> str:
    run, name, scenario = submission.run, entry["name"], entry["scenario"]
    data, plugin = submission.data[scenario], submission.plan.origins.get(name)
    copy = None if plugin is None else run.path / plugin.kept
    if plugin is not None and not (copy and copy.is_file() and sha256_of(copy) == plugin.sha256):
        raise _NotRunError(
            "The run directory lacks a copy of the method's plugin: run the suite again."
        )
    if plugin is None and name not in METHOD_REGISTRY.known():
        raise _NotRunError(
            f"The package that {name!r} comes from is not installed here: install it."
        )
    cell, suite = Cell(scenario, name), submission.plan.suite
    plan = CellPlan(
        cell, entry["track"], entry["parameters"], entry["spent"], suite, copy, data.batch
    )
    batches = drawn_batches(len(data.test), data.batch, n)
    row, made, figures = _made(MethodCellTask, plan, data, batches, isolate)
    samples = np.flatnonzero(made["test"].status != "")
    stored = run.estimates(scenario, name, samples.tolist())
    if stored is None:
        raise _NotRunError("It holds no images.")
    background = data.test.sensor.background
    rounded = run.manifest.get("images") == ROUNDED
    same = _same_machine(submission)
    share = 0.0 if same else ROUNDING
    ours = made["test"].values["conductivity"][samples]
    away = _away(stored, ours, background, share, rounded=rounded)
    messages = made["test"].message[samples]
    if away.any() and (messages[away] != "").all():
        raise _NotRunError(f"{_differing(away)} ({messages[away][0]}).")
    if data.validation is not None and not away.any():
        images = made["validation"].values["conductivity"]
        theirs = read_validation(run.path / METHOD_RUNS.arrays, scenario, name, images.shape)
        away = _away(theirs, images, background, share, rounded=False)
    if away.any():
        return f"{_differing(away)}."
    # Frame by frame, the last one first: a method that learns from the frames that it is shown, or
    # from those beside a frame, makes other images now.
    singles = drawn_batches(len(data.test), 1, n)[::-1]
    _, alone, _ = _made(_TestFrames, replace(plan, batch=1), data, singles, isolate)
    tried = np.flatnonzero(alone["test"].status != "")
    stored_alone = run.estimates(scenario, name, tried.tolist())
    assert stored_alone is not None  # others of this cell are there
    again = alone["test"].values["conductivity"][tried]
    moved = _away(stored_alone, again, background, SAME_FRAME, rounded=rounded)
    messages = alone["test"].message[tried]
    if moved.any() and (messages[moved] != "").all():
        raise _NotRunError(f"{_differing(moved)} ({messages[moved][0]}).")
    if moved.any():
        return (
            f"{np.count_nonzero(moved)} of {len(moved)} images are others where each frame is "
            "asked for alone, the last one first: an image depends on other frames, or the method "
            "did not make it."
        )
    said = run.cell(scenario, name).set_index("sample").loc[samples]
    if other := _other_statement(said, figures.iloc[samples], exact=same):
        return (
            f"Its {other} of {len(samples)} samples is not what it states here: send what the run "
            "wrote."
        )
    known = run.cells[(run.cells["scenario"] == scenario) & (run.cells["method"] == name)]
    for column in ("prior_knowledge", "differs"):
        if known[column].tolist() != [row.get(column, "")]:
            what = column.replace("_", " ")
            return f"Its {what}, as noted here, is not what the run directory says."
    if row.get("overlap", 0.0) > 0:
        return f"Run again, it learned from {row['overlap']:.0f} of the test samples."
    did = describe_actions(row.get("actions"))
    return f"Run again, it {did}." if did else ""


def _differing(away: NDArray[np.bool_]) -> str:
    count = f"{np.count_nonzero(away)} of {len(away)} images"
    return f"{count} differ from those that it makes here"


def drawn_batches(size: int, batch: int, n: int) -> list[slice]:
    """Batches of `size` samples, drawn so that nobody can foresee them, with `n` or more samples.

    They are whole ones: a batch of another size has other last bits. The last of all is short.
    """
    starts, drawn = range(0, size, batch), list[slice]()
    for start in SystemRandom().sample(starts, len(starts)):
        if sum(of.stop - of.start for of in drawn) >= n:
            break
        drawn.append(slice(start, min(start + batch, size)))
    return sorted(drawn, key=lambda of: of.start)


class _TestFrames(MethodCellTask):
    """A method that is asked for frames of the test split alone."""

    @property
    def sizes(self) -> Mapping[str, int]:
        """The test frames."""
        return {"test": len(self.data.test)}

    def figures(self, stored: StoredSamples) -> tuple[pd.DataFrame, dict[str, Any]]:
        """None: frames of the validation split may be needed for them."""
        return pd.DataFrame(), {}


def _made(
    kind: type[MethodCellTask],
    plan: CellPlan,
    data: MethodData,
    batches: Sequence[slice],
    isolate: bool,
) -> tuple[dict[str, Any], dict[str, StoredSamples], pd.DataFrame]:
    """Run a method anew on these `batches` of the test split, in this order.

    Returns:
        The figures of its cell, the samples of each split, and the figures of test samples.
    """
    with tempfile.TemporaryDirectory() as folder:
        task = kind(plan, RunStore.create(Path(folder), METHOD_RUNS), data)
        runner = BatchRunner(task, lambda done: None, threading.Event(), isolate=isolate)
        others = [(split, rows) for split, rows in runner.pending if split != "test"]
        runner.pending = others + [("test", rows) for rows in batches]
        row = runner.run()
        samples = {split: StoredSamples(task, split) for split in task.sizes}
        figures, _ = task.figures(samples["test"])
        return row, samples, figures


def _other_statement(theirs: pd.DataFrame, ours: pd.DataFrame, *, exact: bool) -> str:
    """The figure of uncertainty or novelty that is not ours, frame by frame; "" if all are.

    `exact` is on the same kind of machine. Another processor moves pixels from one rank to the
    next, and single frames across a limit: there the mean has to agree, and most frames.
    """
    for name, spec in {**UNCERTAINTY, **SCORES}.items():
        stated, found = (
            of[name].to_numpy(np.float64) if name in of else np.full(len(theirs), NAN)
            for of in (theirs, ours)
        )
        if spec.unit != "ms" and _is_other(spec, stated, found, exact=exact):
            return repr(name)
    return ""


def _is_other(spec: MetricSpec, stated: Array, found: Array, *, exact: bool) -> bool:
    """True if one figure (n,) that is stated of n frames is not the one that is found here."""
    is_share = "coverage" in spec.name
    relative = SAME_STATED if exact else STATED_APART
    share = SHARES_APART if is_share and not exact else 0.0
    allowed = 0 if exact else max(1, int(FRAMES_APART * len(found)))
    known = np.isfinite(found) & np.isfinite(stated)
    alike = (stated == found) | (np.isnan(stated) & np.isnan(found))
    others = np.count_nonzero(~known & ~alike)
    stated, found = stated[known], found[known]
    if not len(found):
        return bool(others > allowed)
    # A score may have any sign, and an error be next to nothing: what others have counts, too.
    typical = np.median(np.abs(found))
    apart, size = np.abs(stated - found), np.maximum(np.abs(found), typical)
    near = apart <= relative * size + share
    if (apart > FRAME_APART * size + is_share).any() or others + (~near).sum() > allowed:
        return True
    # Small advantages of all frames add up, while rounding goes both ways; and of few frames that
    # may be apart, one that is far off would change the figure of all.
    middle = np.median if spec.aggregate == "median" else np.mean
    for rows, part in ((near, MEANS_APART), (np.ones_like(near), 1.0)):
        if not rows.any():  # one frame alone, which may be apart
            continue
        one, other = middle(stated[rows]), middle(found[rows])
        if abs(one - other) > part * (relative * max(abs(other), typical) + share):
            return True
    return False


def _away(
    theirs: NDArray[Any], ours: NDArray[Any], background: float, share: float, *, rounded: bool
) -> NDArray[np.bool_]:
    """Mask (n,) of images (n, H, W) [S/m] that differ by more than a `share` of our contrast.

    Places and correlations are the same at any scale: a weak image is compared as closely.

    Args:
        share: of the largest contrast of each of our images; 0 if they are to be the same numbers.
        rounded: theirs were, see `rounded_images`.
    """
    contrast = np.abs(ours.astype(np.float64) - background)
    largest = contrast.max(axis=(1, 2), keepdims=True, where=np.isfinite(contrast), initial=0.0)
    slack = (share * largest + ULPS * background) * (share > 0)
    if rounded:
        ours, steps = rounded_images(ours, background)
        slack = slack + NEIGHBOURS * steps * (share > 0)
    same = (np.abs(theirs - ours) <= slack) | (theirs == ours) | (np.isnan(theirs) & np.isnan(ours))
    return np.asarray(~same.all(axis=(1, 2)))


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
    return hashlib.sha256("".join(map(sha256_of, paths)).encode()).hexdigest()


def note_reproduced(submission: Submission, n: int) -> Path | None:
    """Note beside the run directory that at least `n` samples of each scenario were run again.

    Returns:
        The file; None if `n` is below `LEAST_REPRODUCED` and not all, and nothing is noted. It says
        so as "32 of 36 samples", with those of the largest scenario; of several times the most.
    """
    run = submission.run.path
    total = max(len(data.test) for data in submission.data.values())
    if n < min(LEAST_REPRODUCED, total):
        return None
    file = run.resolve().parent / REPRODUCED
    known, of = reproduced(file.parent), digest(run)
    again = max([min(total, n), *map(int, re.findall(r"^\d+", known.get(of, "")))])
    known[of] = f"{again} of {total} samples"
    atomic_write_json(file, known)
    return file


def withdraw_reproduced(run: Path) -> None:
    """Take back that a run was reproduced, if it is noted: it was run again with other images."""
    file = run.resolve().parent / REPRODUCED
    known = reproduced(file.parent)
    if known.pop(digest(run), None):
        atomic_write_json(file, known)


def reproduced(runs: Path) -> dict[str, str]:
    """Return what was run again of the runs in the folder `runs`, by digest.

    Raises:
        DataCorruptError: the file is damaged.
    """
    file = runs / REPRODUCED
    if not file.is_file():
        return {}
    try:
        return {str(of): str(told) for of, told in json.loads(read_json_file(file)).items()}
    except (AttributeError, RecursionError, ValueError) as error:
        raise DataCorruptError(f"{file} is damaged: delete it and check the runs again.") from error
