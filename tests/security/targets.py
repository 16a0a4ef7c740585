"""Targets of the fuzzing: every reader that a user's file reaches, with valid files to spoil."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import scipy.io
from tests.security import mutations
from tests.security.mutations import Mutation
from tests.support.reports import report_data

from eitbench.benchmark.analysis import comparison
from eitbench.benchmark.analysis.rescore import rescored
from eitbench.benchmark.analysis.results import NOTES_FILE, read_run
from eitbench.benchmark.findings.ladder import read_ladder
from eitbench.benchmark.run.runner import start_run
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.cells import Batch, Cell
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.plan import make_plan, read_resumable
from eitbench.benchmark.rundir.store import SAMPLES, RunStore
from eitbench.benchmark.submissions import submission
from eitbench.benchmark.submissions.check import CHECKS
from eitbench.benchmark.submissions.statement import STATEMENT, Statement, read_statement
from eitbench.benchmark.tuning import selection as recorded
from eitbench.hardware.board import Frame
from eitbench.hardware.recording.importing.arrays import Choice, find_frames
from eitbench.hardware.recording.importing.labels import parsed
from eitbench.hardware.recording.importing.sources import arrays_of
from eitbench.hardware.recording.recorder import Recorder
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows, write_leaderboard
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.recordings.files.csv_mat import (
    read_csv,
    read_mat_recording,
    write_csv,
    write_mat,
)
from eitbench.scenarios.recordings.files.own import own_set
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.sensor_file import read_sensor
from eitbench.scenarios.storage.array_file import read_arrays
from eitbench.scenarios.suites.suite import load_suite, read_suite, suites


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        file: where a spoilt one is put, in the working folder.
        originals: valid ones.
        mutation: what spoils them.
        read: calls our readers with the path of a spoilt one.
        share: how often it is drawn; cheap ones more often.
    """

    file: str
    originals: Sequence[bytes]
    mutation: Mutation
    read: Callable[[Path], object]
    share: int


SUITE = """
name = "tiny"
title = "The cheapest suite there is"
methods = ["noser"]

[[scenarios]]
kind = "simulated"
name = "tiny"
image_shape = [16, 16]
families = ["circle"]
train = 0
validation = 2
test = 12
"""

SENSOR = """
name = "mine"
background = 0.5
image_shape = [24, 24]

[outline]
rectangle_mm = [60.0, 60.0]

[electrodes]
count = 8
start_mm = 7.5
width_mm = 5.0
contact_impedance = [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]

[pattern]
offset = 2
"""

POLYGON = """
name = "bent"

[outline]
polygon_mm = [[0, 0], [40, 0], [40, 40], [20, 20], [0, 40]]

[electrodes]
centres_mm = [10, 50, 70, 100]
width_mm = [4, 4, 4, 4]

[pattern]
table = [[0, 1, 2, 3], [1, 2, 3, 0]]
magnitudes = true
"""


def targets(folder: Path) -> dict[str, Target]:
    """All of them by name, made ready in the empty `folder`, where spoilt files are put too."""
    os.environ["EITBENCH_CACHE"] = str(folder / "cache")
    os.environ.pop("EITBENCH_DATA", None)
    suite = folder / "suite.toml"
    suite.write_text(SUITE)
    plan = make_plan(load_suite(suite))
    run = start_run(plan, folder / "run").path
    return {**_recordings(folder), **_declarations(), **_runs(folder, run), **_others(folder, run)}


def _recordings(folder: Path) -> dict[str, Target]:
    recording = folder / "original.h5"
    (folder / "eight.toml").write_text(SENSOR)
    eight = read_sensor(folder / "eight.toml")
    values = 1 + 0.01 * np.random.default_rng(1).normal(size=(6, eight.n_measurements))
    with Recorder(recording, eight, "fake", firmware="1") as recorder:
        for k, frame in enumerate(values):
            recorder.append(Frame(k, k / 10, k / 10, frame))
        recorder.mark_reference(0, 1)
        recorder.label(2, 4, x_m=0.03, y_m=0.04, state="a")
        recorder.event("started", 0.0)
    content, _ = read_file(recording)
    write_csv(content, folder / "original.csv")
    write_mat(content, folder / "original.mat")
    bare = "".join(",".join(map(str, row)) + "\n" for row in values.tolist())
    plain = io.BytesIO()
    scipy.io.savemat(plain, {"values": values})  # type: ignore[arg-type]

    def own(path: Path) -> None:
        check(path)
        own_set(path).read(path.parent)

    def imported(read_own: Callable[[Path], object], path: Path) -> None:
        try:
            read_own(path)
        except EitbenchError:  # it is, or looks like, a file of another program
            arrays = arrays_of(path)
            parsed(arrays, path)
            find_frames(arrays, eight, path, Choice())

    return {
        "recording": Target("spoilt.h5", [recording.read_bytes()], mutations.hdf5, own, 6),
        "csv": Target(
            "spoilt.csv",
            [(folder / "original.csv").read_bytes(), bare.encode()],
            mutations.text,
            partial(imported, read_csv),
            34,
        ),
        "mat": Target(
            "spoilt.mat",
            [(folder / "original.mat").read_bytes(), plain.getvalue()],
            mutations.mat,
            partial(imported, read_mat_recording),
            24,
        ),
    }


