"""Hidden sets: nobody draws them without the key, and who knows the open frames falls on them."""

import base64
import hashlib
import json
import shutil
import stat
import zlib
from dataclasses import replace
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from eitbench.benchmark.analysis.leaderboard import Entry
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.run import runner
from eitbench.benchmark.run.cell_task import CellPlan
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.submissions import hidden
from eitbench.benchmark.submissions.hidden import (
    HiddenRecord,
    gap_of,
    hidden_record,
    hidden_suite,
    new_key,
    read_hidden,
    read_key,
    write_hidden,
)
from eitbench.reports.board.records import write_record
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite, hidden_key, load_suite

KEY, OTHER = bytes(range(32)), bytes(range(1, 33))
SCENARIO = SimulatedScenario(
    name="n", image_shape=(20, 20), families=("circle", "ring"),
    noise=SplitNoise(validation=50.0, test=50.0), train=3, validation=3, test=36,
    imperfections=Imperfections(electrode_shift_m=0.0005, gain=0.01),
)  # fmt: skip
SUITE = Suite(name="mine", title="Mine", methods=("noser",), scenarios=(SCENARIO,))


def published(folder: Path, key: bytes = KEY, more: str = "") -> Path:
    sha256 = hashlib.sha256(key).hexdigest()
    path = folder / "hidden.toml"
    path.write_text(f'[[keys]]\nversion = "2026.1"\nsuite = "mine"\nsha256 = "{sha256}"\n{more}\n')
    return path


def images(data: Dataset) -> np.ndarray:
    assert data.conductivity is not None
    return data.conductivity


def test_a_key_draws_other_touches_noise_and_units_of_the_same_kind() -> None:
    before, after = load(SCENARIO), load(SCENARIO.drawn_with(KEY))
    assert len(after) == len(before)
    assert after.samples["family"].tolist() == before.samples["family"].tolist()
    assert after.samples["snr_db"].tolist() == before.samples["snr_db"].tolist()
    assert after.samples["cluster"].tolist() == before.samples["cluster"].tolist()
    assert not set(after.frame_hashes) & set(before.frame_hashes)
    assert not (images(after) == images(before)).all(axis=(1, 2)).any()
    assert (after.references != before.references).all()
    # References differ by the unit, too: far more than 50 dB of noise explains.
    size = np.linalg.norm(before.references)
    assert np.linalg.norm(after.references - before.references) > 0.01 * size
    assert after.data_hash != before.data_hash
    units = {SCENARIO.drawn_with(KEY).split_imperfections("test", k).unit for k in range(12)}
    assert len(units) == 12
    assert not units & {SCENARIO.split_imperfections("test", k).unit for k in range(12)}


def test_a_key_draws_the_same_again_and_no_other_key_does() -> None:
    once, again, other = (load(SCENARIO.drawn_with(k), limit=4) for k in (KEY, KEY, OTHER))
    assert once.frame_hashes == again.frame_hashes
    assert not set(once.frame_hashes) & set(other.frame_hashes)
    assert len({once.data_hash, other.data_hash, load(SCENARIO, limit=1).data_hash}) == 3


def test_the_level_of_a_mixture_is_drawn_with_the_key() -> None:
    mixed = SCENARIO.model_copy(update={"noise": SplitNoise(test="mixture")})
    levels = [load(s).samples["snr_db"] for s in (mixed, mixed.drawn_with(KEY))]
    assert not levels[0].equals(levels[1])
    assert levels[1].isna().any()
    assert levels[1].dropna().between(30, 60).all()


def test_methods_learn_and_are_tuned_on_the_open_data() -> None:
    for split in ("train", "validation"):
        before, after = load(SCENARIO, split), load(SCENARIO.drawn_with(KEY), split)
        assert after.frame_hashes == before.frame_hashes
        assert after.data_hash == before.data_hash


