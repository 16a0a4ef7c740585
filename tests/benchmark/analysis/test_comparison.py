"""Comparisons of runs whose changes are known, because they were made."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.support.made_runs import edited_manifest, write_manifest

from eitbench.benchmark.analysis.comparison import (
    Change,
    Results,
    compare,
    figure_called,
    read_results,
)
from eitbench.scenarios.errors import DataCorruptError, InputError

Array = NDArray[np.float64]
N = 60


def results(
    scores: Mapping[str, Array], name: str = "run", frames: str = "", clusters: int = N
) -> Results:
    cells = [
        pd.DataFrame(
            {
                "scenario": "one", "method": method, "sample": np.arange(len(values)),
                "cluster": [f"p{k % clusters}" for k in range(len(values))], "status": "ok",
                "input_hash": [f"{frames}{k}" for k in range(len(values))],
                "score": values, "rie": 1 - 0.1 * values,
            }
        )
        for method, values in scores.items()
    ]  # fmt: skip
    return Results(Path(name), pd.concat(cells, ignore_index=True), {}, {})


def before_and_after(n: int = N) -> tuple[Results, Results]:
    rng = np.random.default_rng(0)
    old = {name: rng.normal(5, 1, size=n) for name in ("same", "noisy", "better", "worse")}
    new = {
        "same": old["same"],
        "noisy": old["noisy"] + 0.1 * rng.normal(size=n),
        "better": old["better"] + 0.1 + 0.1 * rng.normal(size=n),
        "worse": old["worse"] - 0.1 + 0.1 * rng.normal(size=n),
    }
    return results(old, "old"), results(new, "new")


def by_method(changes: list[Change]) -> dict[str, Change]:
    return {change.method: change for change in changes}


def test_what_changed_is_told_from_chance() -> None:
    found = compare(*before_and_after())
    changes = by_method(found.changes)
    assert {name: change.verdict for name, change in changes.items()} == {
        "same": "equal", "noisy": "no difference found", "better": "better", "worse": "worse",
    }  # fmt: skip
    # The spread of phantoms, 1, is ten times the change: only paired differences can tell.
    worse = changes["worse"]
    assert worse.low is not None
    assert worse.high is not None
    assert worse.low < worse.difference < worse.high < 0
    assert worse.after - worse.before == pytest.approx(worse.difference)
    assert (worse.figure, worse.n, worse.clusters) == ("score", N, N)
    assert found.missing == found.added == []


def test_less_is_better_where_the_card_says_so() -> None:
    changes = by_method(compare(*before_and_after(), {"rie": 0.0}).changes)
    assert changes["better"].difference < 0
    assert changes["better"].verdict == "better"
    assert changes["worse"].verdict == "worse"


def test_a_gate_lets_through_what_the_margin_allows() -> None:
    old, new = before_and_after()
    verdicts = [
        by_method(compare(old, new, margins).changes)["worse"].verdict
        for margins in ({}, {"score": 0.02}, {"score": 0.1}, {"score": 0.3})
    ]
    assert verdicts == ["worse", "worse", "within the margin", "within the margin"]


@pytest.mark.parametrize("figure", ["score", "localisation_mm"])
def test_a_margin_changes_no_p_value(figure: str) -> None:
    """So that a gate and a comparison of the same runs tell the same."""
    old, new = before_and_after()
    for of in (old, new):
        of.samples["localisation_mm"] = 10 - of.samples["score"]
    compared = compare(old, new, {figure: 0.0}).changes
    gated = compare(old, new, {figure: 0.05}).changes
    assert [change.p for change in gated] == [change.p for change in compared]
    # A loss of 0.1 exceeds a margin of 0.05 less surely than none.
    without, beyond = (by_method(of)["worse"].p_margin or 0.0 for of in (compared, gated))
    assert without == by_method(compared)["worse"].p
    assert without < beyond < 0.05


def test_gains_of_others_excuse_no_loss_without_a_margin() -> None:
    rng = np.random.default_rng(0)
    old = {f"m{k}": rng.normal(5, 1, size=N) for k in range(10)}
    new = {name: values + 0.5 + 0.1 * rng.normal(size=N) for name, values in old.items()}
    # A loss that only just shows: as one of ten tests of a margin it would not.
    new["m0"] = old["m0"] - 0.02 + 0.1 * rng.normal(size=N)
    changes = by_method(compare(results(old), results(new), {"score": 0.0}).changes)
    lost = changes.pop("m0")
    assert lost.p is not None
    assert 0.005 < lost.p < 0.05
    assert lost.p_margin == lost.p
    assert lost.verdict == "worse"
    assert {change.verdict for change in changes.values()} == {"better"}


def test_few_sessions_show_plain_differences() -> None:
    found = compare(*before_and_after(9))
    assert {change.verdict for change in found.changes} == {"equal", "too few to test"}
    for name, change in by_method(found.changes).items():
        assert (change.low, change.high, change.p, change.p_margin) == (None,) * 4
        assert change.difference == pytest.approx(change.after - change.before)
        assert (change.verdict == "equal") == (name == "same")
    # The mean of a single session says nothing about its samples.
    values = np.arange(4.0)
    swapped = compare(results({"m": values}, clusters=1), results({"m": values[::-1]}, clusters=1))
    assert swapped.changes[0].verdict == "too few to test"


def test_a_figure_that_some_draws_lack_is_not_tested() -> None:
    """All untouched frames are of one session here."""
    runs = []
    for seed in range(2):
        run = results({"m": np.zeros(N)}, clusters=12)
        touched = run.samples["cluster"] != "p0"
        response = np.random.default_rng(seed).normal(1, 0.1, N) * np.where(touched, 100, 1)
        samples = run.samples.drop(columns=["score", "rie"])
        runs.append(replace(run, samples=samples.assign(touched=touched, response=response)))
    old, new = runs
    (change,) = compare(old, new).changes
    assert (change.figure, change.verdict) == ("repeatability_db", "too few to test")
    assert (change.low, change.high, change.p) == (None,) * 3
    assert change.difference != 0


def test_stated_uncertainty_is_compared_where_it_is_asked_for() -> None:
    """By CRPS, of which less is better; more coverage is neither better nor worse."""
    old, new = before_and_after()
    parts = [
        Results(of.path, of.samples.assign(crps=-0.01 * of.samples["score"]), {}, {})
        for of in (old, new)
    ]
    found = by_method(compare(parts[0], parts[1], {"CRPS": 0.0}).changes)
    assert {change.figure for change in found.values()} == {"crps"}
    assert found["better"].verdict == "better"
    assert found["worse"].verdict == "worse"
    for name in ("coverage_95", "edge"):
        with pytest.raises(InputError, match=name):
            figure_called(name)


@pytest.mark.parametrize("name", ["psnr", "PSNR", "PSNR [dB]"])
def test_figures_are_called_as_in_tables(name: str) -> None:
    assert figure_called(name) == "psnr"


def test_what_rounding_changes_is_negligible_however_sure() -> None:
    values = np.random.default_rng(4).normal(5, 1, size=N)
    old, new = results({"m": values}), results({"m": values - 1e-6})
    assert (compare(old, new).changes[0].p or 0.0) < 1e-6
    assert compare(old, new).changes[0].verdict == "negligible"


def test_a_median_that_hides_what_became_worse_is_not_negligible() -> None:
    before = np.random.default_rng(0).uniform(1, 20, 40)
    for count in (15, 3):
        after = before.copy()
        after[np.argsort(before)[-count:]] += 200
        old, new = results({"m": np.full(40, np.nan)}), results({"m": np.full(40, np.nan)})
        old.samples["localisation_mm"], new.samples["localisation_mm"] = before, after
        (change,) = compare(old, new).changes
        assert (change.figure, change.difference) == ("localisation_mm", 0)
        assert change.verdict == "no difference found"


@pytest.mark.slow
def test_a_gate_is_seldom_shut_by_chance() -> None:
    rng = np.random.default_rng(1)
    shut = 0
    for _ in range(40):
        old = {f"m{k}": rng.normal(size=30) for k in range(4)}
        new = {name: values + rng.normal(size=30) for name, values in old.items()}
        found = compare(results(old), results(new))
        shut += any(change.verdict == "worse" for change in found.changes)
    assert shut <= 4  # 1 is expected; more than 4 happen in 3 of 1000 such tests


def test_repeats_of_a_phantom_do_not_count_as_many() -> None:
    rng = np.random.default_rng(2)
    old = {"m": rng.normal(size=600)}
    new = {"m": old["m"] + np.tile(rng.normal(0.3, 1, size=12), 50)}
    many = compare(results(old, clusters=600), results(new, clusters=600)).changes[0]
    few = compare(results(old, clusters=12), results(new, clusters=12)).changes[0]
    assert many.difference == pytest.approx(few.difference)
    assert (many.p or 0.0) < 1e-6 < 0.05 < (few.p or 0.0)


def test_what_cannot_be_compared_is_said() -> None:
    rng = np.random.default_rng(3)
    one = {name: rng.normal(size=N) for name in ("a", "b")}
    found = compare(results(one, "old"), results({"b": one["b"], "c": one["a"]}, "new"))
    assert found.missing == ["'a' on 'one' is only in old."]
    assert found.added == ["'c' on 'one' is only in new."]
    with pytest.raises(InputError, match="'a', 'b' on 'one' were given other frames"):
        compare(results(one, "old"), results(one, "new", frames="other-"))
    with pytest.raises(InputError, match="did you mean 'score'"):
        compare(results(one), results(one), {"scroe": 0.1})
    unknown = results(one)
    unknown.samples["ssim"] = np.nan
    with pytest.raises(InputError, match="SSIM"):
        compare(unknown, unknown, {"ssim": 0.0})
    # A figure that the baseline has not is nothing that could be lost.
    assert [c.figure for c in compare(unknown, unknown, {"ssim": 0.1, "rie": 0.1}).changes] == [
        "rie", "rie",
    ]  # fmt: skip


def test_what_several_methods_lack_is_one_sentence() -> None:
    old, new = before_and_after()
    rows = new.samples[new.samples["sample"] >= 20]
    found = compare(old, Results(new.path, rows, {}, {}), {"score": 9.0})
    (sentence,) = found.missing
    assert " on 'one' lack 20 of the 60 frames of old in new: the others are" in sentence
    assert all(repr(method) in sentence for method in old.samples["method"].unique())


def test_a_figure_that_vanished_is_missed() -> None:
    """As a repeatability of a method that fails on every frame; nothing else ranks its cell."""
    old, new = before_and_after()
    lost = new.samples["method"] == "same"
    rows = new.samples.assign(score=new.samples["score"].mask(lost))
    found = compare(old, Results(new.path, rows, {}, {}), {})
    assert found.missing == ["'same' on 'one' has no S in new."]
    assert "same" not in by_method(found.changes)


def test_frames_that_are_gone_are_missed() -> None:
    old, new = before_and_after()
    rows = new.samples[(new.samples["method"] != "same") | (new.samples["sample"] >= 20)]
    found = compare(old, Results(new.path, rows, {}, {}), {"score": 9.0})
    assert found.missing == [
        "'same' on 'one' lacks 20 of the 60 frames of old in new: the others are compared."
    ]
    assert by_method(found.changes)["same"].n == 40


def written(
    folder: Path, calibration_ms: float, machine: str = "this", timed: str = "pinned"
) -> Path:
    folder.mkdir()
    before_and_after()[0].samples.to_parquet(folder / "samples.parquet")
    times = {"frame_ms_p50": [6.0], "calibration_ms": [calibration_ms]}
    conditions = {"machine": [machine], "timed": [timed]}
    cells = pd.DataFrame({"scenario": ["one"], "method": ["same"], **times, **conditions})
    cells.to_parquet(folder / "methods.parquet")
    return folder


def test_times_are_compared_in_units_of_the_calibration_solve(tmp_path: Path) -> None:
    slow, fast = written(tmp_path / "slow", 60.0, "slow"), written(tmp_path / "fast", 20.0, "fast")
    compared = compare(read_results(slow), read_results(fast))
    found = by_method(compared.changes)
    # The same 6 ms cost three times as much of a machine that is three times as fast.
    assert found["same"].time_ratio == pytest.approx(3)
    assert not found["same"].shared
    assert found["noisy"].time_ratio is None
    assert compared.busy == []
    alone = read_results(slow / "samples.parquet")
    assert len(alone.samples) == len(read_results(slow).samples)


def test_times_of_a_busy_machine_are_not_compared(tmp_path: Path) -> None:
    """The same code and processor: what was slower was the machine, not the method."""
    calm, busy = written(tmp_path / "calm", 20.0), written(tmp_path / "busy", 26.0)
    compared = compare(read_results(calm), read_results(busy))
    assert by_method(compared.changes)["same"].time_ratio is None
    (sentence,) = compared.busy
    assert "1.30 times as long" in sentence
    assert str(tmp_path / "busy") in sentence
    write_manifest(tmp_path / "busy", "bench", {}, [])
    with edited_manifest(tmp_path / "busy") as manifest:
        manifest |= {"machine": {"cpu": "this"}, "calibration_ms": 20.0}
    # The fastest solve that is known of the machine counts, whichever run tells it.
    assert compare(read_results(busy), read_results(busy)).busy == compared.busy


def test_times_beside_other_cells_are_marked(tmp_path: Path) -> None:
    alone, beside = written(tmp_path / "a", 20.0), written(tmp_path / "b", 21.0, timed="shared")
    change = by_method(compare(read_results(alone), read_results(beside)).changes)["same"]
    assert change.shared
    assert change.time_ratio == pytest.approx(20 / 21)


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        (None, InputError, "run directory"),
        (b"x", DataCorruptError, "samples.parquet"),
        (pd.DataFrame({"scenario": ["one"], "operator": ["fem"]}), InputError, "run of operators"),
    ],
)
def test_bad_runs_are_refused(
    tmp_path: Path, content: Any, error: type[Exception], words: str
) -> None:
    table = written(tmp_path / "run", 1.0) / "samples.parquet"
    table.unlink()
    if content is not None:
        table.write_bytes(content if isinstance(content, bytes) else content.to_parquet())
    with pytest.raises(error, match=words):
        read_results(table.parent)
