"""Standings of methods whose differences are known, because they were made."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import stats

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.analysis.standings import (
    Standing,
    adjusted,
    groups,
    score_weights,
    standings,
    weights_won,
)
from eitbench.benchmark.metrics.specs import bounded_score, score
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, OPERATOR_RUNS

Array = NDArray[np.float64]


DATA = {"hash": "c0ffee", "n": 80, "inverse_crime": False, "sensor": "foam16"}
PLAN: dict[str, Any] = {"suite": {"name": "bench"}, "plugins": []}
MANIFEST = {"plan": PLAN, "data": {"one": DATA}, "cells": [], "started": "2026-01-01"}


def run_of(psnr: Mapping[str, Array], phantom: Array | None = None, **more: Any) -> Run:
    """A run on one scenario whose methods have these values; SSIM, CC and RIE are all alike."""
    cells = []
    for name, values in psnr.items():
        n = len(values)
        of = np.arange(n) if phantom is None else phantom
        cell = pd.DataFrame(
            {
                "suite": "bench", "scenario": "one", "method": name, "track": "tuned",
                "sample": np.arange(n), "cluster": [f"p{k}" for k in of], "status": "ok",
                "ssim": 0.9, "cc": 0.8, "rie": 0.1, "psnr": values,
            }
        )  # fmt: skip
        for column, of_methods in more.items():
            cell[column] = of_methods[name]
        four = {metric: cell[metric] for metric in ("ssim", "cc", "rie", "psnr")}
        cells.append(cell.assign(score=score(**four), bounded=bounded_score(four)))
    table = pd.concat(cells, ignore_index=True)
    whole = pd.DataFrame({"scenario": "one", "method": list(psnr), "track": "tuned"})
    manifest = {**MANIFEST, "data": {"one": {**DATA, "n": n}}}
    return Run(Path("bench"), METHOD_RUNS, manifest, table, whole, {})


def standing(*args: Any, **more: Any) -> Standing:
    (found,) = standings([run_of(*args, **more)])
    return found


def four_methods(n: int = 80) -> dict[str, Array]:
    """Two that differ by chance alone, one surely worse by little, one by far."""
    rng = np.random.default_rng(0)
    shared = rng.normal(25, 5, size=n)
    return {
        "best": shared + 0.2 * rng.normal(size=n),
        "as-good": shared + 0.2 * rng.normal(size=n),
        "worse": shared - 0.5 + 0.2 * rng.normal(size=n),
        "worst": shared - 8 + 3 * rng.normal(size=n),
    }


def test_paired_differences_are_found_that_intervals_of_means_hide() -> None:
    found = standing(four_methods())
    rows = {row["method"]: row for row in found.rows}
    # Phantoms differ by 5 dB, so that the interval of each mean is wider than the difference.
    assert rows["best"]["psnr_low"] < rows["worse"]["psnr"] < rows["best"]["psnr_high"]
    assert [rows[m]["group"] for m in ("best", "as-good", "worse", "worst")] == ["a", "a", "b", "c"]
    assert {rows[m]["rank_low"] for m in ("best", "as-good")} == {1}
    assert {rows[m]["rank_high"] for m in ("best", "as-good")} == {2}
    for name, rank in (("worse", 3), ("worst", 4)):
        assert rows[name]["rank_low"] == rows[name]["rank_high"] == rows[name]["rank"] == rank
    assert rows["best"]["first"] + rows["as-good"]["first"] == pytest.approx(1, abs=0.01)
    assert found.clusters == 80


def test_pairs_tell_how_much_and_how_surely() -> None:
    methods = four_methods()
    found = standing(methods)
    names = [row["method"] for row in found.rows]
    assert len(found.pairs) == 6
    pair = next(p for p in found.pairs if (names[p.first], names[p.second]) == ("worse", "worst"))
    difference = 0.25 * (methods["worse"] - methods["worst"])
    assert pair.difference == pytest.approx(difference.mean())
    assert pair.effect == pytest.approx(difference.mean() / difference.std(ddof=1), rel=0.05)
    assert pair.wins == pytest.approx((difference > 0).mean())
    assert pair.low < difference.mean() < pair.high
    assert pair.p < 1e-6
    tied = next(p for p in found.pairs if {names[p.first], names[p.second]} == {"best", "as-good"})
    assert tied.p > 0.05
    assert tied.low < 0 < tied.high


def test_samples_on_which_two_methods_are_equal_count_half() -> None:
    shared = np.random.default_rng(3).normal(25, 5, size=80)
    gain = np.repeat([1.0, 0.0, -0.2], [20, 40, 20])
    (pair,) = standing({"one": shared + gain, "other": shared}).pairs
    assert pair.wins == pytest.approx(0.25 + 0.5 * 0.5)


@pytest.mark.parametrize("gain", [0.28, -0.34])
def test_a_p_value_is_that_of_a_two_sided_paired_test(gain: float) -> None:
    rng = np.random.default_rng(9)
    shared, noise = rng.normal(25, 5, size=60), rng.normal(size=60)
    noise -= noise.mean()
    methods = {"one": shared + gain + noise, "other": shared}
    (pair,) = standing(methods).pairs
    expected = stats.ttest_rel(methods["one"], methods["other"]).pvalue
    assert 0.005 < expected < 0.06
    assert pair.p == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize(("share", "ranks"), [(0.005, (1, 1)), (0.04, (1, 2)), (0.1, (1, 2))])
def test_a_rank_interval_leaves_out_five_draws_of_a_hundred(
    share: float, ranks: tuple[int, int]
) -> None:
    """The worse of two methods is the better one in about `share` of the draws."""
    rng = np.random.default_rng(10)
    shared, noise = rng.normal(25, 5, size=100), rng.normal(size=100)
    noise = (noise - noise.mean()) / noise.std()
    better = -stats.norm.ppf(share) / np.sqrt(len(noise))
    first, second = standing({"one": shared + better + noise, "other": shared}).rows
    assert second["first"] == pytest.approx(share, abs=0.01 if share < 0.05 else 0.03)
    assert (first["rank_low"], first["rank_high"]) == ranks
    assert (second["rank_low"], second["rank_high"]) == (3 - ranks[1], 2)


def test_frames_of_the_same_cluster_do_not_count_as_many() -> None:
    rng = np.random.default_rng(1)
    difference = np.repeat(rng.normal(0.2, 1, size=15), 40)
    shared = rng.normal(25, 3, size=len(difference))
    methods = {"one": shared + difference, "other": shared}
    alone = standing(methods)
    together = standing(methods, np.repeat(np.arange(15), 40))
    assert alone.pairs[0].p < 1e-6 < 0.02 < together.pairs[0].p
    assert together.clusters == 15


@pytest.mark.slow
def test_false_findings_are_as_rare_as_promised_where_sessions_share_their_noise() -> None:
    """Five methods without a true difference, which see the noise of a reference differently.

    Some pair of them is found in at most 5 % of runs. Were samples drawn one by one, as if each
    had a reference frame of its own, differences would be found far more often.
    """
    rng = np.random.default_rng(2)
    sessions, touches, runs = 40, 3, 60
    of = np.repeat(np.arange(sessions), touches)
    found = {"sessions": 0, "samples": 0}
    for _ in range(runs):
        shared = rng.normal(25, 5, size=len(of))
        methods = {
            f"m{k}": shared + rng.normal(size=sessions)[of] + 0.5 * rng.normal(size=len(of))
            for k in range(5)
        }
        for name, clusters in (("sessions", of), ("samples", np.arange(len(of)))):
            pairs = standing(methods, clusters).pairs
            found[name] += min(pair.p for pair in pairs) < 0.05
    most = stats.binom.ppf(1 - 1e-3, runs, 0.05)
    assert found["sessions"] <= most
    assert found["samples"] > 2 * most


def test_equal_methods_share_rank_group_and_weights() -> None:
    values = np.random.default_rng(3).normal(25, 5, size=30)
    first, second = standing({"one": values, "same": values.copy()}).rows
    for row in (first, second):
        assert (row["rank"], row["rank_low"], row["rank_high"], row["group"]) == (1, 1, 1, "a")
        assert row["weights_won"] == 0.5


def named(run: Run, name: str, started: str, **more: Any) -> Run:
    return replace(run, path=Path(name), manifest={**run.manifest, "started": started, **more})


def told(runs: list[Run]) -> dict[tuple[str, str], tuple[float, bool]]:
    """The p-value of every two methods, and if they share a letter."""
    (found,) = standings(runs)
    letters = [set(row["group"]) for row in found.rows]
    names = [row["method"] for row in found.rows]
    return {
        tuple(sorted((names[k.first], names[k.second]))): (
            k.p,
            bool(letters[k.first] & letters[k.second]),
        )
        for k in found.pairs
    }


def first_and_others() -> tuple[Run, list[Run]]:
    """A run in which differences are just found, and eight later runs of other methods."""
    rng = np.random.default_rng(5)
    shared = rng.normal(25, 5, size=60)

    def run(prefix: str, gains: list[float]) -> Run:
        noise = [(of - of.mean()) / of.std() for of in rng.normal(size=(len(gains), 60))]
        return run_of({f"{prefix}{k}": shared + gain + noise[k] for k, gain in enumerate(gains)})

    first = named(run("first", [0.0, 0.5, 0.6, 0.7]), "first", "2026-01-01")
    others = [named(run(f"run{k}-", [0.1] * 4), f"run{k}", f"2026-01-1{k}") for k in range(8)]
    return first, others


def test_other_runs_change_neither_p_values_nor_ties() -> None:
    first, others = first_and_others()
    alone = told([first])
    assert {tie for _, tie in alone.values()} == {True, False}
    for shown in ([first, *others], [*others, first], [first, others[0]]):
        together = told(shown)
        assert {pair: together[pair] for pair in alone} == alone


def test_a_comparison_that_is_split_into_runs_has_the_p_values_of_the_whole() -> None:
    first, _ = first_and_others()
    plan = {**PLAN, "suite": {"methods": ["first0", "first1", "first2", "first3"]}}
    whole = named(first, "whole", "2026-01-01", plan=plan)
    parts = [
        replace(
            named(first, f"part{k}", f"2025-01-0{k + 1}", plan=plan),
            samples=first.samples[first.samples["method"].isin(pair)],
        )
        for k, pair in enumerate((("first0", "first1"), ("first1", "first2"), ("first3",)))
    ]
    assert told(parts) == told([whole]) == told([whole, *parts])


def test_p_values_count_the_pairs_of_the_scenario() -> None:
    np.testing.assert_allclose(adjusted([0.01, 0.01, 0.5], [2, 4, 3]), [0.01, 0.06, 1.0])
    assert adjusted([0.9], [1]) == [0.9]  # two runs of the one method of a suite are a pair


def test_repeats_are_one_row_and_change_nothing() -> None:
    first, _ = first_and_others()
    again = named(first, "again", "2026-02-01")
    more = named(run_of({"first0": np.zeros(60)}), "more", "2026-03-01")
    # A run of some of the methods is no smaller family.
    few = first.samples[first.samples["method"].isin(["first0", "first1"])]
    part = replace(named(first, "part", "2026-02-02"), samples=few)
    (found,) = standings([part, again, first])
    assert {row["method"]: (row["run"], row["repeats"]) for row in found.rows} == {
        "first0": ("part", "first, again"), "first1": ("part", "first, again"),
        "first2": ("again", "first"), "first3": ("again", "first"),
    }  # fmt: skip
    assert told([part, again, first]) == told([first])
    # Nor do figures matter that one of the runs has of other scenarios alone.
    other = first.samples.assign(scenario="two", iou=0.5)
    both = pd.concat([first.samples.assign(iou=np.nan), other], ignore_index=True)
    data = dict.fromkeys(("one", "two"), first.manifest["data"]["one"])
    wider = replace(named(first, "wider", "2026-02-03", data=data), samples=both)
    of_one = next(of for of in standings([first, wider]) if of.rows[0]["scenario"] == "one")
    assert [row["repeats"] for row in of_one.rows] == ["first"] * 4
    # Of other results, it is no repeat.
    assert [row["repeats"] for row in standings([first, more])[0].rows] == [None] * 5


@pytest.mark.parametrize(
    ("about", "rows"),
    [
        ({}, 1),
        ({"cells": [{"scenario": "one", "name": "a", "parameters": {"weight": 1}}]}, 2),
        ({"plan": {**PLAN, "plugins": [{"names": ["a"], "sha256": "c0de"}]}}, 2),
        ({"plan": {**PLAN, "plugins": [{"names": ["b"], "sha256": "c0de"}]}}, 1),
    ],
)
def test_a_repeat_has_the_same_parameters_and_code(about: dict[str, Any], rows: int) -> None:
    run = run_of({"a": np.arange(20.0)})
    (found,) = standings([named(run, "x", "1"), named(run, "y", "2", **about)])
    assert len(found.rows) == rows


def test_failed_samples_cost_and_the_rank_without_them_is_told() -> None:
    rng = np.random.default_rng(4)
    good, fair = rng.normal(30, 1, size=40), rng.normal(28, 1, size=40)
    good[:10] = 12.0  # what the untouched sensor gets
    status = {"good": np.repeat(["error", "ok"], [10, 30]), "fair": np.repeat("ok", 40)}
    rows = {
        row["method"]: row for row in standing({"good": good, "fair": fair}, status=status).rows
    }
    assert rows["good"]["psnr"] == pytest.approx(good.mean())
    assert (rows["good"]["rank"], rows["good"]["rank_valid"]) == (2, 1)
    assert (rows["fair"]["rank"], rows["fair"]["rank_valid"]) == (1, 2)


def test_gaps_between_tracks_are_those_of_the_method_and_scenario() -> None:
    methods = four_methods(40)
    run = run_of(methods)
    default = run.samples.assign(track="default")
    default["psnr"] -= np.where(default["method"] == "best", 2.0, 4.0)
    four = {metric: default[metric] for metric in ("ssim", "cc", "rie", "psnr")}
    default = default.assign(score=score(**four))
    elsewhere = default.assign(scenario="another", score=0.0)
    (found,) = standings([replace(run, tracks=pd.concat([default, elsewhere]))])
    for row in found.rows:
        lower = 2.0 if row["method"] == "best" else 4.0
        assert row["tuning_gain"] == pytest.approx(0.25 * lower)
        assert row["default_figure"] == pytest.approx(row["score"] - 0.25 * lower)
        assert row["tuning_gain_low"] == pytest.approx(0.25 * lower)  # each sample gains it


def test_no_draw_may_lack_what_the_figure_compares() -> None:
    """All untouched frames are of one session here, which a third of the draws leave out."""
    n = 3 * MIN_CLUSTERS
    sessions = np.array([k // 3 for k in range(n)], dtype=np.float64)
    run = run_of({"one": np.zeros(n), "other": np.zeros(n)}, sessions)
    rest = run.samples.drop(columns=["ssim", "cc", "rie", "psnr", "score", "bounded"])
    touched = rest["sample"] >= 3
    noise = np.random.default_rng(0).normal(1, 0.1, 2 * n)
    samples = rest.assign(touched=touched, response=noise * np.where(touched, 100, 1))
    (found,) = standings([replace(run, samples=samples)])
    assert [row["ranked_by"] for row in found.rows] == ["repeatability_db"] * 2
    assert [row["repeatability_db"] for row in found.rows] == pytest.approx([40, 40], abs=1)
    assert (found.pairs, {row["group"] for row in found.rows}) == ([], {None})
    assert "some draws lack frames that the repeatability compares" in found.why_not


def test_too_few_clusters_say_so() -> None:
    found = standing({"one": np.arange(MIN_CLUSTERS - 1.0), "other": np.arange(MIN_CLUSTERS - 1.0)})
    assert found.why_not == (
        "Intervals and ties need at least 10 independent sessions or objects; this board has 9."
    )
    assert found.pairs == []
    assert all(row["score_low"] is row["group"] is row["rank_low"] is None for row in found.rows)


def test_a_method_that_lacks_samples_or_failed_on_all_has_no_interval() -> None:
    methods = four_methods(40)
    run = run_of(methods)
    table = run.samples
    table.loc[table["method"] == "worse", "status"] = "error"
    lost = (table["method"] == "worst") & (table["sample"] >= 20)
    (found,) = standings([replace(run, samples=table[~lost])])
    rows = {row["method"]: row for row in found.rows}
    assert rows["worst"]["group"] is rows["worse"]["group"] is None
    assert rows["worse"]["score"] is None
    assert {rows["best"]["group"], rows["as-good"]["group"]} == {"a"}
    assert len(found.pairs) == 1


def test_operators_get_no_intervals() -> None:
    names = {"suite": "s", "scenario": "one", "operator": "o"}
    samples = pd.DataFrame({**names, "sample": [0], "status": "ok", "mse": 1.0})
    run = Run(Path("run"), OPERATOR_RUNS, MANIFEST, samples, pd.DataFrame(columns=list(names)), {})
    (found,) = standings([run])
    assert found.why_not.startswith("There are no intervals for operators")


@pytest.mark.parametrize(
    ("apart", "letters"),
    [
        (set(), ["a", "a", "a", "a"]),
        ({(0, 3)}, ["a", "ab", "ab", "b"]),
        ({(0, 1), (0, 2), (0, 3)}, ["a", "b", "b", "b"]),
        ({(0, 2), (0, 3), (1, 3)}, ["a", "ab", "bc", "c"]),
        # The second differs from the first, and the third, which is noisy, from none of them.
        ({(0, 1)}, ["a", "b", "ab", "ab"]),
        ({(0, 1), (0, 3), (1, 3)}, ["a", "b", "abc", "c"]),
        (set(combinations(range(4), 2)), ["a", "b", "c", "d"]),
    ],
)
def test_letters_of_groups(apart: set[tuple[int, int]], letters: list[str]) -> None:
    assert groups(4, sorted(apart)) == letters


def test_methods_share_a_letter_if_and_only_if_they_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(0)
    every = list(combinations(range(9), 2))
    for _ in range(50):
        apart = {pair for pair in every if rng.random() < 0.5}
        letters = groups(9, sorted(apart))
        for a, b in every:
            assert bool(set(letters[a]) & set(letters[b])) == ((a, b) not in apart)


def test_there_are_letters_enough() -> None:
    found = groups(30, combinations(range(30), 2))
    assert found[25:28] == ["z", "a2", "b2"]
    assert len(set(found)) == 30


def test_weights_are_won_as_geometry_says() -> None:
    """One is best by SSIM alone, the other by the rest alike: w1 against w2 + w3 + w4."""
    low, high = {"ssim": 0.4, "cc": 0.5, "rie": 0.5, "psnr": 20.0}, {"ssim": 0.5}
    rows = [pd.DataFrame([low | high]), pd.DataFrame([low | {"cc": 0.6, "rie": 0.4, "psnr": 24.0}])]
    won = weights_won(rows)
    assert won is not None
    # The first wins where w1 > 1/2: of a simplex in four weights, (1/2)^3.
    np.testing.assert_allclose(won, [1 / 8, 7 / 8], atol=0.01)


def test_the_published_score_is_a_weighting_of_anchored_figures() -> None:
    weights = score_weights()
    assert sum(weights.values()) == pytest.approx(1)
    assert weights["psnr"] == pytest.approx(40 / 43)


def test_a_method_that_never_responds_is_compared_with_nobody() -> None:
    """It has no figure, stands last, and is not the best of any draw."""
    rng = np.random.default_rng(0)
    touched = np.arange(80) % 2 == 0
    responses = {
        name: np.where(touched, signal, 1) * (1 + 0.1 * rng.random(80))
        for name, signal in (("good", 30.0), ("poor", 3.0))
    }
    responses["silent"] = np.zeros(80)
    made = run_of(dict.fromkeys(responses, np.zeros(80)), response=responses)
    table = made.samples.drop(columns=["ssim", "cc", "rie", "psnr", "score", "bounded"])
    found = standings([replace(made, samples=table.assign(touched=np.tile(touched, 3)))])[0]
    rows = {row["method"]: row for row in found.rows}
    assert rows["good"]["ranked_by"] == "repeatability_db"
    assert [row["method"] for row in found.rows] == ["good", "poor", "silent"]
    assert (rows["good"]["first"], rows["good"]["rank_high"]) == (1.0, 1)
    assert rows["silent"]["first"] is rows["silent"]["rank_low"] is rows["silent"]["group"] is None
    assert [(pair.first, pair.second) for pair in found.pairs] == [(0, 1)]