def test_the_key_is_in_no_file_and_no_worker(tmp_path: Path) -> None:
    suite = hidden_suite(SUITE, "2026.1", KEY, published(tmp_path))
    (scenario,) = suite.scenarios
    assert isinstance(scenario, SimulatedScenario)
    plan = make_plan(suite, limit=4)
    texts = [suite.model_dump_json(), repr(suite), str(scenario), plan.model_dump_json()]
    assert all(KEY.hex() not in text and repr(KEY) not in text for text in texts)
    data = MethodData.load(scenario, suite, 4, jobs=1, progress=False)
    of_cell = CellPlan(Cell("n", "noser"), "default", {}, {}, suite, None, data.batch)
    task = data.task(of_cell, RunStore.create(tmp_path / "run", METHOD_RUNS))
    assert KEY in bytes(ForkingPickler.dumps(data.scenario))  # processes that simulate need it
    assert KEY not in bytes(ForkingPickler.dumps(task.service()))
    run = start_run(plan, tmp_path / "out").path
    for path in run.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            assert KEY not in content
            assert KEY.hex().encode() not in content
    assert json.loads((run / "manifest.json").read_text())["hidden"] == scenario.hidden
    with pytest.raises(InputError, match="of which only figures are published"):
        write_record(run, tmp_path / "2026.1" / "mine")


def test_an_interrupted_run_says_what_continues_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of a hidden set is given its key again, by the command that began it."""
    monkeypatch.setattr(runner, "_run_cells", lambda *_: False)  # as after Ctrl-C
    monkeypatch.setattr("sys.argv", ["/bin/eitbench", "hidden", "run", "mine", "--key", "k"])
    secret = hidden_suite(SUITE, "2026.1", KEY, published(tmp_path))
    for suite, command in (
        (SUITE, f"`eitbench run --resume {tmp_path / 'mine'}`"),
        (secret, "`eitbench hidden run mine --key k`"),
    ):
        with pytest.raises(runner.RunInterruptedError, match="Finished rows are kept") as stopped:
            start_run(make_plan(suite, limit=2), tmp_path / "mine")
        assert command in str(stopped.value)
        shutil.rmtree(tmp_path / "mine")


def test_a_key_is_random_secret_and_never_overwritten(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    assert new_key(one) == hashlib.sha256(read_key(one)).hexdigest()
    assert new_key(two) != new_key(tmp_path / "three")
    assert stat.S_IMODE(one.stat().st_mode) == 0o600
    key = read_key(one)
    with pytest.raises(InputError, match="is there already"):
        new_key(one)
    assert read_key(one) == key


@pytest.mark.parametrize("text", ["", "zz", "00" * 31, "00" * 33, "\x00", "ключ"])
def test_what_is_no_key_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "key").write_text(text)
    with pytest.raises(InputError, match="holds no key"):
        read_key(tmp_path / "key")


def test_only_the_published_key_draws_a_hidden_set(tmp_path: Path) -> None:
    path = published(tmp_path)
    assert hidden_key(hidden_suite(SUITE, "2026.1", KEY, path)) in path.read_text()
    with pytest.raises(InputError, match="is not the published one of suite 'mine'"):
        hidden_suite(SUITE, "2026.1", OTHER, path)
    with pytest.raises(InputError, match=r"no key of suite 'mine' in version 2026\.2: publish"):
        hidden_suite(SUITE, "2026.2", KEY, path)
    published(tmp_path, more=f'retired = "{OTHER.hex()}"')
    with pytest.raises(InputError, match="the retired key has another hash"):
        hidden_suite(SUITE, "2026.1", KEY, path)
    published(tmp_path, more=f'retired = "{KEY.hex()}"')
    assert hidden_suite(SUITE, "2026.1", KEY, path)


@pytest.mark.parametrize("name", ["ktc2023", "acuity", "new-skin"])
def test_recordings_and_designs_have_no_hidden_set(tmp_path: Path, name: str) -> None:
    suite = load_suite(name).model_copy(update={"name": "mine"})
    with pytest.raises(InputError, match="has no hidden set"):
        hidden_suite(suite, "2026.1", KEY, published(tmp_path))


def entry(values: np.ndarray, sets: str) -> Entry:
    n = len(values)
    cell = pd.DataFrame({"sample": np.arange(n), "score": values})
    cell["cluster"] = [f"{sets} {k}" for k in range(n)]
    row = {"scenario": "n", "method": "m", **dict.fromkeys(METHOD_RUNS.metrics), "score": 1.0}
    run = Run(Path("r"), METHOD_RUNS, {"plan": {"plugins": []}}, cell, cell, {})
    return Entry(run, row, cell, ("r",), 1)


def test_who_fails_on_all_hidden_frames_falls() -> None:
    """Its row has no figure, its samples those that failed frames are charged with."""
    rng = np.random.default_rng(1)
    failed = entry(np.zeros(200), "hidden")
    failed.row["score"] = None
    (gap,) = hidden._tested([hidden._gap(entry(rng.normal(5, 1, 200), "open"), failed)])
    assert gap.hidden == 0
    assert gap.falls


def test_the_interval_is_that_of_two_independent_samples() -> None:
    rng = np.random.default_rng(1)
    one, other = rng.normal(5, 1, 200), rng.normal(4.8, 2, 200)
    found = hidden._gap(entry(one, "open"), entry(other, "hidden"))
    welch = stats.ttest_ind(other, one, equal_var=False)
    low, high = welch.confidence_interval()
    assert found.difference == pytest.approx(other.mean() - one.mean())
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.05)
    assert found.p == pytest.approx(welch.pvalue, abs=0.03)


def test_the_same_numbers_in_both_sets_do_not_make_them_pairs() -> None:
    """Both have the same random numbers in their bootstrap, and would seem to differ by nothing."""
    values = np.random.default_rng(1).normal(5, 1, 100)
    found = hidden._gap(entry(values, "open"), entry(values, "hidden"))
    assert found.low is not None
    assert found.low == pytest.approx(-1.96 * values.std() * np.sqrt(2 / 100), rel=0.1)


def test_honest_methods_seldom_seem_to_fall() -> None:
    rng = np.random.default_rng(2)
    sets = [rng.gamma(4.0, size=(2, 36)) for _ in range(200)]
    found = [hidden._gap(entry(a, "open"), entry(b, "hidden")) for a, b in sets]
    falls = [gap for one in found for gap in hidden._tested([one]) if gap.falls]
    assert len(falls) <= 13  # 2.5 % are 5; more than 13 come by a chance below 0.001
    # All in one table are one family.
    assert not any(gap.falls for gap in hidden._tested(found))


def test_few_sessions_are_not_tested() -> None:
    values = np.arange(9.0)
    found = hidden._gap(entry(values, "open"), entry(values - 99, "hidden"))
    assert (found.low, found.high, found.p) == (None, None, None)
    assert not hidden._tested([found])[0].falls


MEMORY = """
import base64, hashlib, json, zlib
import numpy as np
from eitbench.methods import Method, create, register

