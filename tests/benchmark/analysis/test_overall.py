"""Mean ranks over scenarios, beside published values and what can be counted by hand."""

import numpy as np
import pytest
from scipy import stats

from eitbench.benchmark.analysis.overall import (
    MIN_SCENARIOS,
    DataFigures,
    overall,
    wins_over_suites,
)

TABLE = {"one": {"a": 3.0, "b": 2.0, "c": 1.0}, "two": {"a": -4.0, "b": -4.0, "c": -9.0}}


def test_ranks_and_wins_are_counted() -> None:
    found = overall({**TABLE, "three": {"c": 7.0, "a": 5.0, "b": 4.0, "d": 9.0}})
    assert found is not None
    rows = {row.method: row for row in found.rows}
    assert [row.method for row in found.rows] == ["a", "b", "c"]
    assert rows["a"].rank == pytest.approx((1 + 1.5 + 2) / 3)
    assert rows["c"].rank == pytest.approx((3 + 3 + 1) / 3)
    assert [rows[name].wins for name in "abc"] == pytest.approx([1.5 / 3, 0.5 / 3, 1 / 3])
    assert found.left_out == ["d"]
    assert rows["a"].rank_low is rows["a"].wins_high is None  # too few scenarios


@pytest.mark.parametrize(("methods", "quantile"), [(2, 1.960), (5, 2.728), (10, 3.164)])
def test_the_critical_difference_is_that_of_the_published_table(
    methods: int, quantile: float
) -> None:
    """Demsar (2006), table 5(a), at 0.05."""
    of = {f"m{k}": float(k) for k in range(methods)}
    found = overall({f"s{k}": of for k in range(14)})
    assert found is not None
    expected = quantile * np.sqrt(methods * (methods + 1) / (6 * 14))
    assert found.critical_difference == pytest.approx(expected, abs=1e-3)


def test_intervals_hold_the_mean_of_other_scenarios() -> None:
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(40):
        table = {f"s{k}": dict(zip("abc", rng.normal([1, 0, 0]), strict=True)) for k in range(12)}
        found = overall(table)
        assert found is not None
        (row,) = (row for row in found.rows if row.method == "a")
        assert row.rank_low is not None
        assert row.rank_high is not None
        # 1 + 2 P(another is better), the difference of two normal values.
        held += row.rank_low <= 1 + 2 * stats.norm.cdf(-1 / np.sqrt(2)) <= row.rank_high
    assert held >= 35


def test_all_equal_or_alone_is_no_order() -> None:
    assert overall({"one": {"a": 1.0, "b": 2.0}}) is None
    assert overall({"one": {"a": 1.0}, "two": {"a": 1.0, "b": 1.0}}) is None
    found = overall({f"s{k}": {"a": 1.0, "b": 1.0, "c": 1.0} for k in range(MIN_SCENARIOS)})
    assert found is not None
    assert {(row.rank, row.rank_low, row.rank_high) for row in found.rows} == {(1.0, 1.0, 1.0)}
    assert found.friedman_p is None


def test_a_method_of_two_names_counts_once_for_the_others() -> None:
    alone = {f"s{k}": {"a": 3.0 + k % 2, "b": 3.5, "c": 1.0} for k in range(MIN_SCENARIOS)}
    twice = {name: {**of, "twin": of["a"]} for name, of in alone.items()}
    one, two = overall(alone), overall(twice)
    assert one is not None
    assert two is not None
    rows = {row.method: row for row in two.rows}
    assert [rows[row.method] for row in one.rows] == one.rows
    assert (rows["twin"].rank, rows["twin"].wins) == (rows["a"].rank, rows["a"].wins)
    assert (two.critical_difference, two.friedman_p) == (one.critical_difference, one.friedman_p)
    fields = [field(name, name, of) for name, of in alone.items()]
    more = wins_over_suites(field(name, name, of) for name, of in twice.items())
    assert [row for row in more if row.method != "twin"] == wins_over_suites(fields)


def test_the_ratio_to_a_guess_is_the_median_over_scenarios() -> None:
    errors = {f"s{k}": {"a": -1.0 * k, "b": -6.0} for k in range(1, 7)}
    guesses = dict.fromkeys(errors, 10.0)
    found = overall(errors, guesses)
    assert found is not None
    rows = {row.method: row for row in found.rows}
    assert rows["a"].ratio == pytest.approx(0.35)
    assert rows["a"].ratio_low is not None
    assert rows["a"].ratio_high is not None
    assert 0.1 <= rows["a"].ratio_low < 0.35 < rows["a"].ratio_high <= 0.6
    assert [rows["b"].ratio, rows["b"].ratio_low] == pytest.approx([0.6, 0.6])
    few = overall({name: errors[name] for name in ("s1", "s2")}, guesses)
    assert few is not None
    assert {row.ratio_low for row in few.rows} == {None}
    lacking = overall(errors, {"s1": 10.0})
    assert lacking is not None
    assert {row.ratio for row in lacking.rows} == {None}


def field(suite: str, frames: str, figures: dict[str, float]) -> DataFigures:
    return DataFigures(suite, frozenset(frames.split()), figures)


def test_wins_count_frames_once_where_there_are_the_most_of_them() -> None:
    shared = {"a": 1.0, "b": 2.0}
    fields = [field("s1", "x", shared), field("s2", "x", {**shared, "c": 3.0})]
    fields += [field(f"s{k}", "x", shared) for k in (3, 4, 5)]
    rows = {row.method: row for row in wins_over_suites(fields)}
    assert {name: row.share for name, row in rows.items()} == {"a": 0.0, "b": 0.5, "c": 1.0}
    assert {(row.suites, row.data_sets, row.low) for row in rows.values()} == {(1, 1, None)}
    more = field("s6", "x y z", {"a": 2.0, "b": 1.0})
    rows = {row.method: row for row in wins_over_suites([*fields, more])}
    assert {name: row.share for name, row in rows.items()} == {"a": 1.0, "b": 0.0}
    apart = field("s7", "z u v", shared)  # most of its frames are its own
    rows = {row.method: row for row in wins_over_suites([more, apart])}
    assert {row.data_sets for row in rows.values()} == {2}


def test_a_suite_counts_as_much_as_any_other_by_the_data_that_are_its_own() -> None:
    fields = [field("one", f"x{k}", {"a": 2.0, "b": 1.0}) for k in range(3)]
    fields += [field("two", data, {"a": 1.0, "b": 2.0}) for data in ("x0", "x1", "y")]
    rows = {row.method: row for row in wins_over_suites(fields)}
    assert [rows["a"].share, rows["a"].suites, rows["a"].data_sets] == [0.5, 2, 4]


def test_suites_that_share_their_data_make_no_interval_narrower() -> None:
    fields = [field(f"s{k}", f"x{k}", {"a": float(k % 2), "b": 0.5}) for k in range(MIN_SCENARIOS)]
    again = [field(f"t{k}", "x1", {"a": 1.0, "b": 0.5}) for k in range(20)]
    assert wins_over_suites(fields + again) == wins_over_suites(fields)
    assert all(row.low is not None for row in wins_over_suites(fields))
