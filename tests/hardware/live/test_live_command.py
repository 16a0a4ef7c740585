"""`eitbench live`: what it refuses, and that it begins and ends well with an emulated board."""

import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

import pytest

LIVE = [sys.executable, "-m", "eitbench.cli", "live", "--board", "emulator", "--http-port", "0"]
LIVE += ["--out", "new/folder"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--host", "0.0.0.0"], "give them a --token, too"),
        (["--host", "0.0.0.0", "--token", "short"], "16 to 128"),
        (["--token", "long-enough-to-be-one"], "--host"),
        (["--method", "nose"], "did you mean 'noser'"),
        (["--method", "linear-touch"], "learns from simulated touches before its first image"),
        (["--out", "/dev/null/here"], "--out"),
    ],
)
def test_what_cannot_be_is_one_sentence(eitbench: Any, options: list[str], sentence: str) -> None:
    code, _, err = eitbench("live", "--board", "emulator", "--http-port", "0", *options)
    assert code == 2
    assert sentence in err
    assert err.count("\n") == 1


def test_it_prints_its_address_serves_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    with subprocess.Popen(LIVE, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as running:
        assert running.stdout is not None
        line = running.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/", line)
        assert found is not None
        assert "emulated" in line
        end = time.monotonic() + 30
        while True:
            try:
                with urllib.request.urlopen(found[0], timeout=10) as answer:
                    assert answer.status == 200
                break
            except OSError:
                assert time.monotonic() < end
                time.sleep(0.1)
        assert (tmp_path / "new" / "folder").is_dir()
        running.send_signal(signal.SIGINT)
        assert running.wait(30) == 0
