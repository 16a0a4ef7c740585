"""A run as it is passes; whatever is edited in it is found."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.run import method_cell
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.rundir.run_arrays import rounded_images
from eitbench.benchmark.submissions import rerun as rerun_module
from eitbench.benchmark.submissions import run_checks
from eitbench.benchmark.submissions.check import CHECKS, check_submission
from eitbench.benchmark.submissions.figure_checks import curves_follow, failures_are_reported
from eitbench.benchmark.submissions.rerun import (
    ROUNDING,
    _away,
    _other_statement,
    digest,
    drawn_batches,
    note_reproduced,
    reproduced,
    rerun,
)
from eitbench.benchmark.submissions.run_checks import left_out
from eitbench.benchmark.submissions.submission import Submission, open_submission
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.reports.tables.leaderboard import ranked_rows, write_leaderboard
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.scenario import RecordedScenario, Split
from eitbench.scenarios.suites.suite import Suite


@pytest.fixture(scope="module", autouse=True)
def installed() -> Iterator[None]:
    """Two methods as an installed package offers them; those of eitbench cannot be submitted."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
        for name in ("noser", "tikhonov"):
            METHOD_REGISTRY.register(f"my-{name}")(type("Mine", (METHOD_REGISTRY.known()[name],), {
                "__module__": __name__
            }))  # fmt: skip
        yield


@pytest.fixture(scope="module")
def submitted(tmp_path_factory: pytest.TempPathFactory, tiny: Suite) -> Path:
    out = tmp_path_factory.mktemp("runs") / "mine"
    with pytest.MonkeyPatch.context() as patch:
        # The checkout that is tested may be changed.
        patch.setattr("eitbench.benchmark.rundir.manifest.git_commit", lambda: "a" * 40)
        run = start_run(make_plan(tiny, methods=["my-noser", "my-tikhonov"]), out).path
    write_leaderboard(ranked_rows([run]), run)
    return run


@pytest.fixture(autouse=True)
def packaged(monkeypatch: pytest.MonkeyPatch, tiny: Suite) -> None:
    # The checkout that is tested may be changed.
    monkeypatch.setattr("eitbench.benchmark.rundir.manifest.git_commit", lambda: "a" * 40)
    monkeypatch.setattr(run_checks, "suites", lambda: {"tiny": None})
    monkeypatch.setattr(run_checks, "load_suite", lambda name: tiny)


def test_an_honest_run_passes(submitted: Path) -> None:
    checks = check_submission(open_submission(submitted))
    assert [check.name for check in checks] == list(CHECKS)
    assert [check.problem for check in checks] == [""] * len(CHECKS)


def test_a_method_is_left_out_on_all_scenarios_of_a_sensor_or_on_none() -> None:
    sensors = {"a": "foam16", "b": "foam16", "c": "ohmc16"}
    assert left_out(["c/net"], sensors, "net") == ["c"]
    assert left_out(["c/other", "ohmc16/net"], sensors, "net") == []
    assert left_out(["a/net", "b/net"], sensors, "net") == ["a", "b"]
    assert left_out(["a/net"], sensors, "net") == []  # it ran on this sensor
    assert left_out(["a/net", "b/net", "c/net"], sensors, "net") == []  # and somewhere


