"""Cost of the harness beside the methods: where the time of a run goes.

    python tests/speed/harness_cost.py quick
    python tests/speed/harness_cost.py noise --scenarios noise-50db --methods noser,tv --limit 300
    python tests/speed/harness_cost.py paper --limit 60 --jobs 2

prints for each method the seconds that it took itself (`fit`, its images and what it states of
them, single frames timed among them), and what the harness took beside it by its parts, then all of
that for each sample and as a share. Data are simulated before the clock starts. `--json FILE` keeps
the figures.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

if __name__ == "__main__":  # each worker imports this file, and needs nothing of it
    from eitbench.benchmark.run import cell, executors, timing
    from eitbench.benchmark.run.cell_task import CellTask
    from eitbench.benchmark.run.runner import Plan, make_plan, start_run
    from eitbench.benchmark.rundir.manifest import cpu_model
    from eitbench.benchmark.rundir.store import RunStore
    from eitbench.benchmark.workers.messages import Reply
    from eitbench.benchmark.workers.worker import Worker
    from eitbench.scenarios.data.datasets import load
    from eitbench.scenarios.suites.suite import load_suite

PARTS = ("start", "set-up", "batches", "timing", "solves", "scoring", "storing", "other")
"""Start and end of processes; imports and the like in set-up; messages and what is done with their
answers, of batches and of single frames that are timed; the calibration solves and the look for an
idle core; metrics; files; the rest of a cell."""
RUN = "the run"


class Clock:
    """Seconds of the methods themselves and of each part of the harness, by method.

    Attributes:
        own: of methods.
        fixed: of methods, but of their set-up and of single frames that are timed.
        parts: of the harness, by method and part; none counts what another one in it does.
    """

    def __init__(self) -> None:
        self.own: dict[str, float] = defaultdict(float)
        self.fixed: dict[str, float] = defaultdict(float)
        self.parts: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
        self._here = threading.local()

    @contextmanager
    def _part(self, name: str) -> Iterator[None]:
        """Count the seconds of the block, but those of parts in it."""
        inside, self._here.inside = getattr(self._here, "inside", 0.0), 0.0
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = time.perf_counter() - start
            self.parts[getattr(self._here, "name", RUN)][name] += seconds - self._here.inside
            self._here.inside = inside + seconds

    def _counted(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(*args: Any, **more: Any) -> Any:
            with self._part(name):
                return function(*args, **more)

        return counted

    def _own_seconds(self, what: str, seconds: float) -> None:
        self.own[self._here.name] += seconds
        if what in ("set-up", "timing"):  # do not grow with the number of samples
            self.fixed[self._here.name] += seconds
        self._here.inside += seconds

    def run(self, plan: Plan, jobs: int) -> float:
        """Return the wall time of a run [s]."""
        ask, run_cell = Worker.ask, cell.run_cell

        def timed_ask(worker: Worker, *request: object, limit: float, what: str) -> Reply:
            part = "timing" if "single frame" in what else "batches"
            part = "set-up" if what == "set-up" else part
            with self._part(part):
                reply = ask(worker, *request, limit=limit, what=what)
                beside = reply.value.get("seconds", {}) if isinstance(reply.value, dict) else {}
                self._own_seconds(part, reply.seconds + sum(beside.values()))
                return reply

        def timed_cell(task: CellTask, *args: Any, **more: Any) -> None:
            self._here.name = task.plan.cell.name
            try:
                with self._part("other"):
                    run_cell(task, *args, **more)
            finally:
                del self._here.name

        with ExitStack() as patches, tempfile.TemporaryDirectory() as folder:
            patches.enter_context(patch.object(Worker, "ask", timed_ask))
            patches.enter_context(patch.object(executors, "run_cell", timed_cell))
            for owner, name, part in (
                (Worker, "__init__", "start"),
                (Worker, "close", "start"),
                (executors, "core_to_pin", "solves"),
                (timing, "calibration_solves", "solves"),
                (cell, "score_cell", "scoring"),
                (RunStore, "save_batch", "storing"),
                (RunStore, "save_cell", "storing"),
                (RunStore, "assemble", "storing"),
            ):
                counted = self._counted(part, getattr(owner, name))
                patches.enter_context(patch.object(owner, name, counted))
            start = time.perf_counter()
            with self._part("other"):
                start_run(plan, Path(folder) / "run", jobs=jobs)
            seconds = time.perf_counter() - start
        if jobs == 1:  # what other threads did is no part of what this one waited for
            of_cells = sum(self.own.values()) + sum(
                sum(parts.values()) for name, parts in self.parts.items() if name != RUN
            )
            self.parts[RUN]["other"] -= of_cells
        return seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suite")
    parser.add_argument("--scenarios", default="")
    parser.add_argument("--methods", default="")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--jobs", type=int, default=1, help="also measure with so many jobs")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    scenarios, methods = (
        [one for one in given_names.split(",") if one]
        for given_names in (given.scenarios, given.methods)
    )
    plan = make_plan(
        load_suite(given.suite), methods=methods, scenarios=scenarios, limit=given.limit
    )
    ran = [each for each in plan.suite.scenarios if each.name in plan.scenarios]
    frames = sum(len(load(each, split="test", limit=plan.limit)) for each in ran)
    clock, solves = Clock(), timing.calibration_solves()
    seconds = clock.run(plan, 1)
    solves += timing.calibration_solves()
    rows: list[dict[str, Any]] = []
    for name in (*plan.names, RUN):
        parts = {part: clock.parts[name][part] for part in PARTS}
        harness, own = sum(parts.values()), clock.own[name]
        samples = min(frames, len(ran) * plan.suite.first.get(name, frames))  # fewer of slow ones
        rows.append(
            {"method": name, "own_s": own, "harness_s": harness, "parts_s": parts}
            | {"cells": len(ran), "samples": samples}
            | {"own_ms_a_sample": 1e3 * (own - clock.fixed[name]) / samples}
            | {"harness_ms_a_sample": 1e3 * harness / samples}
            | {"share": harness / (own + harness)}
        )
    print(
        f"{'':20s}   own s  harness s  ms a sample   share  " + "".join(f"{p:>9s}" for p in PARTS)
    )
    for row in rows:
        print(
            f"{row['method']:20s} {row['own_s']:7.2f} {row['harness_s']:10.2f} "
            f"{row['harness_ms_a_sample']:12.2f} {100 * row['share']:6.1f} %  "
            + "".join(f"{row['parts_s'][part]:9.3f}" for part in PARTS)
        )
    own = sum(clock.own.values())
    a_sample = 1e3 * (seconds - own) / sum(row["samples"] for row in rows if row["method"] != RUN)
    print(
        f"{seconds:.1f} s, of which {seconds - own:.1f} s ({100 * (seconds - own) / seconds:.1f} %)"
        f" in the harness: {a_sample:.2f} ms for a sample of a method"
    )
    jobs_s = Clock().run(plan, given.jobs) if given.jobs > 1 else None
    if jobs_s is not None:
        print(f"{given.jobs} jobs {jobs_s:.1f} s: {seconds / jobs_s:.2f} times as fast")
    if given.json:
        record = {
            "command": "python tests/speed/harness_cost.py "
            + " ".join(word for word in sys.argv[1:] if word not in ("--json", str(given.json))),
            "machine": f"{cpu_model()}, Python {platform.python_version()}",
            "calibration_ms": sorted(solves)[len(solves) // 2],
            "suite": given.suite,
            "seconds": seconds,
            "own_s": own,
            "share": (seconds - own) / seconds,
            "ms_a_sample": a_sample,
            "jobs": given.jobs,
            "jobs_s": jobs_s,
            "rows": rows,
        }
        given.json.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
