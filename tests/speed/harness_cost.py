"""Cost of the harness beside the methods, gain of a second core, and an estimate for large runs.

    python tests/speed/harness_cost.py paper --limit 120

runs a suite with one job and with two, and prints for each method the seconds that it took itself,
the seconds of its cell, and what follows for large runs. Data are simulated before the clock
starts.
"""

import argparse
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from unittest.mock import patch

import numpy as np

from eitbench.benchmark.run import cell
from eitbench.benchmark.run import executors as execution
from eitbench.benchmark.run.cell_task import CellTask
from eitbench.benchmark.run.progress import Advance
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.worker import Worker
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.suite import load_suite

SAMPLES, METHODS = 1_000_000, 50


class Clock:
    """Seconds in methods and in cells, by method, while `run` runs."""

    def __init__(self) -> None:
        self.method: dict[str, float] = defaultdict(float)
        self.fixed: dict[str, float] = defaultdict(float)
        self.cell: dict[str, float] = defaultdict(float)
        self._here = threading.local()

    def run(self, suite: str, methods: list[str], limit: int, jobs: int) -> float:
        """Wall time of a run [s]."""
        plan = make_plan(load_suite(suite), methods=methods, limit=limit)
        ask, run_cell = Worker.ask, cell.run_cell

        def timed_ask(worker: Worker, *request: object, limit: float, what: str) -> Reply:
            reply = ask(worker, *request, limit=limit, what=what)
            self.method[self._here.name] += reply.seconds
            if what in ("set-up", "a single frame"):  # do not grow with the number of samples
                self.fixed[self._here.name] += reply.seconds
            return reply

        def timed_cell(
            task: CellTask,
            progress: Advance,
            stop: threading.Event,
            core: int | None = None,
            *,
            isolate: bool = False,
        ) -> None:
            self._here.name = task.plan.cell.name
            start = time.perf_counter()
            run_cell(task, progress, stop, core, isolate=isolate)
            self.cell[self._here.name] += time.perf_counter() - start

        with (
            patch.object(Worker, "ask", timed_ask),
            patch.object(execution, "run_cell", timed_cell),
            tempfile.TemporaryDirectory() as folder,
        ):
            start = time.perf_counter()
            start_run(plan, Path(folder) / "run", jobs=jobs)
            return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suite")
    parser.add_argument("--limit", type=int, default=120)
    parser.add_argument("--methods", default="")
    given = parser.parse_args()
    suite = load_suite(given.suite)
    methods = [name for name in given.methods.split(",") if name] or list(suite.names)
    for scenario in suite.scenarios:
        load(scenario, limit=given.limit, jobs=2)
    one = Clock()
    walls = [
        clock.run(given.suite, methods, given.limit, jobs)
        for jobs, clock in enumerate((one, Clock()), 1)
    ]
    frames = given.limit * len(suite.scenarios)
    print(f"{'':20s}  method s   cell s  method ms/frame  harness ms/frame")
    for name in methods:
        own, whole = one.method[name], one.cell[name]
        a_frame = 1e3 * np.array([own - one.fixed[name], whole - own]) / frames
        print(f"{name:20s}  {own:8.2f} {whole:8.2f}  {a_frame[0]:15.2f}  {a_frame[1]:16.2f}")
    own = sum(one.method.values())
    print(f"harness beside the methods' own time: {100 * (walls[0] - own) / own:.1f} %")
    print(
        f"one job {walls[0]:.1f} s, two {walls[1]:.1f} s: {walls[0] / walls[1]:.2f} times as fast"
    )
    hours = walls[0] / frames / len(methods) * SAMPLES * METHODS / 3600
    print(f"{SAMPLES:,} samples x {METHODS} methods like these: {hours:,.0f} core hours")


if __name__ == "__main__":
    main()