def test_parameters_are_its_authors_own_whether_the_package_is_here_or_not(
    submitted: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(submitted, tmp_path / "run")
    edit_json(lambda m: m["cells"][0].update(parameters={"weight": 3.0}, weights="0"))(run)
    assert {check.problem for check in check_submission(open_submission(run))} == {""}


def test_the_package_of_a_method_need_not_be_installed_here(
    submitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shutil.copytree(submitted, tmp_path / "run")
    monkeypatch.delitem(METHOD_REGISTRY._registered, "my-noser")
    assert "my-noser" not in METHOD_REGISTRY.known()
    assert {check.problem for check in check_submission(open_submission(run))} == {""}
    problems = [check.problem for check in rerun(open_submission(run), 1)]
    assert problems == [
        "The package that 'my-noser' comes from is not installed here: install it.",
        "",
    ]


Edit = Callable[[Path], object]


def edit_samples(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Edit:
    def edit(run: Path) -> None:
        change(pd.read_parquet(run / "samples.parquet")).to_parquet(run / "samples.parquet")

    return edit


def set_in_a_row(name: str, value: object) -> Edit:
    return edit_samples(lambda t: t.assign(**{name: t[name].where(t.index != 2, value)}))


def edit_json(change: Callable[[Any], object], name: str = "manifest.json") -> Edit:
    def edit(run: Path) -> None:
        content = json.loads((run / name).read_text())
        change(content)
        (run / name).write_text(json.dumps(content))

    return edit


def copy_image(source: str, target: str) -> Edit:
    def edit(run: Path) -> None:
        with h5py.File(run / "reconstructions.h5", "a") as file:
            file[f"tiny/{target}/conductivity"][1] = file[f"tiny/{source}/conductivity"][1]

    return edit


def drop_a_method(run: Path) -> None:
    edit_samples(lambda table: table[table["method"] != "my-noser"])(run)
    edit_json(lambda m: m.update(cells=[c for c in m["cells"] if c["name"] != "my-noser"]))(run)


def on_another_processor(run: Path) -> None:
    """Its frames have other last bits."""
    edit_json(lambda m: m["machine"].update(cpu="another"))(run)
    edit_samples(lambda table: table.assign(input_hash="0"))(run)


def add_a_figure(run: Path) -> None:
    """Figures of methods come from their samples alone: this changes nothing."""
    table = pd.read_parquet(run / "methods.parquet")
    table.assign(score=99.0, repeatability_db=99.0).to_parquet(run / "methods.parquet")
    row = ranked_rows([run])[0]
    assert row["score"] < 10
    assert row["repeatability_db"] is None


SUITE = "the suite is one of eitbench's"
ROWS = "every sample of every method has its row"
FRAMES = "frames, truth and geometry are ours"
FIGURES = "figures are those of the stored images"
FAILURES = "failures are reported"
CURVES = "curves of stated uncertainty follow from its figures"
WHOLE = "stated uncertainty and novelty are of all frames"
BOARD = "the leaderboard follows from the figures"
TRACKS = "tracks are ranked"
RELEASE = "it names its version of eitbench"
NAMES = "names are clear"
FOLDER = "the directory holds what a run writes"
PLAUSIBLE = "figures are plausible"
CONTENT = "tables and images hold what a run writes"
MEASURED = "times and memory are possible"
REGISTRATIONS = "registrations and load calibrations are those of the stored images"
EMPTY = hashlib.sha256(b"").hexdigest()
A_PLUGIN = {"path": "/a.py", "sha256": EMPTY, "names": ["noser"], "sources": [""]}


def problem(run: Path, name: str) -> str:
    """What is found by one of the checks."""
    found = {check.name: check.problem for check in check_submission(open_submission(run))}
    return found[name]


def set_attribute(name: str, value: object) -> Edit:
    def edit(run: Path) -> None:
        with h5py.File(run / "reconstructions.h5", "a") as file:
            file["tiny/truth"].attrs[name] = value

    return edit


def blank_the_mask(run: Path) -> None:
    """Failed images, which are NaN inside the sensor, had no pixel left that tells of it."""
    with h5py.File(run / "reconstructions.h5", "a") as file:
        file["tiny/truth/mask"][:] = False


def skip_a_method(run: Path) -> None:
    drop_a_method(run)
    edit_json(lambda m: m["skipped"].update({"tiny/my-noser": "no time"}))(run)


def set_in_cells(name: str, value: str | float) -> Edit:
    def edit(run: Path) -> None:
        table = pd.read_parquet(run / "methods.parquet")
        table[name] = value
        table.to_parquet(run / "methods.parquet")

    return edit


def set_in_curves(change: Callable[[dict[str, Any]], object]) -> Edit:
    def edit(run: Path) -> None:
        table = pd.read_parquet(run / "methods.parquet")
        curves = json.loads(table["uncertainty"][0])
        change(curves)
        table.loc[0, "uncertainty"] = json.dumps(curves)
        table.to_parquet(run / "methods.parquet")

    return edit


def add_to_arrays(name: str, change: Callable[[h5py.File], object]) -> Any:
    """A foreign part of the file of arrays, and what the check says of it."""

    def edit(run: Path) -> None:
        with h5py.File(run / "reconstructions.h5", "a") as file:
            change(file)

    return pytest.param(
        edit, CONTENT, f"reconstructions.h5 holds {name!r}, which no run writes", id=name
    )


def with_an_index(table: pd.DataFrame) -> pd.DataFrame:
    """Pandas hides the column that it keeps an index in."""
    return table.set_axis([f"text {k}" for k in table.index])


def hide_in_a_table(run: Path) -> None:
    table = pa.Table.from_pandas(pd.read_parquet(run / "samples.parquet"), preserve_index=False)
    hidden = table.replace_schema_metadata({**table.schema.metadata, b"more": b"x" * 1000})
    pq.write_table(hidden, run / "samples.parquet")


def another_name(name: str) -> Edit:
    return edit_json(lambda m: m["plan"]["names"].append(name))


def add_a_plugin_called_noser(run: Path) -> None:
    edit_json(lambda m: m["plan"].update(names=["my-noser", "noser"], plugins=[A_PLUGIN]))(run)
    (run / "plugins").mkdir()
    (run / "plugins" / f"{EMPTY[:16]}.py").touch()


def copy_the_truth(run: Path, method: str = "my-noser") -> None:
    """Images that no method made, with the figures that they really have."""
    with h5py.File(run / "reconstructions.h5", "a") as file:
        file[f"tiny/{method}/conductivity"][:] = file["tiny/truth/conductivity"][:]
    rescore(run)
    write_leaderboard(ranked_rows([run]), run)


@pytest.mark.parametrize(
    ("edit", "failed", "words"),
    [
        (
            set_in_a_row("psnr", 60.0),
            FIGURES,
            "1 of 5 samples of 'my-noser' on 'tiny' have other figures",
        ),
        (hide_in_a_table, CONTENT, "samples.parquet holds 'more', which no run writes"),
        (edit_json(lambda m: m.update(more="x")), CONTENT, "The manifest holds 'more'"),
        (edit_json(lambda m: m["cells"][0].update(more=1)), CONTENT, "A cell of the manifest"),
        (
            edit_json(lambda rows: rows[0].update(score_x=99), "leaderboard.json"),
            BOARD,
            "holds 'score_x' 99, which no run writes",
        ),
        (
            edit_json(
                lambda rows: rows[0].update(tier="hidden, no fall found"), "leaderboard.json"
            ),
            BOARD,
            "holds 'tier' 'hidden, no fall found', which no run writes",
        ),
        (
            edit_json(lambda rows: rows[0].update(why_not="x"), "leaderboard.json"),
            BOARD,
            "the why_not of",
        ),
        (
            edit_json(lambda m: m["machine"].update(more="x")),
            CONTENT,
            "The machine of the manifest holds 'more', which no run writes",
        ),
        (set_in_a_row("crps", -10.0), CURVES, "has values that cannot be"),
        (set_in_a_row("coverage_95", 1.5), CURVES, "has values that cannot be"),
        (set_in_a_row("error_over_spread", np.inf), CURVES, "has values that cannot be"),
        (set_in_a_row("crps", np.inf), WHOLE, "no finite CRPS of 'my-noser'"),
        (set_in_a_row("crps", np.nan), WHOLE, "no finite CRPS of 'my-noser'"),
        (set_in_a_row("sharpness", np.nan), WHOLE, "no finite Sharpness of 'my-noser'"),
        (set_in_curves(lambda c: c["ranks"].insert(0, c["ranks"].pop())), CURVES, "do not follow"),
        (set_in_curves(lambda c: c["sparsified"].reverse()), CURVES, "do not follow"),
        (set_in_cells("uncertainty", ""), CURVES, "are missing"),
        (set_in_a_row("input_hash", "0"), FRAMES, "'my-noser' was given other frames of 'tiny'"),
        (on_another_processor, FRAMES, ""),
        (
            set_in_a_row("phantom", "another"),
            FRAMES,
            "The column 'phantom' of 'my-noser' on 'tiny'",
        ),
        (
            edit_samples(lambda table: table.drop(index=3)),
            ROWS,
            "'my-noser' on 'tiny' should have one row for each sample, 0 to 4",
        ),
        # An image as good as the truth, without the figures of one.
        (
            copy_image("truth", "my-noser"),
            FIGURES,
            "other figures than their stored images give: ssim",
        ),
        (copy_image("my-noser", "truth"), FRAMES, "The truth that is stored of 'tiny' is not ours"),
        (
            edit_json(
                lambda rows: rows[1].update(score=rows[1]["score"] + 0.001), "leaderboard.json"
            ),
            BOARD,
            "In leaderboard.json the score of",
        ),
        (
            lambda run: (run / "recordings.json").write_text('{"tiny": {"guess_mm": 99}}'),
            "notes on recordings are ours",
            "says something of 'tiny', which is no recorded scenario",
        ),
        (lambda run: (run / "leaderboard.json").unlink(), BOARD, "leaderboard.json is missing"),
        (
            lambda run: (run / "reconstructions.h5").unlink(),
            FIGURES,
            "is missing: run the suite again",
        ),
        (edit_json(lambda m: m.update(status="interrupted")), ROWS, "The run is interrupted"),
        (edit_json(lambda m: m["plan"].update(limit=3)), ROWS, "limited to 3 samples"),
        (edit_json(lambda m: m["data"]["tiny"].update(hash="0")), FRAMES, "The data of 'tiny' are"),
        (
            edit_json(lambda m: m["plan"]["suite"]["scenarios"][0].update(test=4)),
            SUITE,
            "is not that of this version",
        ),
        (
            edit_json(lambda m: m["cells"][0].pop("variant")),
            ROWS,
            "lacks an entry that every run writes ('variant')",
        ),
        (drop_a_method, ROWS, "'my-noser' was not run on 'tiny'"),
        (set_in_a_row("status", "error"), FAILURES, "does not say which of its images are whole"),
        (set_in_a_row("message", "looks fine"), FAILURES, "are not those of its failed samples"),
        (set_in_cells("n", 1), FAILURES, "counts other samples of"),
        (set_in_cells("coverage", 0.5), FAILURES, "counts other samples of"),
        (add_a_figure, BOARD, ""),
        # What was accepted once, see CHANGELOG.
        (set_attribute("background", 0.5), FRAMES, "another 'background' than ours"),
        (set_attribute("data_range", 9.0), FRAMES, "another 'data_range' than ours"),
        (set_attribute("bounds", [0.0, 0.0, 9.0, 9.0]), FRAMES, "another 'bounds' than ours"),
        (blank_the_mask, FRAMES, "is damaged: run the suite again"),
        (skip_a_method, ROWS, "'my-noser' was not run on 'tiny'"),
        (set_in_cells("track", "oracle"), TRACKS, "The track of 'my-noser'"),
        (edit_samples(lambda t: t.assign(suite="paper")), TRACKS, "of another suite"),
        (
            edit_json(lambda m: m["versions"].update(eitbench="999.0.0")),
            RELEASE,
            "Eitbench 999.0.0 made it",
        ),
        (edit_json(lambda m: m["versions"].update(eitbench="best")), RELEASE, "is no version"),
        (edit_json(lambda m: m.update(git_commit="ab-dirty")), RELEASE, "changed code"),
        (
            edit_json(
                lambda m: (m.update(git_commit=None), m["versions"].update(eitbench="0.0.1"))
            ),
            RELEASE,
            "nobody can tell here whether that was ever released",
        ),
        (edit_json(lambda m: m["versions"].update(eitbench="0.0.1")), RELEASE, ""),
        (edit_json(lambda m: m.update(git_commit=None)), RELEASE, ""),
        (another_name("n0ser"), NAMES, "'n0ser' looks like 'noser'"),
        (another_name("kernel-ridge"), NAMES, "'kernel-ridge' is what eitbench calls something"),
        (another_name("Jacob1an"), NAMES, "'Jacob1an' looks like 'jacobian'"),
        (another_name("ceiling"), NAMES, "'ceiling' cannot name a method"),
        (another_name("n\u043eser"), NAMES, "is not ASCII"),
        (another_name("noser"), NAMES, "'noser' is a method of eitbench"),
        (another_name("theirs"), ROWS, "'theirs' was not run on 'tiny'"),
        (another_name("a/b"), NAMES, "cannot name a method"),
        (edit_json(lambda m: m["plan"]["names"].pop()), ROWS, "but not in the plan"),
        (
            add_a_plugin_called_noser,
            NAMES,
            "'noser' is a method of eitbench",
        ),
        (lambda run: (run / "run.sh").write_text("date"), FOLDER, "holds 'run.sh'"),
        (
            lambda run: shutil.copy(run / "samples.parquet", run / "tracks.parquet"),
            FOLDER,
            "without --tracks",
        ),
        (
            edit_json(lambda m: m["data"]["tiny"].update(n=1000)),
            ROWS,
            "tells other numbers of samples",
        ),
        (
            edit_json(lambda m: m["data"].update(more={**next(iter(m["data"].values())), "n": 3})),
            ROWS,
            "tells other numbers of samples",
        ),
        (edit_json(lambda m: m["cells"][1].update(variant="x")), ROWS, "cells of other tracks"),
        (copy_the_truth, PLAUSIBLE, "better than frames allow"),
        (
            edit_samples(lambda t: t.assign(junk=1.0)),
            CONTENT,
            "samples.parquet has a column 'junk', which no run writes",
        ),
        (edit_samples(with_an_index), CONTENT, "has a column '__index_level_0__'"),
        (set_in_cells("junk", "a"), CONTENT, "methods.parquet has a column 'junk'"),
        add_to_arrays("junk", lambda file: file.create_dataset("junk", data=[0.0])),
        add_to_arrays("tiny/junk", lambda file: file.create_group("tiny/junk")),
        add_to_arrays(
            "tiny/my-noser/validation",
            lambda file: file.create_dataset("tiny/my-noser/validation", data=[0.0]),
        ),
        add_to_arrays(
            "tiny/link", lambda file: file["tiny"].update(link=h5py.SoftLink("/tiny/truth"))
        ),
        add_to_arrays("@junk", lambda file: file.attrs.update(junk="a")),
        add_to_arrays("tiny/truth/@junk", lambda file: file["tiny/truth"].attrs.update(junk="a")),
        add_to_arrays(
            "tiny/my-noser/conductivity/@junk",
            lambda file: file["tiny/my-noser/conductivity"].attrs.update(junk="a"),
        ),
        (set_in_cells("frame_ms_p50", -3.0), MEASURED, "The column 'frame_ms_p50' holds -3"),
        (set_in_cells("frame_ms_p95", 1e300), MEASURED, "The column 'frame_ms_p95' holds 1e+300"),
        (set_in_cells("load", -1.0), MEASURED, "The column 'load' holds -1"),
        (set_in_cells("memory_mb", -5.0), MEASURED, "The column 'memory_mb' holds -5"),
        (set_in_cells("cpu_mhz", float("inf")), MEASURED, "The column 'cpu_mhz' holds inf"),
        (set_in_cells("train_s", float("nan")), MEASURED, ""),
        (set_in_a_row("frame_ms", float("inf")), MEASURED, "The column 'frame_ms' holds inf"),
        (set_in_a_row("frame_ms", -0.1), MEASURED, "The column 'frame_ms' holds -0.1"),
    ],
)
def test_what_was_edited_is_found(
    submitted: Path, tmp_path: Path, edit: Edit, failed: str, words: str
) -> None:
    run = shutil.copytree(submitted, tmp_path / "mine")
    edit(run)
    assert words in problem(run, failed)


def test_pixels_outside_of_the_sensor_hold_the_background() -> None:
    """No figure looks at them."""
    mask = np.hypot(*np.mgrid[-4:5, -4:5]) < 4
    images = np.where(mask, 0.2, np.full((2, 9, 9), 0.4)).astype(np.float32)
    rows = {"scenario": "a", "method": "m", "sample": [0, 1], "status": ["ok", "error"]}
    rows["message"] = ["", "it failed"]
    images[1] = np.nan
    cells = pd.DataFrame([{"scenario": "a", "method": "m", "n": 2, "coverage": 0.5}])
    run = SimpleNamespace(samples=pd.DataFrame(rows), estimates=lambda *_: images, cells=cells)
    sensor = SimpleNamespace(mask=mask, background=0.4)
    data = {"a": SimpleNamespace(test=SimpleNamespace(sensor=sensor))}
    submission = cast("Submission", SimpleNamespace(run=run, data=data))
    assert failures_are_reported(submission) == ""
    images[0, 0, 0] = 0.41
    assert "hold more than the background outside" in failures_are_reported(submission)


def test_a_name_is_of_one_code_among_the_submissions_of_a_version(
    submitted: Path, tmp_path: Path
) -> None:
    """A package is known by the address that its author states, a plugin by its digest."""

    def placed(name: str, code: str, version: str = "2026.9") -> Path:
        path = tmp_path / version / "submissions" / "tiny" / name
        shutil.copytree(submitted, path)
        (path / "submission.json").write_text(json.dumps({"code": f"https://example.org/{code}"}))
        return path

    def clear(path: Path) -> str:
        return run_checks.names_are_clear(open_submission(path))

    first, second = placed("first", "mine"), placed("second", "mine")
    assert clear(second) == ""
    assert clear(placed("other-version", "other", "2026.8")) == ""
    other = placed("third", "other")
    assert "tiny/first has 'my-noser', which is not the code of 'my-noser'" in clear(other)
    (first / "submission.json").write_text("{")
    (second / "submission.json").write_text("{")
    assert clear(other) == ""  # damaged ones are in nobody's way
    plugin = {**A_PLUGIN, "names": ["my-noser"]}
    edit_json(lambda m: m["plan"].update(plugins=[plugin]))(placed("fourth", "other"))
    assert "tiny/fourth has 'my-noser'" in clear(other)


def test_another_version_of_numpy_may_round_otherwise(submitted: Path, tmp_path: Path) -> None:
    """It gives frames other last bits, so that their hashes tell nothing."""
    run = shutil.copytree(submitted, tmp_path / "mine")
    set_in_a_row("input_hash", "0")(run)
    edit_samples(lambda t: t.assign(x_m=t["x_m"] * (1 + 1e-12)))(run)
    assert problem(run, FRAMES)
    edit_json(lambda m: m["versions"].update(numpy="1.99.0"))(run)
    assert problem(run, FRAMES) == ""
    edit_samples(lambda t: t.assign(x_m=t["x_m"] + 0.1))(run)
    assert "'x_m'" in problem(run, FRAMES)


def test_suites_of_ones_own_and_operators_are_no_submissions(
    submitted: Path, build_operators: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_checks, "suites", lambda: {})
    assert "is not one of eitbench's" in problem(submitted, SUITE)
    with pytest.raises(InputError, match="operators"):
        open_submission(build_operators({"fem": 0.1}))


METHOD = """
import numpy as np
from eitbench import Method, register
@register("mine")
class Mine(Method):
    def fit(self, problem):
        self.sensor = problem.sensor
    def reconstruct(self, voltages):
        shade = 1 + 0.1 * np.tanh(voltages.mean(axis=1))[:, None, None]
        return np.broadcast_to(shade, (len(voltages), *self.sensor.image_shape)) + 0.0
"""


@pytest.fixture
def with_plugin(tiny: Suite, tmp_path: Path) -> Path:
    """A run of a plugin whose file is gone, as on the machine of who checks it."""
    plugin = tmp_path / "mine.py"
    plugin.write_text(METHOD)
    plan = make_plan(tiny, methods=["noser", "mine"], plugins=[plugin])
    run = start_run(plan, tmp_path / "runs" / "mine").path
    write_leaderboard(ranked_rows([run]), run)
    plugin.unlink()
    return run


@pytest.mark.parametrize(("size", "n"), [(36, 32), (36, 4), (64, 33), (5, 2), (200, 1000)])
def test_no_fewer_samples_are_drawn_than_are_asked_for(size: int, n: int) -> None:
    """In batches of which the last is short, whichever are drawn."""
    for _ in range(50):
        drawn = drawn_batches(size, 32, n)
        samples = [k for batch in drawn for k in range(batch.start, batch.stop)]
        assert samples == sorted(set(samples))
        assert min(n, size) <= len(samples) < min(n, size) + 32
        assert all(of.start % 32 == 0 and of.stop == min(of.start + 32, size) for of in drawn)


def test_fewer_samples_do_not_replace_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    submission = SimpleNamespace(
        run=SimpleNamespace(path=tmp_path / "run"),
        data={"n": SimpleNamespace(test=range(90)), "m": SimpleNamespace(test=range(40))},
    )
    monkeypatch.setattr("eitbench.benchmark.submissions.rerun.digest", str)
    told = []
    for n in (31, 64, 32, 1000):
        note_reproduced(cast("Submission", submission), n)
        told += [*reproduced(tmp_path).values()] or [""]
    assert told == ["", "64 of 90 samples", "64 of 90 samples", "90 of 90 samples"]


@pytest.mark.slow
def test_methods_are_run_again_plugins_from_the_directory(with_plugin: Path) -> None:
    submission = open_submission(with_plugin)
    checks = rerun(submission, 2)
    assert [check.problem for check in checks] == ["", ""]
    assert "'mine'" in checks[1].name

    assert note_reproduced(submission, 2) is None
    assert reproduced(with_plugin.parent) == {}
    noted = note_reproduced(submission, 5)
    assert noted == with_plugin.parent / "reproduced.json"
    assert reproduced(with_plugin.parent) == {digest(with_plugin): "5 of 5 samples"}
    # Another content is not what was verified.
    table = pd.read_parquet(with_plugin / "methods.parquet")
    table.assign(memory_mb=1.0).to_parquet(with_plugin / "methods.parquet")
    assert digest(with_plugin) not in reproduced(with_plugin.parent)


@pytest.mark.slow
def test_all_samples_can_be_run_again_and_those_of_a_part_are_drawn(
    with_plugin: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first ones alone would leave the rest to whoever edits it."""
    assert [check.problem for check in rerun(open_submission(with_plugin), 1000)] == ["", ""]
    with h5py.File(with_plugin / "reconstructions.h5", "a") as file:
        file["tiny/noser/conductivity"][4] = file["tiny/truth/conductivity"][4]
    monkeypatch.setattr(method_cell.MethodData, "batch", 1)
    drawing = Random(0)
    monkeypatch.setattr(rerun_module, "SystemRandom", lambda: drawing)
    found = [rerun(open_submission(with_plugin), 2)[0].problem for _ in range(8)]
    assert any("1 of 2 images differ" in text for text in found)
    assert not all(found)


@pytest.mark.slow
def test_frames_are_also_drawn_one_by_one(
    with_plugin: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole batches are neighbours: forged ones elsewhere would be missed."""
    with h5py.File(with_plugin / "reconstructions.h5", "a") as file:
        file["tiny/noser/conductivity"][4] = file["tiny/truth/conductivity"][4]
    drawn = rerun_module.drawn_batches

    def first_ones(size: int, batch: int, n: int) -> list[slice]:
        return drawn(size, batch, n) if batch == 1 else [slice(0, 3)]

    monkeypatch.setattr(rerun_module, "drawn_batches", first_ones)
    (found, other) = rerun(open_submission(with_plugin), 5)
    assert "1 of 5 images are others where each frame is asked for alone" in found.problem
    assert found.refutes
    assert other.problem == ""


def test_frames_are_drawn_from_the_whole_split_and_batches_are_whole() -> None:
    singles = [drawn_batches(600, 1, 32) for _ in range(50)]
    assert all(len({of.start for of in drawn}) == 32 for drawn in singles)
    spread = [np.ptp([of.start for of in drawn]) for drawn in singles]
    assert min(spread) > 200
    assert drawn_batches(70, 32, 1000) == [slice(0, 32), slice(32, 64), slice(64, 70)]


@pytest.mark.slow
def test_images_that_no_method_made_are_found(with_plugin: Path) -> None:
    copy_the_truth(with_plugin, "noser")
    found = rerun(open_submission(with_plugin), 2)
    assert "5 of 5 images differ from those that it makes here" in found[0].problem
    assert found[0].refutes
    assert (found[1].problem, found[1].refutes) == ("", False)


@pytest.mark.slow
@pytest.mark.parametrize("fails", ["all", "some"])
def test_a_method_that_fails_here_refutes_nothing_by_that(
    with_plugin: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    """If images of other samples differ, they do."""
    copy_the_truth(with_plugin, "noser")
    made = rerun_module._made

    def failing(*of: Any) -> Any:
        row, stored, figures = made(*of)
        stored["test"].message[slice(None) if fails == "all" else slice(1)] = "out of memory"
        return row, stored, figures

    monkeypatch.setattr(rerun_module, "_made", failing)
    (found, _) = rerun(open_submission(with_plugin), 5)
    assert ("(out of memory)" in found.problem, found.refutes) == (fails == "all", fails == "some")
    assert "5 of 5 images differ" in found.problem


@pytest.mark.parametrize("exact", [True, False])
def test_stated_figures_are_compared_frame_by_frame(exact: bool) -> None:
    """Scores that are the means of batches have the right mean, and tell novel frames perfectly."""
    rng = np.random.default_rng(0)
    ours = pd.DataFrame({"novelty": rng.gamma(4.0, size=64), "crps": rng.gamma(9.0, size=64)})
    assert _other_statement(ours.copy(), ours, exact=exact) == ""
    batches = ours["novelty"].groupby(np.arange(64) // 32).transform("mean")
    assert _other_statement(ours.assign(novelty=batches), ours, exact=exact) == "'novelty'"
    better = ours.assign(crps=0.97 * ours["crps"])
    assert _other_statement(better, ours, exact=exact) == "'crps'"  # in all frames, and its mean
    some = ours.assign(crps=ours["crps"].where(np.arange(64) % 8 > 0, 0.97 * ours["crps"]))
    assert _other_statement(some, ours, exact=exact) == ("'crps'" if exact else "")
    few = ours.assign(crps=ours["crps"].where(np.arange(64) > 1, -10.0))  # not more than may
    assert _other_statement(few, ours, exact=exact) == "'crps'"
    elsewhere = ours.assign(novelty=ours["novelty"] * rng.uniform(0.97, 1.03, 64))
    assert _other_statement(elsewhere, ours, exact=False) == ""


def test_a_frame_without_a_figure_hides_no_advantage_of_the_others() -> None:
    """As the place of an untouched frame, which nobody has."""
    rng = np.random.default_rng(0)
    ours = pd.DataFrame({"crps": np.where(np.arange(32) > 0, rng.gamma(9.0, size=32), np.nan)})
    assert _other_statement(ours.copy(), ours, exact=False) == ""
    assert _other_statement(0.96 * ours, ours, exact=False) == "'crps'"
    known = ours.assign(crps=ours["crps"].fillna(1.0))
    assert _other_statement(known, ours, exact=True) == "'crps'"


def test_scores_of_any_sign_may_be_rounded_otherwise() -> None:
    rng = np.random.default_rng(0)
    ours = pd.DataFrame({"novelty": rng.normal(size=64)})
    ours.loc[0, "novelty"] = 1e-5
    rounded = ours + 1e-3 * rng.normal(size=(64, 1))
    assert _other_statement(rounded, ours, exact=False) == ""
    assert _other_statement(ours + 0.05, ours, exact=False) == "'novelty'"


@pytest.mark.parametrize("contrast", [4e-4, 0.02, 0.5])
@pytest.mark.parametrize("share", [0.0, ROUNDING])
def test_images_are_compared_on_their_own_scale(contrast: float, share: float) -> None:
    """A place does not depend on the contrast: a blob elsewhere is found however weak it is."""
    background = 0.7
    y, x = np.mgrid[:40, :40]
    here, there = (np.exp(-((x - c) ** 2 + (y - 20) ** 2) / 20.0) for c in (10, 30))
    ours, invented = (
        (background * (1 - contrast * blob[None])).astype(np.float32) for blob in (here, there)
    )
    for rounded in (False, True):
        stored = (rounded_images(of, background)[0] if rounded else of for of in (ours, invented))
        same, other = (_away(of, ours, background, share, rounded=rounded) for of in stored)
        assert not same.any()
        assert other.all()
    nearly = np.nextafter(ours, np.float32(np.inf))  # the last bit, as of another processor
    assert _away(nearly, ours, background, share, rounded=False).all() == (share == 0)


@pytest.mark.slow
def test_an_uncertainty_that_no_method_stated_is_found(with_plugin: Path) -> None:
    table = pd.read_parquet(with_plugin / "samples.parquet")
    noser = table["method"] == "noser"
    table.assign(crps=table["crps"].where(~noser, 1e-4)).to_parquet(with_plugin / "samples.parquet")
    problems = [check.problem for check in rerun(open_submission(with_plugin), 5)]
    assert "Its 'crps' of 5 samples is not what it states here" in problems[0]
    assert problems[1] == ""
    table.assign(coverage_95=table["coverage_95"].where(noser, 0.95)).to_parquet(
        with_plugin / "samples.parquet"
    )
    problems = [check.problem for check in rerun(open_submission(with_plugin), 5)]
    assert problems[0] == ""
    assert "Its 'coverage_95' of 5 samples" in problems[1]


@pytest.mark.slow
def test_a_score_without_the_curves_that_runs_write_beside_it_is_found(with_plugin: Path) -> None:
    table = pd.read_parquet(with_plugin / "samples.parquet")
    stated = dict.fromkeys(("crps", "sharpness", "ause"), 1e-4)
    silent = table["method"] == "noser"
    stated |= {name: np.nan for name in map(str, table) if "coverage_" in name}
    for name, value in stated.items():
        table[name] = table[name].where(~silent, value)
    table.to_parquet(with_plugin / "samples.parquet")
    cells = pd.read_parquet(with_plugin / "methods.parquet")
    cells["uncertainty"] = cells["uncertainty"].where(cells["method"] != "noser", "")
    cells.to_parquet(with_plugin / "methods.parquet")
    said = curves_follow(open_submission(with_plugin))
    assert said == "The curves of what 'noser' states on 'tiny' are missing."


@pytest.mark.slow
def test_another_plugin_is_not_run(with_plugin: Path) -> None:
    (copy,) = (with_plugin / "plugins").iterdir()
    copy.write_text(METHOD.replace("0.1", "0.2"))
    found = rerun(open_submission(with_plugin), 2)
    assert "lacks a copy of the method's plugin" in found[1].problem
    (with_plugin / "plugins" / "more.py").write_text("")
    assert "'more.py'" in problem(with_plugin, FOLDER)


@pytest.mark.slow
def test_a_registration_is_fitted_again(
    tiny: Suite, data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of scale 1e-9 put every contact at the mean press; an affine one was taken, too."""

    def presses(scenario: object, split: Split = "test", **kwargs: object) -> Dataset:
        frames = data.samples[["sample", "cluster", "x_m", "y_m"]].copy()
        return replace(
            data, scenario="skin", split=split, samples=frames, truth="position", phantoms=()
        )

    monkeypatch.setattr(method_cell, "load", presses)
    monkeypatch.setattr(method_cell, "fetch_recording", lambda *args, **kwargs: tmp_path)
    skin = RecordedScenario(name="skin", recording="ohmc16")
    suite = tiny.model_copy(update={"scenarios": (skin,)})
    monkeypatch.setattr(run_checks, "load_suite", lambda name: suite)
    run = start_run(make_plan(suite, methods=["my-noser"]), tmp_path / "run").path
    assert problem(run, REGISTRATIONS) == ""
    cells = pd.read_parquet(run / "methods.parquet")
    scale, turn, shift = json.loads(cells["registration"][0])
    for changed, words in (
        ([1e-9, turn, shift], "does not follow from its images"),
        ([scale, [[1, 0], [0, 5]], shift], "similarity"),
        ([-scale, turn, shift], "similarity"),
        ([10**400, turn, shift], "similarity"),
    ):
        cells.assign(registration=json.dumps(changed)).to_parquet(run / "methods.parquet")
        assert words in problem(run, REGISTRATIONS)
    cells.assign(registration="[" * 100_000).to_parquet(run / "methods.parquet")
    assert "similarity" in problem(run, REGISTRATIONS)
    # Without measured loads nothing is calibrated: a line to huge loads would make errors small.
    cells.assign(load_calibration='["pressure_pa", 0, 0, 1e9]').to_parquet(run / "methods.parquet")
    assert "The load calibration of 'my-noser' on 'skin' does not follow" in problem(
        run, REGISTRATIONS
    )
