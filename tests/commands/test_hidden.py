"""The commands of hidden sets and of submissions, from a key to a gap and from a run to a tier."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from eitbench.benchmark.submissions import rerun, run_checks
from eitbench.benchmark.submissions.check import Check
from eitbench.benchmark.submissions.sums import SUMS
from eitbench.benchmark.workers.confinement import check_isolation
from eitbench.commands.board import VERSION
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites import suite as suites
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite

SMALL = SimulatedScenario(
    name="n", image_shape=(20, 20), families=("circle",), noise=SplitNoise(test=50.0), train=0,
    validation=2, test=30,
)  # fmt: skip
SUITE = Suite(name="quick", title="Quick", methods=("noser",), scenarios=(SMALL,))
Command = Callable[..., tuple[int, str, str]]


def isolates() -> bool:
    try:
        check_isolation()
    except InputError:
        return False
    return True


MINE = """
from eitbench.methods import create, Method, register
@register("mine")
class Mine(Method):
    def fit(self, problem):
        self.inner = create("noser")
        self.inner.fit(problem)
    def reconstruct(self, voltages):
        return self.inner.reconstruct(voltages)
"""


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suites, "load_suite", lambda name: SUITE)
    monkeypatch.setattr(run_checks, "load_suite", lambda name: SUITE)
    monkeypatch.setattr("eitbench.benchmark.rundir.manifest.git_commit", lambda: "a" * 40)


def publish(folder: Path, printed: str) -> Path:
    sha256 = printed.rpartition("sha256 = ")[2].strip().strip("'")
    (folder / "board").mkdir()
    (folder / "board" / "hidden.toml").write_text(
        f'[[keys]]\nversion = "{VERSION}"\nsuite = "quick"\nsha256 = "{sha256}"\n'
    )
    return folder / "board"


@pytest.mark.slow
def test_from_a_key_to_the_gap_of_a_method(
    eitbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try:
        check_isolation()
    except InputError as error:
        pytest.skip(str(error))
    key = tmp_path / "key"
    with monkeypatch.context() as patch:  # with one key in forty a fall is found by chance
        patch.setattr("secrets.token_bytes", lambda count: bytes(range(count)))
        code, printed, _ = eitbench("hidden", "new-key", key)
    assert code == 0
    board = publish(tmp_path, printed)
    assert key.read_text().strip() not in printed

    code, _, err = eitbench("run", "quick", "--out", tmp_path / "open")
    assert code == 0, err
    options = ("--records", board, "--key", key)
    code, out, err = eitbench("hidden", "run", "quick", *options, "--out", tmp_path / "hidden")
    assert code == 0, err
    assert "keep it as secret as the key" in out
    manifest = json.loads((tmp_path / "hidden" / "manifest.json").read_text())
    assert manifest["hidden"] in (board / "hidden.toml").read_text()

    # As if it had been stopped before its first cell: the same frames are drawn again.
    stopped = manifest | {"status": "interrupted", "finished": None}
    seen = ["sample", "input_hash", "psnr"]
    before = pd.read_parquet(tmp_path / "hidden" / "samples.parquet")[seen]
    (tmp_path / "hidden" / "manifest.json").write_text(json.dumps(stopped))
    code, _, err = eitbench("run", "--resume", tmp_path / "hidden")
    assert code == 2
    assert "does not hold its key: continue it with the `eitbench hidden run` that began" in err
    folder = ("--out", tmp_path / "hidden")
    code, _, err = eitbench("hidden", "run", "quick", *options, *folder, "--methods", "tv")
    assert code == 2
    assert "give the same methods, scenarios and plugins to continue it" in " ".join(err.split())
    code, _, err = eitbench("hidden", "run", "quick", *options, *folder)
    assert code == 0, err
    assert json.loads((tmp_path / "hidden" / "manifest.json").read_text())["status"] == "finished"
    after = pd.read_parquet(tmp_path / "hidden" / "samples.parquet")[seen]
    pd.testing.assert_frame_equal(after, before)

    gap = ("hidden", "gap", tmp_path / "open", tmp_path / "hidden")
    code, out, err = eitbench(*gap, "--record", board / VERSION)
    assert code == 0, err
    assert "no fall found" in out
    kept = board / VERSION / "hidden" / "quick-1.json"
    digest = hashlib.sha256(kept.read_bytes()).hexdigest()
    assert (board / VERSION / SUMS).read_text() == f"{digest}  hidden/quick-1.json\n"
    code, out, _ = eitbench(*gap, "--json")
    assert json.loads(out)["gaps"][0]["method"] == "noser"
    code, _, err = eitbench(*gap, "--record", board / VERSION)
    assert code == 2
    assert "never edited" in err


def test_a_key_that_is_not_published_draws_nothing(eitbench: Command, tmp_path: Path) -> None:
    _, printed, _ = eitbench("hidden", "new-key", tmp_path / "one")
    board = publish(tmp_path, printed)
    eitbench("hidden", "new-key", tmp_path / "two")
    where = ("--records", board, "--key", tmp_path / "two", "--out", tmp_path / "run")
    code, _, err = eitbench("hidden", "run", "quick", *where)
    assert code == 2
    assert "is not the published one" in err
    assert not (tmp_path / "run").exists()
    where = ("--records", tmp_path, "--key", tmp_path / "two", "--out", tmp_path / "run")
    code, _, err = eitbench("hidden", "run", "quick", *where)
    assert code == 2
    assert "Cannot read the key file" in err
    code, _, err = eitbench("hidden", "new-key", tmp_path / "no" / "folder")
    assert code == 1
    assert "No such file" in err


@pytest.mark.parametrize(
    "folder",
    ["recordings", "eidors", "cache/weights", "cache/recordings", "cache/simulated/train"],
)
@pytest.mark.parametrize("option", ["--key", "--out"])
def test_nothing_secret_lies_where_isolated_methods_read(
    eitbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, folder: str
) -> None:
    _, printed, _ = eitbench("hidden", "new-key", tmp_path / "key")
    board = publish(tmp_path, printed)
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "recordings"))
    monkeypatch.setenv("EITBENCH_EIDORS", str(tmp_path / "eidors"))
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / folder).mkdir(parents=True)
    (tmp_path / folder / "key").write_text((tmp_path / "key").read_text())
    places = {"--key": tmp_path / "key", "--out": tmp_path / "run"}
    places[option] = tmp_path / folder / places[option].name
    where = [part for pair in places.items() for part in pair]
    code, _, err = eitbench("hidden", "run", "quick", "--records", board, *where)
    assert code == 2
    assert "which isolated methods may read: name a place outside" in err
    places[option] = Path(__file__).parent / places[option].name  # in the checkout
    if option == "--out":
        where = [part for pair in places.items() for part in pair]
        code, _, err = eitbench("hidden", "run", "quick", "--records", board, *where)
        assert code == 2
        assert "which isolated methods may read" in err
        assert not places["--out"].exists()


@pytest.mark.slow
def test_from_a_run_to_a_submission_that_was_reproduced(
    eitbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, out = tmp_path / "run", tmp_path / "submissions" / "quick" / "mine"
    plugin = tmp_path / "mine.py"
    plugin.write_text(MINE)
    both = tmp_path / "both"
    assert eitbench("run", "quick", "--plugin", plugin, "--out", both)[0] == 0
    code, _, err = eitbench("submission", "make", both, "--out", out)
    assert code == 2
    assert "'noser' is a method of eitbench" in err
    assert not out.exists()
    alone = ("--plugin", plugin, "--methods", "mine")
    assert eitbench("run", "quick", *alone, "--out", run)[0] == 0
    code, printed, _ = eitbench("submission", "check", run)
    assert code == 0
    assert "eitbench submission make" in printed
    code, printed, err = eitbench("submission", "make", run, "--out", out)
    assert code == 0, err
    assert "MB of images" in printed.splitlines()[0]
    assert f"Fill in {out / 'submission.json'}" in printed
    code, printed, err = eitbench("submission", "check", out)
    assert code == 1
    assert "does not say 'name': fill it in" in printed
    said = json.loads((out / "submission.json").read_text()) | {
        "name": "Mine", "authors": ["A"], "contact": "a@example.org", "commit": "0" * 40,
        "code": "https://example.org", "licence": "MIT", "training_data": "none",
        "test_split_seen": False,
    }  # fmt: skip
    (out / "submission.json").write_text(json.dumps(said))
    code, printed, err = eitbench("submission", "check", out)
    assert code == 0, err
    assert "Time (self-reported): 'mine' on 'n'" in printed
    assert "calibration solves" in printed
    assert "Tier: self-reported" in printed
    code, printed, err = eitbench("submission", "check", out, "--rerun", "30")
    assert code == 0, err
    assert "Not noted: without --isolate" in printed
    assert "Tier: self-reported" in printed
    code, _, err = eitbench("submission", "make", run, "--out", out)
    assert code == 2
    assert "is there already" in err
    if not isolates():
        pytest.skip("methods cannot be isolated here: the tier is not looked at")
    code, printed, err = eitbench("submission", "check", out, "--rerun", "4", "--isolate")
    assert code == 0, err
    assert "So few samples are not noted: --rerun 32 makes it reproduced." in printed
    assert "Tier: self-reported" in printed
    code, printed, err = eitbench("submission", "check", out, "--rerun", "30", "--isolate")
    assert code == 0, err
    assert "Tier: reproduced" in printed
    assert "times and memory (self-reported)" in printed
    code, printed, _ = eitbench("leaderboard", out)
    tier = "tier of mine: reproduced on 30 of 30 samples (its times are self-reported)"
    assert tier in " ".join(printed.split())  # wherever lines break
    # What cannot be run here proves nothing; what makes something else takes the tier back.
    for refutes, left in ((False, "Tier: reproduced"), (True, "Tier: self-reported")):
        failed = [Check("again", "It is not.", refutes=refutes)]
        with monkeypatch.context() as patched:
            patched.setattr(rerun, "rerun", lambda *of, failed=failed, **how: failed)
            code, _, err = eitbench("submission", "check", out, "--rerun", "30")
        assert (code, "cannot be accepted" in err) == (1, refutes)
        assert ("could not be run again here" in err) != refutes
        assert left in eitbench("submission", "check", out)[1]
