"""A disk that is really full, and a cache that two runs fill at the same time."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from eitbench.benchmark.run.runner import make_plan, resume_run, start_run
from eitbench.scenarios.suites.suite import load_suite

SameResults = Callable[[Path, Path], None]
TINY = Path(__file__).parents[1] / "data" / "tiny.toml"
MAIN = "from eitbench.cli import main; main()"
METHODS = ["noser", "tikhonov"]
RUN = [sys.executable, "-c", MAIN, "run", str(TINY), "--methods", ",".join(METHODS)]
# On a small disk of its own the run fails and leaves whole files, from which it can be resumed.
SCRIPT = """
set -e
mount -t tmpfs -o size=100k tmpfs "$DISK"
if "$@" --out "$DISK/run" 2> "$SAID"; then echo "it fits"; exit 3; fi
if find "$DISK/run" -name '.*.part*' | grep .; then exit 4; fi
cp -r "$DISK/run" "$KEPT"
"""


@pytest.mark.nightly
def test_a_full_disk_is_one_sentence_and_breaks_nothing(
    same_results: SameResults, tmp_path: Path
) -> None:
    disk, said, kept = (tmp_path / name for name in ("disk", "said", "kept"))
    disk.mkdir()
    own = ["unshare", "--user", "--map-root-user", "--mount"]
    probe = [*own, "mount", "-t", "tmpfs", "tmpfs", str(disk)]
    if shutil.which("unshare") is None or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("needs to mount a small disk: run as root on Linux")
    start_run(make_plan(load_suite(str(TINY)), methods=METHODS), tmp_path / "whole")
    names = {"DISK": disk, "SAID": said, "KEPT": kept}
    environment = os.environ | {name: str(path) for name, path in names.items()}
    done = subprocess.run([*own, "sh", "-c", SCRIPT, "sh", *RUN], env=environment)
    text = said.read_text()
    assert done.returncode == 0, text
    assert "No space left on device" in text
    assert "eitbench run --resume" in text
    assert "Traceback" not in text
    resume_run(kept)
    same_results(tmp_path / "whole", kept)


@pytest.mark.nightly
def test_two_runs_share_a_cache(
    same_results: SameResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    runs = [tmp_path / "one", tmp_path / "two"]
    with subprocess.Popen([*RUN, "--out", str(runs[0])], stdout=subprocess.DEVNULL) as other:
        # Both begin with an empty cache: one simulates while the other does.
        start_run(make_plan(load_suite(str(TINY)), methods=METHODS), runs[1])
    assert other.returncode == 0
    same_results(*runs)
