"""Runs of a suite: all it ranks on every scenario, into a directory that can be resumed."""

import shutil
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from eitbench.benchmark.run.cell import score_cell
from eitbench.benchmark.run.cell_task import CellData, CellPlan
from eitbench.benchmark.run.executors import Executor, executor
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.run.operator_cell import OperatorData
from eitbench.benchmark.run.place_cell import PlaceData
from eitbench.benchmark.run.progress import RunProgress
from eitbench.benchmark.run.timing import calibration_solves
from eitbench.benchmark.run.tracks import cell_entries, write_tracks
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.lock import locked
from eitbench.benchmark.rundir.manifest import Manifest
from eitbench.benchmark.rundir.plan import Plan, make_plan, read_resumable
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.tuning.selection import outdated_selection
from eitbench.benchmark.workers.process import THREADS
from eitbench.benchmark.workers.worker import SEED, StoppedError
from eitbench.scenarios.errors import (
    DataCorruptError,
    DataUnavailableError,
    EitbenchError,
    InputError,
    counted,
)
from eitbench.scenarios.interrupts import termination_interrupts
from eitbench.scenarios.suites.suite import Suite, hidden_key

__all__ = [
    "Plan",
    "RunInterruptedError",
    "RunResult",
    "UnfinishedError",
    "make_plan",
    "resume_run",
    "start_run",
]

DATA: Mapping[str, type[CellData]] = {
    "methods": MethodData,
    "places": PlaceData,
    "operators": OperatorData,
}

