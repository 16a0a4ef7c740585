"""The tracks beside the ranked one: what is run, what is kept, and the gaps between them."""

import json
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.reports import report_data

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.standings import track_gaps
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.run.progress import RunProgress
from eitbench.benchmark.run.runner import start_run
from eitbench.benchmark.rundir.plan import make_plan, read_parameters
from eitbench.benchmark.tuning.selection import Selection, Trial, TuningBudget, record
from eitbench.reports.tables.boards import tracks_table
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.storage.files import sha256_of
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import Suite, load_suite

PLUGIN = Path(__file__).parents[1] / "data" / "tuned_methods.py"
(SMALL,) = load_suite(Path(__file__).parents[1] / "data" / "small.toml").scenarios
assert isinstance(SMALL, SimulatedScenario)
SUITE = Suite(name="mine", title="Mine", methods=("noser",), scenarios=(SMALL,))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A choice that is not the best on the test split: 0.9, where 1.0 was tried as well."""
    folder = tmp_path_factory.mktemp("tracks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EITBENCH_CACHE", str(folder / "cache"))
        trials = (
            Trial({"factor": 1.4}, 1.0),
            Trial({"factor": 0.9}, 3.0),
            Trial({"factor": 1.0}, None, "pruned"),
            Trial({"factor": 0.5}, None, "failed"),
        )
        code = sha256_of(PLUGIN)
        choice = Selection({"factor": 0.9}, 3.0, trials, TuningBudget(), "space", code=code)
        record(SMALL, {"constant": choice}, folder / "cache" / "selected")
        tracks = ("default", "tuned", "oracle")
        plan = make_plan(SUITE, methods=["constant"], plugins=[PLUGIN], tracks=tracks)
        return start_run(plan, folder / "run").path


def score(factor: float) -> float:
    data = load(SMALL, split="test")
    return float(evaluate(data, np.full((4, 16, 16), factor))["score"].mean())


@pytest.mark.slow
def test_a_choice_of_another_version_of_a_plugin_is_not_used_and_said(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(run.parent / "cache"))
    changed = tmp_path / "tuned_methods.py"
    changed.write_text(PLUGIN.read_text() + "# changed\n")
    plan = make_plan(SUITE, methods=["constant"], plugins=[changed])
    found = read_run(start_run(plan, tmp_path / "run", progress=RunProgress()).path)
    assert set(found.samples["track"]) == {"default"}
    assert found.samples["score"].mean() == pytest.approx(score(1.4))
    assert (
        "The hyper-parameters of 'constant' that were selected on small belong to another version "
        "of its file, so its defaults are used: tune it again."
    ) in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_of_a_tuned_row_makes_it_again(run: Path, tmp_path: Path) -> None:
    """Without the choice, which lies in the cache of its author."""
    (board,) = report_data([run])["boards"]
    (row,) = board["views"][0]["rows"]
    words = shlex.split(row["command"])
    given = words[words.index("--parameters") + 1]
    assert read_parameters(given) == {"constant": {"factor": 0.9}}
    file = tmp_path / "given.json"
    file.write_text(given)
    plan = make_plan(
        SUITE, methods=["constant"], plugins=[PLUGIN], parameters=read_parameters(str(file))
    )
    again = read_run(start_run(plan, tmp_path / "run").path)
    first = read_run(run)
    assert set(again.samples["track"]) == {"given"}
    measured = ["track", "frame_ms"]
    pd.testing.assert_frame_equal(
        again.samples.drop(columns=measured), first.samples.drop(columns=measured)
    )
    assert again.cells["parameters"].tolist() == first.cells["parameters"].tolist()
    (again_board,) = report_data([again.path])["boards"]
    assert again_board["views"][0]["rows"][0]["command"] == row["command"]
    # Its defaults, when they are given, are no selected parameters either.
    plan = make_plan(SUITE, methods=["constant"], plugins=[PLUGIN], parameters={"constant": {}})
    (bare_board,) = report_data([start_run(plan, tmp_path / "bare").path])["boards"]
    words = shlex.split(bare_board["views"][0]["rows"][0]["command"])
    assert words[words.index("--parameters") + 1] == '{"constant": {}}'


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nowhere.json", "'nowhere.json': No such file"),
        ("{", "it is not JSON of this form"),
        ('{"noser": 3}', "it is not JSON of this form"),
        ('{"noser": {"weight": NaN}}', "it is not JSON of this form"),
        ('{"noser": {"weight": 1e999}}', "it is not JSON of this form"),
        ('{"noser": {}, "tv": {}, "noser": {}}', "name 'noser' more than once"),
        ('{"noser": {"weight": 1, "weight": 2}}', "name 'weight' more than once"),
    ],
)
def test_parameters_that_are_none_are_refused(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read_parameters(text)


def test_parameters_are_of_methods_that_are_run_and_take_them() -> None:
    with pytest.raises(InputError, match="Unknown method in the parameters: 'nosr'"):
        make_plan(SUITE, parameters={"nosr": {}})
    with pytest.raises(InputError, match=r"'constant' cannot be made with \{'faktor': 1\}"):
        make_plan(SUITE, plugins=[PLUGIN], parameters={"constant": {"faktor": 1}})
    with pytest.raises(InputError, match="its parameters are weight, "):
        make_plan(SUITE, parameters={"noser": {"wait": 1}})
    with pytest.raises(InputError, match="takes the weights of 'dnn' that are installed"):
        make_plan(SUITE, methods=["dnn"], parameters={"dnn": {"weights": "own.safetensors"}})


@pytest.mark.slow
def test_the_ranked_track_is_as_without_the_others(run: Path) -> None:
    found = read_run(run)
    assert set(found.samples["track"]) == {"tuned"}
    assert len(found.samples) == 4
    assert len(found.cells) == 1
    assert found.samples["score"].mean() == pytest.approx(score(0.9))


@pytest.mark.slow
def test_the_oracle_is_the_best_on_test_of_what_was_tried(run: Path) -> None:
    """Pruned trials are tried again; those that failed are not."""
    tracks = read_run(run).tracks
    parameters = {t: json.loads(r["parameters"].iloc[0]) for t, r in tracks.groupby("track")}
    assert parameters == {"default": {}, "oracle": {"factor": 1.0}}
    means = tracks.groupby("track")["score"].mean()
    assert means["default"] == pytest.approx(score(1.4))
    assert means["oracle"] == pytest.approx(score(1.0))
    cells = json.loads((run / "manifest.json").read_text())["cells"]
    assert cells[0]["spent"]["edges"] == []
    assert [c["variant"] for c in cells] == ["", "default", "trial-00", "trial-01"]


def test_the_gaps_stand_on_every_leaderboard(run: Path) -> None:
    (row,) = ranked_rows([run])
    assert row["tuning_gain"] == pytest.approx(score(0.9) - score(1.4))
    assert row["oracle_gap"] == pytest.approx(score(1.0) - score(0.9))
    assert row["oracle_gap_low"] is row["oracle_gap_high"] is None  # of two sessions
    assert row["overlap"] == 0
    assert row["prior_knowledge"] == "learned the noise level from tuning; tuned with 4 trials"
    heads, cells = tracks_table([row])
    assert heads[1:4] == ["default", "tuned", "oracle"]
    assert cells[2] == f"{score(0.9):.3f}"
    assert cells[-1] == f"{score(1.0) - score(0.9):.3f}"
    for form in ("md", "html"):
        text = FORMATS[form]([row])
        assert "left to the oracle" in text
        assert "learned the noise level from tuning" in text


def test_no_images_of_other_tracks_are_kept(run: Path) -> None:
    found = read_run(run)
    assert not (run / "parts").exists()
    images = found.estimates("small", "constant", [0])
    assert images is not None
    np.testing.assert_allclose(images, 0.9, rtol=1e-6)


def test_gaps_are_paired_and_larger_is_better() -> None:
    rng = np.random.default_rng(1)
    frames = 40
    shared = rng.normal(50, 20, size=frames)

    def cell(track: str, shift: float) -> pd.DataFrame:
        values = shared + shift + rng.normal(0, 0.01, frames)
        clusters = [f"p{k}" for k in range(frames)]
        columns = {"sample": range(frames), "cluster": clusters, "localisation_mm": values}
        return pd.DataFrame({"track": track, **columns})

    others = pd.concat([cell("default", 3.0), cell("oracle", -1.0)])
    found = track_gaps(others, cell("tuned", 0.0), "tuned", "localisation_mm")
    # Errors: what is smaller is gained. Medians of paired values differ as these do.
    assert found["tuning_gain"] == pytest.approx(3.0, abs=0.05)
    assert found["oracle_gap"] == pytest.approx(1.0, abs=0.05)
    assert 2.9 < found["tuning_gain_low"] < found["tuning_gain_high"] < 3.1
    # A user's own parameters are none of these tracks.
    assert track_gaps(others, cell("given", 0.0), "given", "localisation_mm").keys() == {
        "default_figure", "oracle_figure",
    }  # fmt: skip


def test_a_method_without_a_choice_has_one_track() -> None:
    scores = pd.DataFrame({"sample": [0, 1], "cluster": ["a", "b"], "score": [1.0, 3.0]})
    found = track_gaps(pd.DataFrame({"track": []}), scores, "default", "score")
    assert found == {"default_figure": 2.0}


@pytest.mark.slow
def test_the_tuned_track_stands_beside_parameters_of_a_users_own(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(run.parent / "cache"))
    plan = make_plan(
        SUITE,
        methods=["constant"],
        plugins=[PLUGIN],
        parameters={"constant": {"factor": 1.1}},
        tracks=("default", "tuned", "oracle"),
    )
    (row,) = ranked_rows([start_run(plan, tmp_path / "run").path])
    assert (row["track"], row["score"]) == ("given", pytest.approx(score(1.1)))
    assert row["default_figure"] == pytest.approx(score(1.4))
    assert row["tuned_figure"] == pytest.approx(score(0.9))
    assert row["oracle_figure"] == pytest.approx(score(1.0))
    assert row["tuning_gain"] == pytest.approx(score(0.9) - score(1.4))


def test_an_unknown_track_is_refused_and_operators_have_none() -> None:
    with pytest.raises(InputError, match="Unknown track 'orcale': did you mean 'oracle'"):
        make_plan(SUITE, tracks=["orcale"])
    with pytest.raises(InputError, match="operators, which have no tracks"):
        make_plan(load_suite("operators"), tracks=["oracle"])
