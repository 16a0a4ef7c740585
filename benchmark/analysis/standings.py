"""Intervals, ranks and paired differences of the methods of a leaderboard.

All methods of a board share their bootstrap draws of clusters, so that every difference is paired.
Operators get no intervals: what is measured of them does not depend on noise.

Medians are compared by Wilcoxon's signed-rank test of the paired differences. A limit: intervals of
means of few and very skewed values are too short (of 10 lognormal values, 83 % contained the mean;
of 24, 91 %; of 60, 93 %).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import special

from eitbench.benchmark.analysis.leaderboard import (
    Entry,
    Row,
    is_whole,
    ranked_boards,
    ranking_figure,
)
from eitbench.benchmark.analysis.results import Run, in_order
from eitbench.benchmark.metrics.aggregation import aggregate, figure_of, numbers
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.specs import ANCHORS, anchored
from eitbench.benchmark.metrics.statistics import (
    LEVEL,
    MIN_CLUSTERS,
    draw,
    intervals,
    once,
    signed_rank_of,
    student_t,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.scenarios.arrays import Array

WEIGHTINGS = 20_000
SIGNIFICANT = 1 - LEVEL
_DIGITS = 9  # that count in a draw, see `EQUAL`

_GAPS = {"tuning_gain": ("tuned", "default"), "oracle_gap": ("oracle", "tuned")}
_COLUMNS = (
    *("ranked_by", "group", "rank_low", "rank_high", "first", "rank_valid", "weights_won"),
    *(f"{name}_{end}" for name in METHOD_RUNS.metrics for end in ("low", "high")),
    # None where other tracks were not run: the ranked figure on each track, tuned over default, and
    # oracle over tuned; gaps are never negative where they help.
    *("default_figure", "tuned_figure", "oracle_figure"),
    *(f"{gap}{end}" for gap in _GAPS for end in ("", "_low", "_high")),
)


@dataclass(frozen=True)
class Pair:
    """Two methods of a board on the same samples, by the figure that ranks them.

    Attributes:
        first, second: their positions on the board; the first ranks no lower.
        difference, low, high: first minus second, with its 95 % interval.
        p: of no difference, adjusted for all pairs of its family, see `adjusted`; of medians by the
            signed ranks of paired differences.
        effect: the difference over the standard deviation of that of one cluster: Cohen's d of
            means; of medians, and of means over unequal clusters, by the bootstrap's error, which
            is an estimate of it.
        wins: share of the samples on which the first is better, equals counting half; None where
            single samples have no such figure.
    """

    first: int
    second: int
    difference: float
    low: float
    high: float
    p: float
    effect: float
    wins: float | None


@dataclass(frozen=True, eq=False)
class Standing:
    """A board with the statistics of its methods.

    Attributes:
        rows: by rank, with more columns than those of `leaderboard_rows`, None where there is no
            such thing: `ranked_by`; `group`, letters, of which methods that cannot be told apart
            share one; `rank_low` and `rank_high`; `first`, the share of draws in which it is the
            best; `rank_valid`, the rank if failed samples were left out; `weights_won`, the share
            of all weightings of SSIM, CC, RIE and PSNR under which it is the best; and the ends
            `NAME_low`, `NAME_high` of every figure; and those of `track_gaps`.
        pairs: every two methods that have all samples.
        clusters: number of those that were drawn, of sessions or objects; 0 where none were.
        why_not: why there are no intervals, as a sentence; "" where there are.
    """

    rows: list[Row]
    pairs: list[Pair]
    clusters: int
    why_not: str


def standings(runs: Sequence[Run]) -> list[Standing]:
    """Compute the standing of every board of the runs.

    Raises:
        InputError: some of the runs rank methods and others operators.
    """
    return [_standing(board) for board in ranked_boards(runs)]


def _standing(board: Sequence[Entry]) -> Standing:
    rows = [dict(entry.row) for entry in board]
    if any(entry.run.kind.name != "method" for entry in board):
        return Standing(rows, [], 0, "There are no intervals for operators: chance plays no part.")
    specs = [
        c for c in METHOD_RUNS.metrics.values() if any(row[c.name] is not None for row in rows)
    ]
    by = ranking_figure(rows, METHOD_RUNS)
    for row, rank in zip(rows, _ranks_of_valid(board, by), strict=True):
        row |= dict.fromkeys(_COLUMNS)
        row |= {"ranked_by": by, "rank_valid": rank}
    if by is None:
        return Standing(rows, [], 0, "No figure that could rank methods is known here.")
    for row, entry in zip(rows, board, strict=True):
        row |= _gaps(entry, by)
    places = [place for place in _whole(board) if board[place].row[by] is not None]
    cells = [in_order(board[place].cell) for place in places]
    clusters = cells[0]["cluster"].nunique() if cells else 0
    if clusters < MIN_CLUSTERS:
        why = (
            f"Intervals and ties need at least {MIN_CLUSTERS} independent sessions or objects; "
            f"this board has {clusters}."
        )
        return Standing(rows, [], 0, why)

    def figures(counts: Array) -> Array:
        return np.stack([aggregate(cell, specs, counts) for cell in cells], axis=1)

    found = [[rows[place][spec.name] for spec in specs] for place in places]
    value = np.array(found, dtype=np.float64)  # NaN where there is none
    drawn = draw(figures, cells[0]["cluster"])
    main = next(k for k, spec in enumerate(specs) if spec.name == by)
    if np.isnan(drawn[:, :, main]).any():
        why = (
            "Intervals and ties need the figure of every draw of sessions or objects; some draws "
            f"lack frames that the {specs[main].title.lower()} compares."
        )
        return Standing(rows, [], 0, why)
    ends = intervals(value, drawn, clusters)
    oriented = np.round(drawn[:, :, main], _DIGITS) * specs[main].sign
    ranks = 1 + (oriented[:, None, :] > oriented[:, :, None]).sum(axis=2)
    rank_ends = np.quantile(
        ranks, [SIGNIFICANT / 2, 1 - SIGNIFICANT / 2], axis=0, method="inverted_cdf"
    )
    rivals = np.array([board[place].rivals for place in places])
    pairs = compared(cells, rivals, specs[main], value[:, main], drawn[:, :, main], clusters)
    apart = [(pair.first, pair.second) for pair in pairs if pair.p < SIGNIFICANT]
    letters, won = groups(len(cells), apart), weights_won(cells)
    for k, row in enumerate(rows[place] for place in places):
        row |= {"group": letters[k], "first": float((ranks[:, k] == 1).mean())}
        row |= {"rank_low": int(rank_ends[0, k]), "rank_high": int(rank_ends[1, k])}
        row["weights_won"] = None if won is None else float(won[k])
        for j, spec in enumerate(specs):
            if np.isfinite(ends[:, k, j]).all():
                row[f"{spec.name}_low"], row[f"{spec.name}_high"] = map(float, ends[:, k, j])
    placed = [replace(p, first=places[p.first], second=places[p.second]) for p in pairs]
    return Standing(rows, placed, clusters, "")


def _gaps(entry: Entry, by: str) -> dict[str, float]:
    """Gaps to the other tracks of a row; empty where none was run."""
    others, row = entry.run.tracks, entry.row
    if others.empty:
        return {}
    of = (others["scenario"] == row["scenario"]) & (others["method"] == row["method"])
    return track_gaps(others[of], entry.cell, row["track"], by) if of.any() else {}


def track_gaps(
    tracks: pd.DataFrame, main: pd.DataFrame, main_track: str, by: str
) -> dict[str, float]:
    """Compute the columns of gaps between tracks that are known of a method on a scenario.

    The intervals are of a paired bootstrap over clusters; fewer than `MIN_CLUSTERS` give none.

    Args:
        tracks: its rows of the tracks beside the ranked one.
        main: its rows of the ranked track.
        main_track: name of that track; "calibrated" frames are those of tuned methods.
        by: the name of the figure that ranks.
    """
    spec = METHOD_RUNS.metrics[by]
    cells = {str(track): rows for track, rows in tracks.groupby("track")}
    cells["tuned" if main_track == "calibrated" else main_track] = main
    cells = {track: in_order(rows) for track, rows in cells.items()}
    if len({tuple(rows["sample"]) for rows in cells.values()}) > 1:
        return {}

    def figures(counts: Array) -> Array:
        return np.stack([aggregate(rows, [spec], counts)[:, 0] for rows in cells.values()], axis=1)

    names, values = list(cells), once(figures, len(main))
    found = {f"{track}_figure": value for track, value in zip(cells, values, strict=True)}
    found.pop("given_figure", None)  # it is that of the row
    clusters = in_order(main)["cluster"]
    many = clusters.nunique() >= MIN_CLUSTERS
    drawn = draw(figures, clusters) if many else None
    for gap, (better, worse) in _GAPS.items():
        if better in cells and worse in cells:
            one, other = names.index(better), names.index(worse)
            found[gap] = spec.sign * (values[one] - values[other])
            if drawn is not None:
                each = spec.sign * (drawn[:, one] - drawn[:, other])
                ends = intervals(np.array([found[gap]]), each[:, None], clusters.nunique())
                found[f"{gap}_low"], found[f"{gap}_high"] = ends[:, 0]
    return {name: float(value) for name, value in found.items() if np.isfinite(value)}


def _whole(board: Sequence[Entry]) -> list[int]:
    """Places of the rows that hold all samples of the board, of which some did not fail."""
    most = max(len(entry.cell) for entry in board)
    return [
        place
        for place, entry in enumerate(board)
        if is_whole(entry.row) and len(entry.cell) == most and entry.row["coverage"] > 0
    ]


def _ranks_of_valid(board: Sequence[Entry], by: str | None) -> list[int | None]:
    """The rank of every row if failed samples were left out; None where none is left."""
    if by is None:
        return [None] * len(board)
    spec = METHOD_RUNS.metrics[by]
    values = []
    for entry in board:
        valid = entry.cell["status"] == "ok"
        figure = entry.row[by] if valid.all() else figure_of(entry.cell[valid], spec)
        values.append(np.nan if figure is None else figure)
    keys = [(not is_whole(e.row), -spec.sign * v) for e, v in zip(board, values, strict=True)]
    known = [key for key in keys if np.isfinite(key[1])]
    return [1 + sum(other < key for other in known) if key in known else None for key in keys]


def compared(
    cells: Sequence[pd.DataFrame],
    rivals: NDArray[np.int64],
    spec: MetricSpec,
    value: Array,
    drawn: Array,
    clusters: int,
) -> list[Pair]:
    """Compare every two cells of the same frames, the best first, by one figure.

    Args:
        cells: (k,) tables of samples.
        rivals: (k,) see `adjusted`.
        spec: of the figure.
        value: (k,) the figure of each cell.
        drawn: (b, k) the same of draws of `clusters` clusters, each a session or an object.
    """
    found = list(combinations(range(len(cells)), 2))
    if not found:
        return []
    one, other = np.array(found).T
    difference, differences = value[one] - value[other], drawn[:, one] - drawn[:, other]
    low, high = intervals(difference, differences, clusters)
    t = student_t(difference, differences, clusters)
    # What single samples have of the figure; where it is of all samples together, nothing.
    of_samples = spec.name in cells[0]
    values = [numbers(cell, spec.name) for cell in cells] if of_samples else []
    if spec.aggregate == "median":
        _, of = np.unique(cells[0]["cluster"], return_inverse=True)
        each: ArrayLike = [
            signed_rank_of(float(difference[k]), values[a] - values[b], of)
            for k, (a, b) in enumerate(found)
        ]
    else:
        each = 2 * special.stdtr(clusters - 1, -np.abs(t))
    p = adjusted(each, np.maximum(rivals[one], rivals[other]))
    return [
        Pair(
            first=a,
            second=b,
            difference=float(difference[k]),
            low=float(low[k]),
            high=float(high[k]),
            p=float(p[k]),
            effect=float(t[k] / np.sqrt(clusters)),
            wins=_wins(spec.sign * (values[a] - values[b])) if of_samples else None,
        )
        for k, (a, b) in enumerate(found)
    ]


def adjusted(p: ArrayLike, rivals: ArrayLike) -> Array:
    """P-values (k,) of pairs of methods, each adjusted for all pairs of its scenario (Bonferroni).

    The family of a pair is all pairs of the methods of its scenario: those that the suite lists, or
    that one run of either method holds, if these are more. So p does not depend on runs of other
    methods that are shown, or on how a comparison is split into runs.

    Args:
        rivals: (k,) number of methods of each pair's scenario.
    """
    methods = np.maximum(np.asarray(rivals, dtype=np.float64), 2)  # a pair is of two
    return np.asarray(np.minimum(1.0, np.asarray(p) * methods * (methods - 1) / 2))


def _wins(difference: Array) -> float | None:
    """The share of samples on which the `difference` is more than 0, equals counting half."""
    known = difference[~np.isnan(difference)]
    return float(((known > 0) + 0.5 * (known == 0)).mean()) if len(known) else None


def groups(count: int, apart: Iterable[tuple[int, int]]) -> list[str]:
    """Letters of `count` methods, the best first: two share one unless they are told `apart`.

    Source: Piepho, An Algorithm for a Letter-Based Representation of All-Pairwise Comparisons,
    Journal of Computational and Graphical Statistics 13(2), 2004 (insert and absorb).
    """
    together = [frozenset(range(count))]
    for both in map(set, apart):
        split = [of - {one} for of in together if both <= of for one in both]
        rest = [of for of in together if not both <= of]
        # What lies within another says nothing more.
        for of in sorted(split, key=len, reverse=True):
            if not any(of <= other for other in rest):
                rest.append(of)
        together = rest
    letters = [""] * count
    for number, members in enumerate(sorted(map(sorted, together))):
        turn, place = divmod(number, 26)  # a to z, then a2 to z2, and so on
        for k in members:
            letters[k] += chr(ord("a") + place) + (str(turn + 1) if turn else "")
    return letters


def weights_won(cells: Sequence[pd.DataFrame]) -> Array | None:
    """Share (k,) of the weightings of SSIM, CC, RIE and PSNR under which each cell is the best.

    Weights are spread evenly over all that are not negative and sum up to 1; the figures lie
    between their anchors, so that a weight means the same for each. None where there is no truth
    to compute them with. Where no figure passes its anchors, S as published is one of these
    weightings: see `score_weights`.
    """
    if any(name not in cell for cell in cells for name in ANCHORS):
        return None
    figures = [{name: numbers(cell, name) for name in ANCHORS} for cell in cells]
    if any(np.isnan(values).any() for of in figures for values in of.values()):
        return None
    parts = np.array([anchored(of).mean(axis=0) for of in figures])
    weights = np.random.default_rng(0).dirichlet(np.ones(len(ANCHORS)), size=WEIGHTINGS)
    totals = np.round(weights @ parts.T, _DIGITS)
    best = totals == totals.max(axis=1, keepdims=True)
    share: Array = (best / best.sum(axis=1, keepdims=True)).mean(axis=0)
    return share


def score_weights() -> dict[str, float]:
    """The weights of S as published among the weightings of `weights_won`.

    S adds a quarter of each figure in its own unit, so that each weighs as its anchors are apart.
    """
    spans = {name: abs(high - low) for name, (low, high) in ANCHORS.items()}
    return {name: span / sum(spans.values()) for name, span in spans.items()}