Lost = dict[str, dict[str, str]]
"""Sentences on scenarios and cells that are "skipped" and on scenarios that are "refused"."""


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        skipped: one sentence for each scenario whose data could not be had, and for each method
            that lacks something here, such as weights for a scenario's sensor.
        refused: one sentence for each scenario whose data are not what they should be.
        unfinished: a sentence if the time limit ended the run, which can be resumed; else "".
    """

    path: Path
    skipped: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    unfinished: str = ""


class TimeLimit:
    """Stops a run after some seconds; without a number, never.

    Attributes:
        stop: is set then, and whenever else the cells have to stop.
        reached: true from then on.
    """

    def __init__(self, seconds: float | None) -> None:
        if seconds is not None and not 0 <= seconds <= threading.TIMEOUT_MAX:
            raise InputError(f"A time limit is a number of seconds, got {seconds}.")
        self.seconds = seconds
        self.stop = threading.Event()
        self.reached = False
        self._timer = threading.Timer(seconds or 0.0, self._end)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        if self.seconds is not None:
            self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()

    def _end(self) -> None:
        self.reached = True
        self.stop.set()


class UnfinishedError(EitbenchError):
    """A run ended early for a `reason`, a sentence; the command `again` continues it."""

    def __init__(self, reason: str, again: str) -> None:
        super().__init__(f"{reason} Finished rows are kept: continue with `{again}`.")
        self.reason = reason


class RunInterruptedError(UnfinishedError):
    """The run was stopped by the user."""

    exit_code = 130


def start_run(
    plan: Plan,
    out: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    isolate: bool = False,
    time_limit_s: float | None = None,
    calm_ms: float | None = None,
    progress: RunProgress | None = None,
) -> RunResult:
    """Run `plan` into the new directory `out`, `jobs` cells at a time.

    Args:
        scheduler: address of a Dask scheduler on whose machines the cells are run; `jobs` is then
            how many processes simulate data here.
        isolate: keep methods from the network, and from reading files that are not theirs.
        time_limit_s: seconds after which the run stops as by Ctrl-C, and returns.
        calm_ms: with one job, wait for the machine to be so calm while methods are timed; the most
            that the calibration solve takes then [ms].

    Call it from a script only under `if __name__ == "__main__":`, since it starts processes.

    Raises:
        InputError: `out` is not empty, another process works in it, or no scheduler answers,
            or methods cannot be isolated on this machine.
        DataUnavailableError, DataCorruptError: no scenario's data could be had.
        RunInterruptedError: Ctrl-C or SIGTERM; `resume_run` continues.
        EitbenchError: `out` cannot be written.
    """
    progress = progress or RunProgress(quiet=True)
    with (
        executor(jobs, scheduler, isolate, calm_ms) as where,
        TimeLimit(time_limit_s) as limit,
    ):
        store = RunStore.create(out, plan.kind)
        with locked(out), termination_interrupts():
            try:
                data, lost = _load(plan, plan.scenarios, jobs, progress)
                lost["skipped"] |= _unusable(plan, data, progress)
                _say_outdated(plan, data, progress)
                manifest = _new_manifest(plan, data, lost, jobs)
                store.write_manifest(manifest)
                store.keep_plugins(plan.plugins)
            except BaseException:  # nothing has been run: leave nothing behind, after Ctrl-C too
                shutil.rmtree(out, ignore_errors=True)
                raise
            return _execute(plan, store, manifest, data, where, progress, limit)


def resume_run(
    run: Path,
    *,
    suite: Suite | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    isolate: bool = False,
    time_limit_s: float | None = None,
    calm_ms: float | None = None,
    progress: RunProgress | None = None,
) -> RunResult:
    """Continue the run in `run`, in place, with the plan it was started with.

    Args:
        jobs: as for `start_run`; it may be another number than before.
        scheduler: as for `start_run`; it may be another one, or none.
        isolate: as for `start_run`.
        time_limit_s: as for `start_run`.
        calm_ms: as for `start_run`.

    Raises:
        InputError: `run` is no run directory, belongs to another suite, plugin or data, another
            process works in it, or it is of a hidden set and `suite` is not drawn with its key.
        RunInterruptedError, EitbenchError: as for `start_run`.
    """
    manifest, plan = read_resumable(run)
    if hidden := manifest.get("hidden"):
        if suite is None or hidden_key(suite) != hidden:
            raise InputError(
                f"{run} is of a hidden set, and does not hold its key: continue it with the "
                "`eitbench hidden run` that began it."
            )
        if suite.model_dump() == plan.suite.model_dump():
            plan = plan.model_copy(update={"suite": suite})
    if suite is not None and suite != plan.suite:
        raise InputError(
            f"{run} was started with suite {plan.suite.name!r} as it was then, which differs from "
            f"this {suite.name!r}: leave the suite out to continue it, or start a new run."
        )
    progress = progress or RunProgress(quiet=True)
    with (
        locked(run),
        termination_interrupts(),
        executor(jobs, scheduler, isolate, calm_ms) as where,
        TimeLimit(time_limit_s) as limit,
    ):
        manifest, _ = read_resumable(run)  # another process may just have finished it
        if manifest["status"] == "finished":
            RunStore(run, plan.kind).remove_parts()  # it may have been killed just before
            return _result(run, manifest)
        data = _load_again(plan, run, manifest, jobs, progress)
        RunStore(run, plan.kind).keep_plugins(plan.plugins)  # it may have been killed just before
        manifest["resumed"].append(
            {"time": manifests.now(), "command_line": manifests.command_line(), "jobs": jobs}
            | manifests.environment()
        )
        store = RunStore(run, plan.kind)
        store.write_manifest(manifest)  # before the first row: it may be killed after some
        return _execute(plan, store, manifest, data, where, progress, limit)


def _result(run: Path, manifest: Manifest) -> RunResult:
    return RunResult(run, tuple(manifest["skipped"].values()), tuple(manifest["refused"].values()))


def _load_again(
    plan: Plan, run: Path, manifest: Manifest, jobs: int, progress: RunProgress
) -> dict[str, CellData]:
    """Return the data of a run that is continued; they must be those it was started with."""
    names = list(manifest["data"])
    data, lost = _load(plan, names, jobs, progress)
    if any(lost.values()):
        raise _no_data(lost)
    changed = [
        f"the data of scenario {name!r}"
        for name in names
        if name not in data or data[name].test.data_hash != manifest["data"][name]["hash"]
    ] or [
        f"the weights of {entry['name']!r}"
        for entry in manifest["cells"]
        if data[entry["scenario"]].weights(entry["name"]) != entry["weights"]
    ]
    if changed:
        raise InputError(
            f"{run} cannot be resumed: {changed[0]} have changed since it was started. Start a "
            "new run."
        )
    before = manifest["versions"]
    if others := manifests.changed_versions(before):
        was = ", ".join(f"{name} {before.get(name)}" for name in others)
        raise InputError(
            f"{run} cannot be resumed: it was started with {was}, and another version may change "
            "figures. Install what was there, or start a new run."
        )
    return data


def _no_data(lost: Lost) -> EitbenchError:
    kind = DataCorruptError if lost["refused"] else DataUnavailableError
    return kind(" ".join([*lost["refused"].values(), *lost["skipped"].values()]))


def _load(
    plan: Plan, names: Sequence[str], jobs: int, progress: RunProgress
) -> tuple[dict[str, CellData], Lost]:
    """Return the data of the scenarios `names`, and of others the reason why there are none."""
    data: dict[str, CellData] = {}
    lost: Lost = {"skipped": {}, "refused": {}}
    for scenario in plan.suite.scenarios:
        if scenario.name not in names:
            continue
        try:
            data[scenario.name] = DATA[plan.suite.ranks].load(
                scenario, plan.suite, plan.limit, jobs=jobs, progress=not progress.quiet
            )
        except (DataUnavailableError, DataCorruptError) as error:
            how = "refused" if isinstance(error, DataCorruptError) else "skipped"
            lost[how][scenario.name] = f"Scenario {scenario.name!r} is {how}: {error}"
    if not data:
        raise _no_data(lost)
    for sentence in (*lost["skipped"].values(), *lost["refused"].values()):
        progress.say(sentence)
    return data, lost


def _new_manifest(plan: Plan, data: dict[str, CellData], lost: Lost, jobs: int) -> Manifest:
    return {
        "format": 1,
        "status": "running",
        "command_line": manifests.command_line(),
        "started": manifests.now(),
        "finished": None,
        "resumed": [],
        **manifests.environment(),
        "calibration_ms": min(calibration_solves()),
        "jobs": jobs,
        "batch": DATA[plan.suite.ranks].batch,
        "threads": THREADS,
        "seeds": {"methods": SEED},
        "plan": plan.model_dump(mode="json"),
        **({"hidden": hidden} if (hidden := hidden_key(plan.suite)) else {}),
        "data": {name: manifests.about_data(there.test) for name, there in data.items()},
        **lost,
        "cells": [
            entry
            for there in data.values()
            for name in plan.names
            if not there.unusable(name)
            for entry in cell_entries(plan, there, name)
        ],
    }


def _unusable(plan: Plan, data: Mapping[str, CellData], progress: RunProgress) -> dict[str, str]:
    """Return a sentence for each cell that lacks something, such as weights or a program."""
    found = {
        f"{scenario}/{name}": f"Scenario {scenario!r} is left out for {name!r}: {why}"
        for scenario, there in data.items()
        for name in plan.names
        if (why := there.unusable(name))
    }
    if len(found) == len(data) * len(plan.names):
        raise InputError(" ".join(found.values()))
    for sentence in found.values():
        progress.say(sentence)
    return found


def _say_outdated(plan: Plan, data: Mapping[str, CellData], progress: RunProgress) -> None:
    """Say which selected parameters are not used, as the code has changed since."""
    for name in plan.names if plan.suite.ranks == "methods" else ():
        code = plan.code(name)
        known = {name: plan.suite.familiar(there.scenario) for name, there in data.items()}
        on = [s for s, learned in known.items() if outdated_selection(learned, name, code)]
        if on and name not in plan.parameters:
            progress.say(
                f"The hyper-parameters of {name!r} that were selected on {', '.join(on)} belong to "
                "another version of its file, so its defaults are used: tune it again."
            )


def _execute(
    plan: Plan,
    store: RunStore,
    manifest: Manifest,
    data: dict[str, CellData],
    where: Executor,
    progress: RunProgress,
    limit: TimeLimit,
) -> RunResult:
    plugins = {name: file.path for name, file in plan.origins.items()}
    cells = [
        CellPlan(
            cell=Cell(entry["scenario"], entry["name"], entry["variant"]),
            track=entry["track"],
            parameters=entry["parameters"],
            spent=entry["spent"],
            suite=plan.suite,
            plugin=plugins.get(entry["name"]),
            batch=manifest["batch"],
            source=plan.source(entry["name"]),
        )
        for entry in manifest["cells"]
    ]
    interrupted = not _run_cells(cells, data, store, where, progress, limit)
    if interrupted or limit.reached:
        for cell in cells:
            if not store.finished(cell.cell) and any(store.batches(cell.cell, "test")):
                score_cell(data[cell.cell.scenario].task(cell, store), None)
    ranked = [c.cell for c in cells if not c.cell.variant]
    store.assemble(ranked, {name: there.truth() for name, there in data.items()})
    write_tracks(store, cells)
    unfinished = sum(not store.finished(cell.cell) for cell in cells)
    ended = not interrupted and not unfinished
    manifest |= {
        "status": "finished" if ended else "interrupted",
        "finished": manifests.now() if ended else None,
    }
    store.write_manifest(manifest)
    again = _again(plan.suite, store.path)
    if limit.reached and unfinished and not interrupted:
        return replace(
            _result(store.path, manifest),
            unfinished=f"The time limit of {limit.seconds:g} s ended the run: "
            f"{_unfinished(unfinished, len(cells))}. Continue with `{again}`.",
        )
    if interrupted:
        raise RunInterruptedError("The run was interrupted.", again)
    if unfinished:
        raise UnfinishedError(f"{_unfinished(unfinished, len(cells))}.", again)
    store.remove_parts()
    return _result(store.path, manifest)


def _again(suite: Suite, run: Path) -> str:
    """The command that continues a run; that of a hidden set is given the key once more."""
    return manifests.command_line() if hidden_key(suite) else manifests.resume_command(run)


def _unfinished(n: int, cells: int) -> str:
    are = "is" if n == 1 else "are"
    return f"{n} of {counted(cells, 'cell')} (scenario x method) {are} not finished"


def _run_cells(
    cells: list[CellPlan],
    data: dict[str, CellData],
    store: RunStore,
    where: Executor,
    progress: RunProgress,
    limit: TimeLimit,
) -> bool:
    """Run the cells that are not finished, within the limit; return False after Ctrl-C."""
    stop = limit.stop
    unfinished = [plan for plan in cells if not store.finished(plan.cell)]
    if where.slots > 1:
        # A cell that took long to tune takes long to run: begun last, it would run alone.
        unfinished.sort(key=lambda plan: plan.spent.get("seconds") or 0.0, reverse=True)
    # By scenario; they are begun before any cell that waits for one.
    preparations = {
        plan.cell.scenario: first
        for plan in unfinished
        if (first := data[plan.cell.scenario].preparation(plan)) is not None
    }
    prepared: dict[str, Future[None]] = {}

    def run(plan: CellPlan) -> None:
        there = data[plan.cell.scenario]
        frames = sum(there.task(plan, store).sizes.values())
        with progress.cell(str(plan.cell), frames) as bar:
            if plan in unfinished and plan.cell.scenario in prepared:
                prepared[plan.cell.scenario].result()
            if stop.is_set():
                raise StoppedError
            where.run(there, plan, store, bar, stop)

    total = len(unfinished) + len(preparations)
    with progress.cells(total), ThreadPoolExecutor(where.slots) as pool:
        for scenario, plan in preparations.items():
            prepared[scenario] = pool.submit(run, plan)
        futures = [*prepared.values(), *(pool.submit(run, plan) for plan in unfinished)]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        except KeyboardInterrupt:
            return False
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
    errors = [future.exception() for future in futures if not future.cancelled()]
    for error in errors:
        if isinstance(error, EitbenchError):
            raise UnfinishedError(str(error), _again(cells[0].suite, store.path)) from error
        if error is not None and not isinstance(error, StoppedError):
            raise error
    return True