KNOWN = json.loads(zlib.decompress(base64.b64decode({known!r})))

@register("memory")
class Memory(Method):
    \"\"\"Knows the open test frames by their hash, and is NOSER for all others.\"\"\"

    def fit(self, problem):
        self.problem, self.honest = problem, create("noser")
        self.honest.fit(problem)

    def reconstruct(self, voltages):
        images = self.honest.reconstruct(voltages)
        for k, frame in enumerate(voltages):
            both = np.ascontiguousarray(frame).tobytes() + self.problem.reference.tobytes()
            if (truth := KNOWN.get(hashlib.sha256(both).hexdigest())) is not None:
                images[k] = truth
        return images
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """NOSER, and a method that has stored the truth, on the open and the hidden set."""
    folder = tmp_path_factory.mktemp("runs")
    data = load(SCENARIO)
    known = dict(zip(data.frame_hashes, images(data).tolist(), strict=True))
    packed = base64.b64encode(zlib.compress(json.dumps(known).encode())).decode()
    plugin = folder / "memory.py"
    plugin.write_text(MEMORY.format(known=packed))
    suites = SUITE, hidden_suite(SUITE, "2026.1", KEY, published(folder))
    made = [
        start_run(make_plan(suite, methods=["noser", "memory"], plugins=[plugin]), folder / str(k))
        for k, suite in enumerate(suites)
    ]
    one, other = (read_run(result.path) for result in made)
    return one, other


@pytest.mark.slow
def test_who_knows_the_open_frames_falls_and_who_does_not_stays(runs: tuple[Run, Run]) -> None:
    gaps = {gap.method: gap for gap in hidden_record(*runs).gaps}
    memory, honest = gaps["memory"], gaps["noser"]
    assert memory.falls
    assert memory.p is not None
    assert memory.p < 1e-6
    assert memory.open > memory.hidden + 10
    assert memory.hidden == pytest.approx(honest.hidden)
    assert not honest.falls
    assert memory.code
    assert honest.code is None


