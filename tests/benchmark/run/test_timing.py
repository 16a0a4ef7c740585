"""What is recorded beside times, and what is said of too few of them."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_info, threadpool_limits

from eitbench.benchmark.run import method_cell, timing
from eitbench.benchmark.run.method_cell import MethodCellTask
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.workers.messages import Failure, Reply
from eitbench.benchmark.workers.method_service import FrameService
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.suites.suite import Suite

PINNABLE = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity"), reason="needs to pin a process to a core: run on Linux"
)

FRAME_LIMIT_S = 5.0


def warm_of(
    samples: int, beside: Any, ask: Callable[..., Reply], monkeypatch: pytest.MonkeyPatch
) -> dict[str, float]:
    """Figures of a method's frames, which `ask` times; all are valid."""
    valid = np.ones(samples, dtype=bool)
    monkeypatch.setattr(method_cell, "WARM_SECONDS", 1.0)
    monkeypatch.setattr(method_cell, "TAIL_SECONDS", 20.0)
    monkeypatch.setattr(method_cell, "StoredSamples", lambda task: SimpleNamespace(valid=valid))
    suite = SimpleNamespace(frame_limit_s=FRAME_LIMIT_S)
    plan: Any = SimpleNamespace(cell=SimpleNamespace(variant=""), suite=suite)
    frames = np.arange(float(samples))[:, None]
    data: Any = SimpleNamespace(frames=lambda split: (frames, frames))
    nothing: Any = None
    return MethodCellTask(plan, nothing, data).warm(ask, beside)


def times_of(
    seconds: float, samples: int, *, pinned: bool, monkeypatch: pytest.MonkeyPatch
) -> dict[str, float]:
    """Figures of frames that take `seconds` each, every tenth of them twice as long."""
    asked: list[int] = []

    class Service(FrameService):
        def reconstruct(self, frames: Array, references: Array) -> Reply:
            assert len(frames) == len(references) == 1
            asked.append(int(frames[0, 0]))
            return Reply(None, seconds * (1 + (len(asked) % 10 == 0)))

    def ask(*request: Any, limit: float, what: str) -> Reply:
        asked_for, *inputs = request
        assert asked_for == "times"
        assert limit > FRAME_LIMIT_S
        messages.append(what)
        return Service().times(*inputs)

    messages: list[str] = []
    beside = SimpleNamespace(pinned=pinned, counts=lambda: True)
    found = warm_of(samples, beside, ask, monkeypatch)
    # In turn; the first frame was timed before and comes last.
    assert asked == [(k + 1) % samples for k in range(len(asked))]
    return found | {"frames": len(asked), "messages": len(messages)}


@pytest.mark.parametrize(
    ("seconds", "samples", "pinned", "frames", "p99"),
    [
        (0.0001, 7, False, 1000, True),
        (0.01, 1200, True, 1000, True),  # 11 s
        (0.01, 7, True, 91, False),  # 1 s, for it would be the same few frames again
        (0.01, 1200, False, 91, False),  # too few for a 99th percentile
        (0.03, 1200, True, 31, False),  # 1,000 would take more than 20 s
    ],
)
def test_a_99th_percentile_is_of_a_thousand_frames(
    seconds: float,
    samples: int,
    pinned: bool,
    frames: int,
    p99: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = times_of(seconds, samples, pinned=pinned, monkeypatch=monkeypatch)
    assert found["frames"] == pytest.approx(frames, abs=1)
    assert found["messages"] <= 1 + 1.1 * seconds * frames
    assert found["frame_ms_p50"] == pytest.approx(1e3 * seconds)
    # The slowest tenth takes twice as long: p90 is neither p95 nor p99.
    assert found["frame_ms_p95"] == pytest.approx(2e3 * seconds)
    expected = 2e3 * seconds if p99 else np.nan
    assert found["frame_ms_p99"] == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("rows", [1, 7])
def test_a_method_that_keeps_its_answers_is_timed_on_frames_that_it_never_saw(rows: int) -> None:
    """Nor saw in float32, which networks take."""
    frames = np.random.default_rng(0).normal(size=(rows, 208))
    kept = {row.astype(np.float32).tobytes() for row in frames}  # from the test itself
    farthest, references = [0.0], set[bytes]()

    class Keeping(FrameService):
        def reconstruct(self, frame: Array, reference: Array) -> Reply:
            references.add(reference.tobytes())
            farthest.append(float(np.abs(frame / frames - 1).max(axis=1).min()))
            key = frame.astype(np.float32).tobytes()
            known = key in kept
            kept.add(key)
            return Reply(None, 1e-6 if known else 0.02)

    reply = Keeping().times(1000, 100.0, "reconstruct", frames, np.ones((rows, 208)))
    assert reply.value == [0.02] * 1000
    assert max(farthest) <= 1.001e-4
    assert len(references) == 1  # what is kept of a reference is kept in use, too


@PINNABLE
def test_a_run_is_timed_on_the_idlest_core_of_equals_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    busy = [5.0, 0.0, 40.0, 0.0]
    monkeypatch.setattr("psutil.cpu_percent", lambda *_, percpu: busy)
    monkeypatch.setattr(timing, "_listed_cores", lambda: [0, 1, 2, 3])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})
    assert timing.core_to_pin() == 3
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2})
    assert timing.core_to_pin() == 0


