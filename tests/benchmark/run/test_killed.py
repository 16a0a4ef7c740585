"""Runs that are killed at random moments lose no finished row, and end as if nothing had been."""

import json
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.suite import load_suite

SEED, KILLS = 0, 200
METHODS = "noser,toy-random,toy-nan,toy-slow,toy-dies-on-one,toy-killed,toy-exits"
# Method and sample of each row, and its time, which a row computed again would not have.
Rows = dict[tuple[str, int], float]


def ended(suite: Path, toys: Path, out: Path, after: float | None = None) -> bool:
    """Run or resume in a process of its own; False if it was killed after so many seconds."""
    command = [sys.executable, "-c", "from eitbench.cli import main; main()", "run"]
    begin = [str(suite), "--plugin", str(toys), "--methods", METHODS, "--out", str(out)]
    begun = (out / "manifest.json").is_file()
    command += [*(["--resume", str(out)] if begun else begin), "--jobs", "2"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=after)  # ends it by SIGKILL
    except subprocess.TimeoutExpired:
        return False
    assert done.returncode == 0, done.stderr.decode()
    return True


def finished_rows(out: Path) -> Rows:
    """Every row that is kept in a run directory, be it of a finished run or not."""
    content = out / "manifest.json"
    if content.is_file() and json.loads(content.read_text())["status"] == "finished":
        table = pd.read_parquet(out / "samples.parquet")
        keys = zip(table["method"], table["sample"], strict=True)
        times = table["frame_ms"].tolist()
        return {(m, int(k)): t for (m, k), t in zip(keys, times, strict=True)}
    found: Rows = {}
    for path in out.glob("parts/*/*/test-*.npz"):
        with np.load(path) as arrays:
            start = int(path.stem.rpartition("-")[2])
            for k, ms in enumerate(arrays["frame_ms"]):
                found[path.parent.name, start + k] = float(ms)
    return found


def assert_kept(before: Rows, after: Rows) -> None:
    """Every row of before is there, with the time that was measured when it was computed."""
    assert before.keys() <= after.keys()
    lost = [key for key, ms in before.items() if not np.array_equal(ms, after[key], equal_nan=True)]
    assert not lost, lost[:3]


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_killed_at_any_moment(
    toys: Path,
    tmp_path: Path,
    same_results: Callable[[Path, Path], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """200 kills; prints how many fell into what."""
    suite = tmp_path / "killed.toml"
    text = (Path(__file__).parents[1] / "data" / "tiny.toml").read_text()
    suite.write_text(
        text.replace('name = "tiny"', 'name = "killed"').replace("test = 5", "test = 70")
    )
    largest = np.sort(load(load_suite(suite).scenarios[0]).voltages.max(axis=1))
    monkeypatch.setenv("TOY_LIMIT", repr(float(largest[-2:].mean())))
    start = time.monotonic()
    assert ended(suite, toys, tmp_path / "whole")
    usual = time.monotonic() - start
    rng, kills, runs, kept = random.Random(SEED), 0, 0, 0
    while kills < KILLS:
        out = tmp_path / f"run-{runs}"
        rows: Rows = {}
        while not ended(suite, toys, out, after=rng.uniform(0, usual)):
            kills += 1
            after = finished_rows(out)
            assert_kept(rows, after)
            rows, kept = after, kept + len(after)
        assert_kept(rows, finished_rows(out))
        assert not (out / "parts").exists()
        same_results(tmp_path / "whole", out)
        runs += 1
    print(f"{kills} kills of {runs} runs of {usual:.1f} s; {kept} rows were finished, none lost.")
