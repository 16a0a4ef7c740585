"""Draws are kept, resumed and of the frames that they are said to be of."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.ceiling import drawing, figures, importance, record, sampler
from eitbench.benchmark.ceiling.drawing import draw_posteriors, known_of, told
from eitbench.benchmark.ceiling.figures import summary, write_record
from eitbench.benchmark.ceiling.frames import Frame
from eitbench.benchmark.ceiling.moves import PROPOSALS
from eitbench.benchmark.ceiling.sampler import Draws
from eitbench.benchmark.findings.uncertainty import read_uncertainty
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.reports.tables import ceiling
from eitbench.reports.tables.boards import note, printed_boards
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite, load_suite, scenario_by_name

OLDER = drawing.STAYS - 1
"""Version of draws that stay where their own checks find nothing."""
FAST = SimulatedScenario(
    name="few", image_shape=(24, 24), families=("circle",),
    noise=SplitNoise(test=25.0), train=0, validation=2, test=30,
)  # fmt: skip


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampler, "PARTICLES", 6)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"noise": {"test": 0}}, "0.0: the ceiling needs frames that all have one SNR, above 0"),
        ({"noise": {"test": 120}}, "120.0: the ceiling needs .* up to 80 dB"),
        ({"noise": {"test": "mixture"}}, "'mixture': the ceiling needs frames"),
        ({"families": ("tank-1",)}, "not known for family .tank-1."),
        ({"families": ("object-rectangle",)}, "the same for both sides of a rectangle"),
        (
            {"imperfections": {"gain": 0.01}},
            "has the imperfection 'gain', which the ceiling is not told",
        ),
        ({"imperfections": {"mesh": "slab"}}, "has a slab, which the ceiling is not told"),
        ({"calibrated": True}, "has calibration, which"),
    ],
)
def test_what_the_sampler_does_not_know_is_refused(changes: dict[str, object], why: str) -> None:
    declared = FAST.model_dump(mode="json") | {"image_shape": None} | changes
    with pytest.raises(InputError, match=why):
        told(SimulatedScenario.model_validate(declared))


def test_recorded_frames_have_no_ceiling() -> None:
    (scenario,) = (s for s in load_suite("sim2real").scenarios if s.name == "ohmc16")
    with pytest.raises(InputError, match="is recorded: the ceiling is of simulated touches"):
        told(scenario)


def test_clean_frames_are_those_of_70_db() -> None:
    clean = FAST.model_dump(mode="json") | {"name": "few-clean", "noise": {"test": "clean"}}
    found = told(SimulatedScenario.model_validate(clean))
    assert (found.name, found.noise.test) == ("few-clean-at-70db", 70)
    assert found.phantom_stream == "few-clean"
    assert told(FAST) is FAST


@pytest.mark.slow
def test_runs_whose_frames_are_gone_leave_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    level = scenario_by_name("noise-30db")
    runs = [{"command": str(version), "sampler": {"version": version}} for version in (0, 2)]
    monkeypatch.setattr(figures, "recorded_runs", lambda suite: runs)
    kept = write_record(tmp_path / "draws", "noise", [level], 2, tmp_path, record=True)
    assert set(kept["version"]) == {2}
    about = json.loads((tmp_path / "noise.json").read_text())
    assert [made["command"] for made in about["earlier"]] == ["2"]


def test_boards_say_where_draws_are_too_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    columns = ["psnr", "ssim", "cc", "rie", "localisation_mm"]
    board = [{"scenario": "n", "data_hash": "h", "data_n": 200, "method": "noser"}]
    # Of 200 frames, 14 outside of 95 % intervals are no more than chance may do; 22 are.
    for out, says in ((22, "intervals hold 89% (84% to 93%) of the true"), (14, ""), (0, "")):
        ranks = np.where(np.arange(200) < out, 0.99, 0.5)
        frames = pd.DataFrame(
            dict.fromkeys(columns, 1.0)
            | {"rank_x": ranks, "sample": range(200), "cluster": range(200)}
        )
        monkeypatch.setattr(ceiling, "recorded_frames", lambda *of, frames=frames: frames)
        (note_of,) = ceiling.ceiling_notes(board)
        assert ("too sure" in note_of, says in note_of) == (bool(says), True)


def test_frames_of_the_record_are_not_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are known by their data and numbers: bits of frames depend on the processor."""
    level = scenario_by_name("sim2real-noise")
    known = record.recorded_frames("sim2real-noise", level.data_hash("test"))
    monkeypatch.setattr(drawing, "kept", lambda recorded: recorded["version"] > 0)
    draw_posteriors([level], tmp_path / "draws", 2, record=True)
    assert not (tmp_path / "draws").exists()
    kept = write_record(tmp_path / "draws", "sim2real", [level], 2, tmp_path, record=True)
    assert_frame_equal(kept.set_index(kept["sample"].to_numpy()), known.iloc[:2])
    about = json.loads((tmp_path / "sim2real.json").read_text())
    assert "--samples 2 --record " in about["command"]
    shipped = json.loads((record.RECORDS / "sim2real.json").read_text())
    runs = [*shipped["earlier"], shipped]
    versions = {*kept["version"]}
    assert [made["command"] for made in about["earlier"]] == [
        made["command"] for made in runs if made["sampler"]["version"] in versions
    ]


