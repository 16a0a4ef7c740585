"""One cell of a run: one method or operator on one scenario, run in a worker and scored."""

import threading
from collections.abc import Mapping
from typing import Any

import pandas as pd

from eitbench.benchmark.run.batch_result import StoredBatches
from eitbench.benchmark.run.batch_runner import BatchRunner
from eitbench.benchmark.run.cell_task import CellTask, ScoredTask
from eitbench.benchmark.run.progress import Bar
from eitbench.benchmark.run.timing import calibration
from eitbench.benchmark.rundir import manifest
from eitbench.scenarios.errors import EitbenchError


def run_cell(task: ScoredTask, progress: Bar, stop: threading.Event) -> None:
    """Run the batches that are not stored yet, then score the cell; whatever it does is a row.

    Raises:
        StoppedError: the run was interrupted; finished batches are stored.
        EitbenchError: the store could not be written or read.
    """
    score_cell(task, BatchRunner(task, progress, stop).run())
    if task.plan.cell.variant:  # other tracks keep figures, no images
        task.store.forget_answers(task.plan.cell)


def prepare(task: CellTask, progress: Bar, stop: threading.Event) -> None:
    """Run a task that other cells need, unless its answers are stored already.

    Raises:
        StoppedError: the run was interrupted; finished batches are stored.
        EitbenchError: it failed.
    """
    runner = BatchRunner(task, progress, stop)
    if runner.pending:
        runner.run()
    store, cell = task.store, task.plan.cell
    for batch in store.batches(cell, "test"):
        for status, message in zip(batch.status, batch.message, strict=True):
            if status != "ok":
                store.forget(cell)
                raise EitbenchError(
                    f"What the cells of scenario {cell.scenario!r} are compared with cannot be "
                    f"computed: {message}."
                )


def score_cell(task: ScoredTask, row: Mapping[str, Any] | None) -> None:
    """Score the stored samples of a cell and store its rows.

    Args:
        row: figures of the cell as a whole; None for one that is not finished.
    """
    plan, test, store = task.plan, task.test, task.store
    stored = StoredBatches(store, plan.cell, "test", len(test), task.blank)
    labels = {"scenario": plan.cell.scenario, store.kind.name: plan.cell.name, **task.labels}
    figures, whole = task.figures(stored)
    described = test.samples.drop(columns=["sample", *figures.columns], errors="ignore")
    table = pd.DataFrame(
        {
            "suite": plan.suite,
            **labels,
            "sample": test.samples["sample"].to_numpy(),
            "input_hash": task.input_hashes,
            "status": stored.status,
            "message": stored.message,
        }
    )
    table = pd.concat([table, figures, described.reset_index(drop=True)], axis=1)
    table = table[stored.status != ""]
    ok = int((table["status"] == "ok").sum())
    cell_row = {
        **labels,
        **task.unknown,
        **(row or {}),
        **whole,
        "coverage": ok / len(table) if len(table) else 0.0,
        "machine": manifest.cpu_model(),
        "calibration_ms": calibration(),
        "n": len(table),
        "complete": row is not None and len(table) == len(test),
    }
    store.save_cell(plan.cell, table, cell_row)
