"""A small part of the fuzzing, and the problems that it notices. See docs/security.md."""

import faulthandler
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
RECORD = ROOT / "docs" / "studies" / "fuzz" / "fuzz.csv"


@pytest.fixture
def fuzz(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("tests.security.fuzz")


@pytest.mark.slow
def test_spoilt_files_of_all_formats_are_taken_or_refused(
    fuzz: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("EITBENCH_CACHE", "EITBENCH_DATA"):  # which the targets change
        monkeypatch.setenv(name, "")
    fuzz.drive(7, 100, tmp_path, None, slice(None))
    assert fuzz.report(7, tmp_path) == 0
    stored = {path.stem.removesuffix("-7"): path for path in tmp_path.glob("*.json")}
    assert sorted(stored) == pd.read_csv(RECORD)["target"].tolist()
    tallies = [json.loads(path.read_text()) for path in stored.values()]
    assert sum(tally["files"] for tally in tallies) >= 100
    assert sum(tally["taken"] for tally in tallies) > 10  # some spoilt files are still good


@pytest.mark.nightly
def test_a_hundred_thousand_spoilt_files(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.security.fuzz", "--out", str(tmp_path)]
    jobs = ["--files", "100000", "--jobs", str(os.cpu_count())]
    done = subprocess.run([*command, *jobs], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def crash(path: Path) -> None:
    faulthandler.disable()  # nothing to tell the reader of the log
    os.kill(os.getpid(), signal.SIGSEGV)


def fail(path: Path) -> None:
    raise KeyError("x")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read", "limit_s", "problem"),
    [
        (lambda path: np.ones(2**26), 10.0, "memory: 5"),
        (lambda path: time.sleep(60), 1.0, "hang: more than 1 s"),
        (lambda path: time.sleep(0.7), 0.6, "time: 1 s"),
        (crash, 10.0, "crash: ended with -11"),
        (fail, 10.0, "KeyError at test_fuzz.py:fail: 'x'"),
    ],
)
def test_what_goes_wrong_is_found(
    fuzz: Any,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    read: Callable[[Path], None],
    limit_s: float,
    problem: str,
) -> None:
    def third(path: Path) -> None:
        if path.read_bytes() == b"third":
            read(path)

    contents = [b"first", b"second", b"third", b"fourth"]
    monkeypatch.setattr(fuzz, "LIMIT_S", limit_s)
    monkeypatch.setattr(fuzz, "spoilt", lambda seed, name, target, k: contents[k])
    target = fuzz.Target("x", [b""], lambda draws, data: data, third, 1)
    tally = fuzz.Tally()
    reader = fuzz.Reader(tmp_path, 1, {"x": target})
    reader("x", range(4), tally)
    reader.close()
    assert tally.files == 4
    assert tally.taken >= 3
    ((k, found),) = tally.findings
    assert k == 2
    assert found.startswith(problem)