def _declarations() -> dict[str, Target]:
    files = [path.read_bytes() for path in suites().values() if path.stat().st_size < 3000]
    return {
        "sensor": Target(
            "spoilt-sensor.toml",
            [SENSOR.encode(), POLYGON.encode()],
            mutations.text,
            read_sensor,
            20,
        ),
        "suite": Target(
            "spoilt-suite.toml", [SUITE.encode(), *files], mutations.text, read_suite, 20
        ),
    }


def _runs(folder: Path, run: Path) -> dict[str, Target]:
    """The files of a run directory, each spoilt beside whole ones."""
    write_leaderboard(ranked_rows([run]), run)
    results = comparison.read_results(run)
    _, plan = read_resumable(run)

    def shown(path: Path) -> None:
        rows = ranked_rows([path.parent])
        for write in FORMATS.values():
            write(rows)

    def scored(path: Path) -> None:
        shown(path)
        list(rescored(read_run(path.parent)))

    def described(path: Path) -> None:
        scored(path)
        read_resumable(path.parent)

    def reported(path: Path) -> None:
        report_data([path.parent])
        read_ladder(read_run(path.parent))

    def images(path: Path) -> None:
        spoilt = read_run(path.parent)
        spoilt.scene("tiny", range(3))
        spoilt.estimates("tiny", "noser", range(3))
        list(rescored(spoilt))

    def baseline(path: Path) -> None:
        comparison.compare(comparison.read_results(path), results)

    def submitted(path: Path) -> None:
        spoilt = read_run(path.parent)
        check = CHECKS["the leaderboard follows from the figures"]
        check(submission.Submission(spoilt, plan, 1))

    own = {
        NOTES_FILE: json.dumps({"tiny": {"guess_mm": 3.0, "repeat_noise": None}}).encode(),
        STATEMENT: Statement(name="A", commit="0" * 40).model_dump_json().encode(),
    }
    kinds: dict[str, tuple[str, Mutation, Callable[[Path], object], int]] = {
        "samples": (SAMPLES, mutations.parquet, scored, 5),
        "cells": (METHOD_RUNS.table, mutations.parquet, shown, 4),
        "baseline": (SAMPLES, mutations.parquet, baseline, 3),
        "arrays": (METHOD_RUNS.arrays, mutations.hdf5, images, 3),
        "manifest": (manifest.FILE_NAME, mutations.json_text, described, 2),
        "reported": (manifest.FILE_NAME, mutations.json_text, reported, 1),
        "notes": (NOTES_FILE, mutations.json_text, shown, 2),
        "submission": (submission.LEADERBOARD, mutations.json_text, submitted, 2),
        "statement": (STATEMENT, mutations.json_text, lambda p: read_statement(p.parent), 2),
    }
    found = {}
    for name, (file, mutation, read, share) in kinds.items():
        place = folder / f"run-{name}"
        place.mkdir()
        for path in run.iterdir():
            if path.is_file() and path.name != file:
                (place / path.name).write_bytes(path.read_bytes())
        original = own[file] if file in own else (run / file).read_bytes()
        found[name] = Target(f"{place.name}/{file}", [original], mutation, read, share)
    return found


def _others(folder: Path, run: Path) -> dict[str, Target]:
    """Parts of a run, the cache, weights and choices."""
    import torch

    rng = np.random.default_rng(2)
    store, cell = RunStore(folder / "parts-run", METHOD_RUNS), Cell("tiny", "noser")
    images = rng.normal(size=(2, 4, 4)).astype(np.float32)
    store.save_batch(
        cell, "test", Batch(0, ["ok", "error"], ["", "no"], {"conductivity": images}, "{}")
    )
    (part,) = (folder / "parts-run").rglob("*.npz")
    tensors = {"a.b": torch.ones(3, 2), "c": torch.zeros(4, dtype=torch.int64)}
    from eitbench.methods.training.checkpoint import Checkpoint  # torch takes seconds

    Checkpoint(tensors, {}, {}, ()).write(folder / "training", {"epochs": 3})
    checkpoint = folder / "training" / "checkpoint.safetensors"
    scenario = load_suite(folder / "suite.toml").scenarios[0]
    trials = (recorded.Trial({"a": 1.0}, 1.0),)
    choice = recorded.Selection({"a": 1.0}, 1.0, trials, recorded.TuningBudget(), "trials")
    choices = recorded.record(scenario, {"tikhonov": choice}, recorded.user_selections())

    def weights(path: Path) -> None:
        read_arrays(path)
        Checkpoint.read(path.parent, {"epochs": 3})

    return {
        "batch": Target(
            str(part.relative_to(folder)),
            [part.read_bytes()],
            mutations.npz,
            lambda path: store.batch(cell, "test", 0),
            26,
        ),
        "weights": Target(
            "training/checkpoint.safetensors",
            [checkpoint.read_bytes()],
            mutations.safetensors,
            weights,
            43,
        ),
        "choices": Target(
            str(choices.relative_to(folder)),
            [choices.read_bytes()],
            mutations.json_text,
            lambda path: recorded.selected_parameters(scenario, "tikhonov"),
            14,
        ),
    }