def test_recorded_frames_stay_where_their_own_checks_find_nothing() -> None:
    frames = pd.DataFrame(
        [
            {"version": OLDER, "effective": 0.31, "rhat": 1.01, "rank_x": 0.01, "rank_y": 0.99},
            {"version": OLDER, "effective": 0.31, "rhat": 1.06, "rank_x": 0.50, "rank_y": 0.50},
            {"version": OLDER, "effective": 0.29, "rhat": 1.01, "rank_x": 0.50, "rank_y": 0.50},
            {"version": OLDER, "effective": 0.31, "rhat": 1.01, "rank_x": 0.50, "rank_y": 1.00},
            {"version": OLDER, "effective": 0.31, "rhat": 1.01, "rank_x": 0.00, "rank_y": 0.50},
            {"version": drawing.STAYS, "effective": 0.01, "rhat": 9.0, "rank_x": 0.0},
            {"version": drawing.VERSION, "effective": 0.01, "rhat": 9.0, "rank_x": 1.0},
        ]
    )
    assert drawing.kept(frames).tolist() == [True, False, False, False, False, True, True]


@pytest.mark.slow
def test_frames_by_an_older_sampler_are_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that were not yet, stay in the record; so do those that it gave the same draws."""
    scenario = FAST.model_copy(update={"test": 4})
    older = write_older_record(scenario, tmp_path, monkeypatch)
    assert (older["effective"] >= sampler.CORRECTED).all()
    try:
        monkeypatch.setattr(drawing, "KEPT_RHAT", np.inf)
        draw_posteriors([scenario], tmp_path / "none", 2, record=True)
        assert not (tmp_path / "none").exists()
        monkeypatch.setattr(drawing, "KEPT_RHAT", 1.0)
        draw_posteriors([scenario], tmp_path / "new", 2, record=True)
        assert len(list((tmp_path / "new" / "few").iterdir())) == 2
        frames = write_record(
            tmp_path / "new", "own", [scenario], 4, tmp_path / "later", record=True
        )
        assert frames["version"].tolist() == [drawing.VERSION] * 2 + [OLDER] * 2
        assert frames["sample"].tolist() == [0, 1, 2, 3]
        np.testing.assert_allclose(frames["mse"][2:], older["mse"][2:], rtol=1e-5)
        about = json.loads((tmp_path / "later" / "own.json").read_text())
        versions = [run["sampler"]["version"] for run in [about, *about["earlier"]]]
        assert versions == [drawing.VERSION, OLDER]
    finally:
        record._stored.cache_clear()


def write_older_record(
    scenario: SimulatedScenario, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> pd.DataFrame:
    """Make the product's record one of `scenario`, by a sampler of an earlier version."""
    monkeypatch.setattr(sampler, "PARTICLES", 6)
    now = drawing.VERSION
    for module in (drawing, figures):
        monkeypatch.setattr(module, "VERSION", OLDER)
    draw_posteriors([scenario], folder / "old", scenario.test)
    frames = write_record(folder / "old", "own", [scenario], scenario.test, folder / "records")
    for module in (drawing, figures):
        monkeypatch.setattr(module, "VERSION", now)
    monkeypatch.setattr(record, "RECORDS", folder / "records")
    record._stored.cache_clear()
    return frames


@pytest.mark.parametrize("suite", ["noise", "shapes"])
def test_the_error_of_the_mean_image_is_that_of_both_samplers(suite: str) -> None:
    """((a + b) / 2)^2 of their errors a and b, of which the record has squares and product."""
    frames = pd.read_csv(record.RECORDS / f"{suite}.csv")
    for row in summary(frames).to_dict("records"):
        of = frames[frames["scenario"] == row["scenario"]]
        error = (2 * of["mse"] + of["mse_walk"] + of["mse_differences"]) / 4
        assert row["image_psnr"] == pytest.approx(-10 * np.log10(error.mean()), abs=1e-4)