def test_cores_that_are_off_are_not_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Numbers of cores have gaps where siblings are off, and loads are listed without them."""
    (tmp_path / "stat").write_text("cpu  9 9\ncpu0 1 1\ncpu2 1 1\ncpu4 1 1\ncpu6 1 1\nintr 5\n")
    monkeypatch.setattr(timing, "_CORES", tmp_path / "stat")
    monkeypatch.setattr("psutil.cpu_percent", lambda *_, percpu: [5.0, 0.0, 40.0, 7.0])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 4, 6})
    assert timing.core_to_pin() == 2
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {4, 6})
    assert timing.core_to_pin() == 6
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 8})  # one that is not listed
    assert timing.core_to_pin() == 8


def test_the_calibration_solve_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def watched(matrix: Any) -> Any:
        seen.append({pool["num_threads"] for pool in threadpool_info()})
        return splu(matrix)

    monkeypatch.setattr(timing, "splu", watched)
    with threadpool_limits(2):
        timing.calibration_solves()
    assert set.union(*seen) == {1}


def test_every_timed_frame_sees_the_same_random_numbers() -> None:
    class Drawing(FrameService):
        def reconstruct(self, frames: Array) -> Reply:
            return Reply(None, float(np.random.rand()))  # noqa: NPY002

    times = Drawing().times(5, 100.0, "reconstruct", np.ones((2, 3))).value
    assert len(set(times)) == 1


class Fragile(FrameService):
    """Answers until the frame `bad` comes."""

    def __init__(self, bad: int) -> None:
        self.bad = bad

    def reconstruct(self, frames: Array) -> Reply:
        """Reply with a time, or with a failure."""
        bad = round(float(frames[0, 0]), 3) == self.bad
        failure = Failure("error", "no more") if bad else None
        return Reply(None, 0.01, failure)


def test_frames_before_one_that_fails_are_timed_and_its_failure_is_said() -> None:
    frames = np.arange(5.0)[:, None]
    reply = Fragile(bad=3).times(100, 1.0, "reconstruct", frames)
    assert (reply.value, reply.failure) == ([0.01, 0.01, 0.01], None)
    failed = Fragile(bad=0).times(100, 1.0, "reconstruct", frames)
    assert failed.failure == Failure("error", "no more")


@pytest.mark.slow
@PINNABLE
def test_one_cell_at_a_time_has_a_core_of_its_own_and_two_share(
    tiny: Suite, tmp_path: Path
) -> None:
    plugin = tmp_path / "cores.py"
    plugin.write_text(
        "import json\n"
        "import os\n"
        "import numpy as np\n"
        "from eitbench.methods import Method, register\n"
        "@register('cores')\n"
        "class Cores(Method):\n"
        "    def fit(self, problem):\n"
        "        self.shape = problem.mask.shape\n"
        "        print(json.dumps(sorted(os.sched_getaffinity(0))))\n"
        "    def reconstruct(self, voltages):\n"
        "        return np.ones((len(voltages), *self.shape))\n"
    )
    before = os.sched_getaffinity(0)
    plan = make_plan(tiny, methods=["cores"], plugins=[plugin])
    for jobs, timed in ((1, "pinned"), (2, "shared")):
        run = start_run(plan, tmp_path / timed, jobs=jobs).path
        cores = set(json.loads((run / "logs" / "tiny--cores.log").read_text().splitlines()[0]))
        # Which one is pinned depends on what else runs: it is the idlest.
        assert cores == before if timed == "shared" else len(cores) == 1 and cores < before
        (row,) = pd.read_parquet(run / "methods.parquet").to_dict("records")
        assert row["timed"] == timed
        assert row["calibration_ms"] > 0
        assert row["calibration_spread"] >= 1
    assert os.sched_getaffinity(0) == before


def test_what_is_timed_beside_slow_solves_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve of a calm machine takes 22 ms at most; the third chunk is between two that do."""
    solves = iter([[20.0], [40.0], [22.0], [21.0], [23.0]])
    monkeypatch.setattr(timing, "calibration_solves", lambda: next(solves))
    monkeypatch.setattr(timing._Load, "_state", staticmethod(lambda: (0.0, 0.0, 0.0)))
    beside = timing.Conditions(None, calm_ms=22.0)
    assert [beside.counts() for _ in range(4)] == [False, False, True, True]
    found = beside.columns()
    assert found["calibration_ms"] == 22.0  # the median of 22, 21 and 23
    assert found["calibration_spread"] == 23 / 21


