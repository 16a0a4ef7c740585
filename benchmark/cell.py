"""One cell of a run: one method or operator on one scenario, run in a worker and judged."""

import threading
from collections.abc import Mapping
from typing import Any

import pandas as pd

from eitbench.benchmark import manifest
from eitbench.benchmark.cell_run import CellRun
from eitbench.benchmark.outcome import Kept
from eitbench.benchmark.progress import Bar
from eitbench.benchmark.subject import Judged, Subject
from eitbench.benchmark.timing import calibration
from eitbench.scenarios.errors import EitbenchError


def run_cell(subject: Judged, progress: Bar, stop: threading.Event) -> None:
    """Ask for what is not kept yet, then judge the cell; whatever it does is a row.

    Raises:
        StoppedError: the run was interrupted; finished batches are kept.
        EitbenchError: what is kept could not be written or read.
    """
    judge_cell(subject, CellRun(subject, progress, stop).run())
    if subject.plan.cell.variant:  # of other tracks figures are kept, no images
        subject.store.forget_answers(subject.plan.cell)


def prepare(subject: Subject, progress: Bar, stop: threading.Event) -> None:
    """Run what other cells need, unless it is kept already.

    Raises:
        StoppedError: the run was interrupted; finished batches are kept.
        EitbenchError: it cannot be had.
    """
    run = CellRun(subject, progress, stop)
    if run.pending:
        run.run()
    store, cell = subject.store, subject.plan.cell
    for batch in store.batches(cell, "test"):
        for status, message in zip(batch.status, batch.message, strict=True):
            if status != "ok":
                store.forget(cell)
                raise EitbenchError(
                    f"What the cells of scenario {cell.scenario!r} are compared with cannot be "
                    f"computed: {message}."
                )


def judge_cell(subject: Judged, row: Mapping[str, Any] | None) -> None:
    """Score the kept samples of a cell and keep its rows.

    Args:
        row: figures of the cell as a whole; None for one that is not finished.
    """
    plan, test, store = subject.plan, subject.test, subject.store
    kept = Kept(store, plan.cell, "test", len(test), subject.blank)
    who = {"scenario": plan.cell.scenario, store.kind.name: plan.cell.name, **subject.labels}
    figures, whole = subject.figures(kept)
    described = test.samples.drop(columns=["sample", *figures.columns], errors="ignore")
    table = pd.DataFrame(
        {
            "suite": plan.suite,
            **who,
            "sample": test.samples["sample"].to_numpy(),
            "input_hash": subject.input_hashes,
            "status": kept.status,
            "message": kept.message,
        }
    )
    table = pd.concat([table, figures, described.reset_index(drop=True)], axis=1)
    table = table[kept.status != ""]
    ok = int((table["status"] == "ok").sum())
    cell_row = {
        **who,
        **subject.unknown,
        **(row or {}),
        **whole,
        "coverage": ok / len(table) if len(table) else 0.0,
        "machine": manifest.cpu_model(),
        "calibration_ms": calibration(),
        "n": len(table),
        "complete": row is not None and len(table) == len(test),
    }
    store.save_cell(plan.cell, table, cell_row)