def test_what_cannot_be_told_is_sorted_out() -> None:
    slab = FAST.model_dump(mode="json") | {"name": "slab", "imperfections": {"mesh": "slab"}}
    other = SimulatedScenario.model_validate(slab | {"image_shape": None})
    known, (why,) = known_of([FAST, other])
    assert known == [FAST]
    assert "'slab' has a slab" in str(why)


def test_a_record_says_which_sampler_drew_each_frame() -> None:
    for path in record.RECORDS.glob("*.json"):
        about = json.loads(path.read_text())
        runs = [*about["earlier"], about]
        drew = {run["sampler"]["version"]: run["sampler"] for run in runs}
        assert {*pd.read_csv(path.with_suffix(".csv"))["version"]} <= drew.keys()
        assert max(drew) <= drawing.VERSION
        if (now := drew.get(drawing.VERSION)) is not None:
            of_now = (sampler.PARTICLES, sampler.LIBRARY, drawing.SEEDS)
            assert (now["particles_per_term"], now["library"], now["seeds"]) == of_now


def record_of(scenario: SimulatedScenario, folder: Path) -> pd.DataFrame:
    """The record of the first frames, in `folder / "records"`, drawn in two runs."""
    draws = folder / "draws"
    draw_posteriors([scenario], draws, 2)
    first = (draws / "few" / "00001.safetensors").read_bytes()
    draw_posteriors([scenario], draws, 60)
    assert (draws / "few" / "00001.safetensors").read_bytes() == first
    assert len(list((draws / "few").iterdir())) == scenario.test
    return write_record(draws, "own", [scenario], scenario.test, folder / "records")


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_a_stopped_run_goes_on(tmp_path: Path) -> None:
    frames = record_of(FAST.model_copy(update={"test": 6}), tmp_path)
    assert len(frames) == 6


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(("kept_rhat", "runs"), [(1.0, drawing.RUNS), (100.0, 1)])
def test_samplers_that_disagree_run_again(
    kept_rhat: float, runs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    merging = []

    def counted(found: Sequence[Draws]) -> Draws:
        merging.append(len(found))
        return sampler.merged(found)

    monkeypatch.setattr(drawing, "KEPT_RHAT", kept_rhat)
    monkeypatch.setattr(drawing, "merged", counted)
    draw_posteriors([FAST], tmp_path, 1)
    assert merging == [k for k in range(1, runs + 1) for _ in PROPOSALS]
    (sample,) = load(FAST, "test", 1).frame_hashes
    found = drawing.draws_of(tmp_path, FAST.name, 0, sample)
    assert found is not None
    assert found.surpassed <= drawing.SURPASSED
    for draws in found.draws.values():
        assert draws.effective > sampler.CORRECTED
        assert len(draws.weights) >= runs * sampler.CHECKED
        assert draws.weights.sum() == pytest.approx(1, rel=1e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(("most", "runs"), [(np.inf, 1), (-np.inf, 2)])
def test_where_samplers_lost_the_true_phantom_more_is_drawn_about_it(
    most: float, runs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    merging: list[Sequence[Draws]] = []

    def spied(found: Sequence[Draws]) -> Draws:
        merging.append(list(found))
        return sampler.merged(found)

    for name, value in (("KEPT_RHAT", np.inf), ("SURPASSED", most), ("RUNS", 2), ("merged", spied)):
        monkeypatch.setattr(drawing, name, value)
    draw_posteriors([FAST], tmp_path, 1)
    assert [len(found) for found in merging] == [k for k in range(1, runs + 1) for _ in PROPOSALS]
    for about in (found[1] for found in merging[len(PROPOSALS) :]):
        # Of the same posterior, found in another way, or of a part of it.
        assert -1.2 < about.log_evidence - merging[0][0].log_evidence < 0.2
        assert len(about.weights) > importance.POPULATION / 2
    data = load(FAST, "test", 1)
    found = drawing.draws_of(tmp_path, FAST.name, 0, data.frame_hashes[0])
    assert found is not None
    # The true phantom explains its frame as well as the noise lets it.
    model = FAST.data_model("test", 0)
    assert isinstance(model, ForwardModel)
    exact = model.voltages(rasterise(data.phantoms[0], model.sensor))
    count, snr_db = len(exact), float(data.samples["snr_db"][0])
    deviation = np.sqrt(10 ** (-snr_db / 10) * np.mean(exact**2))
    missing = np.sum((data.voltages[0] - exact) ** 2)
    true = -count * np.log(deviation) - missing / (2 * deviation**2)
    best = min(of.log_likelihoods.max() for of in found.draws.values())
    assert found.surpassed == pytest.approx(true - best, abs=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_a_sampler_that_alone_lost_the_true_phantom_draws_about_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the other one found does not hide it."""
    right, drew = sampler.Sampler.draws, list[str]()

    def draws(self: sampler.Sampler, frame: Frame, rng: np.random.Generator) -> Draws:
        found = right(self, frame, rng)
        drew.append(self.proposals)
        if self.proposals == "walk":
            lost = found.log_likelihoods - 90.0, found.log_evidence - 90.0
            found = found._replace(log_likelihoods=lost[0], log_evidence=lost[1])
        return found

    def counted(*args: Any) -> Draws:
        drew.append("about")
        return importance.draws_about(*args)

    monkeypatch.setattr(sampler.Sampler, "draws", draws)
    monkeypatch.setattr(drawing, "draws_about", counted)
    monkeypatch.setattr(drawing, "KEPT_RHAT", np.inf)
    draw_posteriors([FAST], tmp_path, 1)
    assert drew == [*PROPOSALS, *("about" if k == "walk" else k for k in PROPOSALS)]
    (sample,) = load(FAST, "test", 1).frame_hashes
    found = drawing.draws_of(tmp_path, FAST.name, 0, sample)
    assert found is not None
    assert found.surpassed <= drawing.SURPASSED
    evidence = [float(draws.log_evidence) for draws in found.draws.values()]
    assert evidence == pytest.approx([evidence[0]] * len(PROPOSALS), abs=1.2)


@pytest.mark.nightly
@pytest.mark.usefixtures("few_draws")
def test_the_draws_are_as_good_as_they_say_and_the_board_has_the_ceiling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = record_of(FAST, tmp_path)
    (row,) = summary(frames).to_dict("records")
    # The mean is as good as the posterior says, and better than each frame's noise would allow.
    assert row["psnr_of_mse"] == pytest.approx(row["expected_psnr"], abs=2.5)
    assert abs(row["apart_db"]) < 1
    # So is what its draws say of pixels and places; 30 frames tell a share to about 10 %.
    for level in (50, 80, 95):
        assert frames[f"coverage_{level}"].mean() == pytest.approx(level / 100, abs=0.12)
        assert frames[f"place_coverage_{level}"].mean() == pytest.approx(level / 100, abs=0.25)

    monkeypatch.setattr(record, "RECORDS", tmp_path / "records")
    record._stored.cache_clear()
    try:
        suite = Suite(name="own", title="Own", methods=("noser",), scenarios=(FAST,))
        run = start_run(make_plan(suite), tmp_path / "run").path
        rows = leaderboard_rows([read_run(run)])
        assert rows[0]["below_ceiling_db_low"] > 0
        error = np.mean(10 ** (-read_run(run).samples["psnr"] / 10))
        expected = 10 * np.log10(error / frames["mse"].mean())
        assert rows[0]["below_ceiling_db"] == pytest.approx(expected, abs=0.01)
        (board,) = printed_boards(rows)
        ranks = {of["method"]: of["rank"] for of in board.rows}
        assert ranks == {"noser": 1, "ceiling": None}
        assert board.rows[1]["psnr"] == pytest.approx(frames["psnr"].mean(), abs=0.01)
        assert "told the families" in note(rows)
        best, other = read_uncertainty(read_run(run))
        assert (best.method, other.method) == ("ceiling", "noser")
        assert best.figures["crps"].value < 0.5 * other.figures["crps"].value
    finally:
        record._stored.cache_clear()


@pytest.mark.slow
@pytest.mark.usefixtures("few_draws")
def test_draws_of_other_frames_are_not_taken(tmp_path: Path) -> None:
    draw_posteriors([FAST], tmp_path, 3)
    other = FAST.model_copy(update={"phantoms": "others"})
    with pytest.raises(InputError, match="draws of another frame"):
        draw_posteriors([other], tmp_path, 3)
    (tmp_path / "few" / "00000.safetensors").write_bytes(b"damaged")
    draw_posteriors([FAST], tmp_path, 3)
    assert (tmp_path / "few" / "00000.safetensors").stat().st_size > 1000


def test_without_draws_there_is_no_record(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no draws"):
        write_record(tmp_path, "own", [FAST], 3, tmp_path)