def test_what_is_timed_while_others_work_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1 s others kept a core busy for 0.9 s, then for 0.1 s."""
    monkeypatch.setattr(timing, "calibration_solves", lambda: [20.0])
    loads = iter([0.9, 0.1])
    monkeypatch.setattr(timing._Load, "of_others", lambda self: next(loads))
    beside = timing.Conditions(None, calm_ms=22.0)
    assert [beside.counts() for _ in range(2)] == [False, True]
    assert beside.columns()["load"] == 0.1  # of what counts


def test_a_machine_that_is_never_calm_is_timed_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "calibration_solves", lambda: [40.0])
    monkeypatch.setattr(timing, "PATIENCE_S", 0.0)
    beside = timing.Conditions(None, calm_ms=22.0)
    assert beside.counts()
    assert beside.over
    assert not beside.counts()
    assert beside.columns()["calibration_ms"] == 40.0


def test_frames_that_did_not_count_are_timed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = iter([False, True])
    asked: list[list[float]] = []

    def ask(*request: Any, limit: float, what: str) -> Reply:
        asked.append(request[4][:, 0].tolist())
        return Reply([0.5, 0.5] if len(asked) > 1 else [9.0, 9.0], 0.0)

    beside: Any = SimpleNamespace(pinned=True, over=False, counts=lambda: next(counted))
    assert warm_of(4, beside, ask, monkeypatch)["frame_ms_p50"] == 500
    assert asked == [[1, 2, 3, 0]] * 2


def test_the_load_of_other_programs_leaves_out_our_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """In 2 s all programs compute for 3 s, of which this one and its children 1 s."""
    states = iter([(10.0, 100.0, 4.0), (12.0, 103.0, 5.0), (12.05, 103.0, 5.0)])
    monkeypatch.setattr(timing._Load, "_state", staticmethod(lambda: next(states)))
    assert timing._Load().of_others() == pytest.approx(1.0)


def test_what_a_child_computes_is_our_own() -> None:
    program = (
        "import time\nwhile time.process_time() < 0.5: pass\nprint('done', flush=True)\ninput()"
    )
    before = timing._Load._state()
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        after = timing._Load._state()
        child.communicate(b"\n")
    assert after[2] - before[2] > 0.45
    # The machine counts in hundredths of a second.
    assert after[1] - before[1] > after[2] - before[2] - 0.1