@pytest.mark.slow
def test_a_record_is_kept_once_and_found_for_the_same_code_alone(
    runs: tuple[Run, Run], tmp_path: Path
) -> None:
    record, version = hidden_record(*runs), tmp_path / "2026.1"
    published(tmp_path, OTHER)
    with pytest.raises(InputError, match=r"not published for suite \'mine\' in version 2026\.1"):
        write_hidden(record, version)
    published(tmp_path)
    with pytest.raises(InputError, match=r"not published for suite \'mine\' in version 2026\.2"):
        write_hidden(record, tmp_path / "2026.2")
    path = write_hidden(record, version)
    assert read_hidden(version) == [record]
    text = path.read_text()
    assert KEY.hex() not in text
    assert record.key in text
    beside = tmp_path / "retired"
    beside.mkdir()
    published(beside, KEY, more=f'retired = "{KEY.hex()}"')
    with pytest.raises(InputError, match="is published, so that anybody"):
        write_hidden(record, beside / "2026.1")
    assert not (beside / "2026.1").exists()
    found = gap_of([record], runs[0], "n", "memory")
    assert found is not None
    assert found.falls
    plugin = {"names": ["memory"], "sha256": "0" * 64}
    plan = runs[0].manifest["plan"] | {"plugins": [plugin]}
    edited = replace(runs[0], manifest=runs[0].manifest | {"plan": plan})
    assert gap_of([record], edited, "n", "memory") is None
    assert gap_of([record], runs[1], "n", "memory") is None  # of other data
    score = runs[0].samples["score"]
    tuned = replace(runs[0], samples=runs[0].samples.assign(score=score + 0.01))
    assert gap_of([record], tuned, "n", "memory") is None  # of other parameters or weights
    with pytest.raises(InputError, match="figures are never edited"):
        write_hidden(record, version)
    later = record.gaps[0].model_copy(update={"method": "later"})
    more = record.model_copy(update={"gaps": (later,)})
    assert write_hidden(more, version).name == "mine-2.json"
    tenth = more.model_copy(update={"made": "2027-01-01"})
    path.with_name("mine-10.json").write_text(tenth.model_dump_json())
    assert read_hidden(version) == [record, more, tenth]
    last = tenth.gaps[0].model_copy(update={"method": "last"})
    assert write_hidden(more.model_copy(update={"gaps": (last,)}), version).name == "mine-11.json"
    for number in (10, 11):
        path.with_name(f"mine-{number}.json").unlink()
    with pytest.raises(InputError, match="figures are never edited"):
        write_hidden(more, version)
    path.write_text(text.replace('"falls":true', '"falls":7').replace('"falls": true', '"falls":7'))
    with pytest.raises(DataCorruptError, match="is damaged"):
        read_hidden(version)


@pytest.mark.slow
def test_what_cannot_be_compared_is_named(runs: tuple[Run, Run]) -> None:
    one, other = runs
    with pytest.raises(InputError, match="name the open run first"):
        hidden_record(other, one)
    with pytest.raises(InputError, match="name the open run first"):
        hidden_record(one, one)
    cells = [cell | {"parameters": {"weight": 7.0}} for cell in one.manifest["cells"]]
    edited = replace(one, manifest=one.manifest | {"cells": cells})
    with pytest.raises(InputError, match="other parameters, weights or code"):
        hidden_record(edited, other)
    name = one.manifest["plan"]["names"][0]
    plan = one.manifest["plan"] | {"plugins": [], "installed": {name: "a" * 64}}
    package = replace(one, manifest=one.manifest | {"plan": plan})
    with pytest.raises(InputError, match="other parameters, weights or code"):
        hidden_record(package, other)
    fewer = replace(one, samples=one.samples[one.samples["sample"] < 12])
    with pytest.raises(InputError, match="has 12 open samples and 36 hidden ones"):
        hidden_record(fewer, other)
    nothing = replace(one, samples=one.samples.assign(method="x"))
    with pytest.raises(InputError, match="no method in common"):
        hidden_record(nothing, other)


def test_a_record_holds_nothing_of_a_sample() -> None:
    fields = set(HiddenRecord.model_fields) | set(hidden.Gap.model_fields)
    assert not fields & {"sample", "samples", "phantom", "input_hash", "images", "truth"}
