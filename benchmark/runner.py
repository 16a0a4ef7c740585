"""Running a suite: every method on every scenario, into a run directory that can be resumed."""

import hashlib
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from eitbench.benchmark import manifest as manifests
from eitbench.benchmark.cell import BATCH, CellData, CellPlan, judge_cell, run_cell
from eitbench.benchmark.judge import REGISTRATION_FRAMES
from eitbench.benchmark.manifest import Manifest
from eitbench.benchmark.progress import RunProgress
from eitbench.benchmark.selection import selected_parameters
from eitbench.benchmark.store import Cell, RunStore
from eitbench.benchmark.timing import calibration
from eitbench.benchmark.worker import (
    SEED,
    THREADS,
    StoppedError,
    plugin_methods,
)
from eitbench.methods.registry import methods as known_methods
from eitbench.scenarios.datasets import load
from eitbench.scenarios.errors import (
    DataUnavailableError,
    EitbenchError,
    InputError,
    unknown_name,
)
from eitbench.scenarios.recordings.fetch import locate
from eitbench.scenarios.scenario import RecordedScenario
from eitbench.scenarios.suites import Suite


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        skipped: one sentence for each scenario whose data could not be had.
    """

    path: Path
    skipped: tuple[str, ...]


class RunInterruptedError(EitbenchError):
    """The run was stopped by the user; what was finished is kept."""


@dataclass(frozen=True)
class Plan:
    """What is run: enough to continue it later.

    Attributes:
        methods, scenarios: names in the order they are run.
        limit: number of test samples of each scenario, None for all.
        plugins: files with more methods, each with the SHA-256 of its content.
    """

    suite: Suite
    methods: tuple[str, ...]
    scenarios: tuple[str, ...]
    limit: int | None
    plugins: tuple[tuple[Path, str], ...]

    def describe(self) -> Manifest:
        """Plain values for the manifest."""
        return {
            "suite": self.suite.model_dump(mode="json"),
            "methods": list(self.methods),
            "scenarios": list(self.scenarios),
            "limit": self.limit,
            "plugins": [{"path": str(path), "sha256": digest} for path, digest in self.plugins],
        }

    @classmethod
    def of(cls, manifest: Manifest, run: Path) -> "Plan":
        """The plan that `manifest` of the directory `run` describes.

        Raises:
            InputError: the manifest is incomplete, or a plugin has changed since.
        """
        try:
            plan = manifest["plan"]
            made = cls(
                Suite.model_validate(plan["suite"]),
                tuple(plan["methods"]),
                tuple(plan["scenarios"]),
                plan["limit"],
                tuple((Path(p["path"]), p["sha256"]) for p in plan["plugins"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{run} cannot be resumed: its manifest is incomplete ({error}). Start a new run."
            ) from error
        for path, digest in made.plugins:
            if not path.is_file() or _sha256(path) != digest:
                raise InputError(
                    f"{run} cannot be resumed: the plugin {path} has changed. Start a new run."
                )
        return made


def make_plan(
    suite: Suite,
    *,
    methods: Sequence[str] = (),
    scenarios: Sequence[str] = (),
    limit: int | None = None,
    plugins: Iterable[Path] = (),
) -> Plan:
    """Choose from `suite`; without `methods`, its default methods and those of the plugins.

    Raises:
        InputError: an unknown method or scenario (the nearest is suggested), or a bad plugin.
    """
    files = tuple(dict.fromkeys(path.resolve() for path in plugins))
    added = [name for path in files for name in plugin_methods(path)]
    known = {*known_methods(), *added}
    chosen = tuple(dict.fromkeys(methods or (*suite.methods, *added)))
    for name in chosen:
        if name not in known:
            raise unknown_name("method", name, known)
    offered = [scenario.name for scenario in suite.scenarios]
    for name in scenarios:
        if name not in offered:
            raise unknown_name(f"scenario of suite {suite.name!r}", name, offered)
    return Plan(
        suite,
        chosen,
        tuple(name for name in offered if not scenarios or name in scenarios),
        suite.limit if limit is None else limit,
        tuple((path, _sha256(path)) for path in files),
    )


def start_run(
    plan: Plan, out: Path, *, jobs: int = 1, progress: RunProgress | None = None
) -> RunResult:
    """Run `plan` into the new directory `out`, `jobs` cells at a time.

    Call it from a script only under `if __name__ == "__main__":`, since it starts processes.

    Raises:
        InputError: `out` is not empty.
        DataUnavailableError: no scenario's data could be had.
        RunInterruptedError: Ctrl-C; `resume_run` continues.
        EitbenchError: `out` cannot be written.
    """
    progress = progress or RunProgress(quiet=True)
    store = RunStore.create(out)
    try:
        data, skipped = _load(plan, plan.scenarios, jobs, progress)
        if not data:
            raise DataUnavailableError(" ".join(skipped.values()))
        manifest = _new_manifest(plan, data, skipped, jobs)
        store.write_manifest(manifest)
    except BaseException:  # nothing has been run: leave nothing behind, after Ctrl-C too
        store.discard()
        raise
    return _execute(plan, store, manifest, data, jobs, progress)


def resume_run(
    run: Path, *, suite: Suite | None = None, jobs: int = 1, progress: RunProgress | None = None
) -> RunResult:
    """Continue the run in `run`, in place, with the choices it was started with.

    Raises:
        InputError: `run` is no run directory, or belongs to another suite, plugin or data.
        RunInterruptedError, EitbenchError: as for `start_run`.
    """
    manifest = manifests.read(run)
    plan = Plan.of(manifest, run)
    if suite is not None and suite != plan.suite:
        raise InputError(
            f"{run} is a run of suite {plan.suite.name!r} as it was then, not of this "
            f"{suite.name!r}: leave the suite out to continue it, or start a new run."
        )
    progress = progress or RunProgress(quiet=True)
    skipped: dict[str, str] = manifest["skipped"]
    if manifest["status"] == "finished":
        return RunResult(run, tuple(skipped.values()))
    data, missing = _load(plan, list(manifest["data"]), jobs, progress)
    if missing:
        raise DataUnavailableError(" ".join(missing.values()))
    for name, there in data.items():
        if there.test.data_hash != manifest["data"][name]["hash"]:
            raise InputError(
                f"{run} cannot be resumed: the data of scenario {name!r} have changed since it "
                "was started. Start a new run."
            )
    manifest["resumed"].append(
        {"time": manifests.now(), "command_line": manifests.command_line(), "jobs": jobs}
        | manifests.environment()
    )
    return _execute(plan, RunStore(run), manifest, data, jobs, progress)


def _load(
    plan: Plan, names: Sequence[str], jobs: int, progress: RunProgress
) -> tuple[dict[str, CellData], dict[str, str]]:
    """Data of the scenarios called `names`, and a sentence for each that cannot be had."""
    data: dict[str, CellData] = {}
    skipped: dict[str, str] = {}
    for scenario in plan.suite.scenarios:
        if scenario.name not in names:
            continue
        shown = not progress.quiet
        try:
            if isinstance(scenario, RecordedScenario):
                limit_s = plan.suite.download_limit_s
                locate(scenario.recorded_set, limit_s=limit_s, progress=shown)
            test = load(scenario, split="test", limit=plan.limit, jobs=jobs, progress=shown)
            positions = test.truth == "position"
            validation = (
                load(scenario, split="validation", limit=REGISTRATION_FRAMES) if positions else None
            )
        except DataUnavailableError as error:
            skipped[scenario.name] = f"Scenario {scenario.name!r} is skipped: {error}"
            continue
        data[scenario.name] = CellData(test, validation)
    if data:
        for sentence in skipped.values():
            progress.say(sentence)
    return data, skipped


def _new_manifest(
    plan: Plan, data: dict[str, CellData], skipped: dict[str, str], jobs: int
) -> Manifest:
    return {
        "format": 1,
        "status": "running",
        "command_line": manifests.command_line(),
        "started": manifests.now(),
        "finished": None,
        "resumed": [],
        **manifests.environment(),
        "calibration_ms": calibration(),
        "jobs": jobs,
        "batch": BATCH,
        "threads": THREADS,
        "seeds": {"methods": SEED},
        "plan": plan.describe(),
        "data": {
            name: {
                "hash": there.test.data_hash,
                "inverse_crime": there.test.inverse_crime,
                "n": len(there.test.voltages),
                "truth": there.test.truth,
                "sensor": there.test.sensor.name,
            }
            for name, there in data.items()
        },
        "skipped": skipped,
        "cells": [
            _chosen_parameters(plan, name, method) for name in data for method in plan.methods
        ],
    }


def _chosen_parameters(plan: Plan, scenario_name: str, method: str) -> Manifest:
    scenario = next(s for s in plan.suite.scenarios if s.name == scenario_name)
    parameters = selected_parameters(scenario, method)
    return {
        "scenario": scenario_name,
        "method": method,
        "track": "default" if parameters is None else "tuned",
        "parameters": dict(parameters or {}),
    }


def _execute(
    plan: Plan,
    store: RunStore,
    manifest: Manifest,
    data: dict[str, CellData],
    jobs: int,
    progress: RunProgress,
) -> RunResult:
    scenarios = {scenario.name: scenario for scenario in plan.suite.scenarios}
    cells = [
        CellPlan(
            cell=Cell(entry["scenario"], entry["method"]),
            track=entry["track"],
            parameters=entry["parameters"],
            suite=plan.suite.name,
            scenario=scenarios[entry["scenario"]],
            plugins=tuple(path for path, _ in plan.plugins),
            fit_limit_s=plan.suite.fit_limit_s,
            frame_limit_s=plan.suite.frame_limit_s,
            batch=manifest["batch"],
        )
        for entry in manifest["cells"]
    ]
    interrupted = not _run_cells(cells, data, store, jobs, progress)
    if interrupted:
        for cell in cells:
            if not store.finished(cell.cell) and store.has_batches(cell.cell):
                judge_cell(cell, data[cell.cell.scenario], store, {})
    datasets = {name: there.test for name, there in data.items()}
    store.assemble([cell.cell for cell in cells], datasets)
    manifest |= {
        "status": "interrupted" if interrupted else "finished",
        "finished": None if interrupted else manifests.now(),
    }
    store.write_manifest(manifest)
    if interrupted:
        raise RunInterruptedError(
            f"Interrupted: finished rows are kept in {store.path}. Continue with "
            f"`eitbench run --resume {store.path}`."
        )
    store.remove_parts()
    return RunResult(store.path, tuple(manifest["skipped"].values()))


def _run_cells(
    cells: list[CellPlan],
    data: dict[str, CellData],
    store: RunStore,
    jobs: int,
    progress: RunProgress,
) -> bool:
    """Run what is not finished; False after Ctrl-C.

    Raises:
        EitbenchError: rows could not be written; those that were are kept.
    """
    stop = threading.Event()

    def work(plan: CellPlan) -> None:
        there = data[plan.cell.scenario]
        with progress.cell(str(plan.cell), there.n_frames) as bar:
            if not stop.is_set() and not store.finished(plan.cell):
                run_cell(plan, there, store, bar, stop)

    with progress.cells(len(cells)), ThreadPoolExecutor(jobs) as pool:
        futures: list[Future[None]] = [pool.submit(work, plan) for plan in cells]
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
            raise EitbenchError(
                f"{error} What was finished is kept: when that is mended, continue with "
                f"`eitbench run --resume {store.path}`."
            ) from error
        if error is not None and not isinstance(error, StoppedError):
            raise error
    return True


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
