"""The board of the Kuopio Tomography Challenge 2023: scores summed over its 21 targets."""

from collections.abc import Sequence
from typing import NamedTuple

from eitbench.benchmark.analysis.leaderboard import Row

SCENARIO = "ktc2023-level{}"
LEVELS = tuple(range(1, 8))
TARGETS = 3
"""Of a level."""
LEGEND = (
    f"KTC2023, scores summed over {TARGETS} targets a level, {TARGETS * len(LEVELS)} in all. Open "
    "test: all truths are public. "
    "Published, not run here: official results, Denker et al., arXiv 2407.01559, Table 2; the "
    "organisers' baseline: results of their codes in LJK666666666/EIT_KTC2023_4."
)

PUBLISHED = {
    "Post-processing U-Net": (2.76, 2.56, 2.54, 1.71, 2.06, 1.92, 1.69, 15.24),
    "Fully connected U-Net": (2.72, 2.64, 2.31, 1.80, 2.06, 2.07, 1.53, 15.13),
    "Conditional diffusion": (2.67, 2.49, 2.47, 1.61, 1.94, 1.76, 1.65, 14.60),
    "Team ABC": (2.75, 2.37, 2.07, 1.74, 1.08, 1.53, 1.22, 12.75),
    "Team DTU": (2.28, 2.30, 1.87, 1.55, 1.34, 1.44, 1.60, 12.45),
    "Organisers' baseline": (2.55, 2.14, 1.55, 1.41, 1.13, 0.58, 0.93, 10.29),
}
"""Scores by level, and the sum, as published: of team DTU the levels add up to 12.38."""


class ChallengeRow(NamedTuple):
    """Scores of a method by level, and their sum; `track` is "published" of what was not run."""

    method: str
    track: str
    levels: tuple[float, ...]
    total: float


def challenge_rows(rows: Sequence[Row]) -> list[ChallengeRow]:
    """The methods with scores of all targets of all levels and the published ones, best first.

    Empty where no method has them all. What failed is charged an image of the untouched sensor.
    """
    scores: dict[tuple[str, str, str], dict[str, float]] = {}
    for row in rows:
        if row.get("ktc_score") is not None and row["n"] == TARGETS:
            of = scores.setdefault((row["method"], row["track"], row["run"]), {})
            of[row["scenario"]] = TARGETS * row["ktc_score"]
    names = [SCENARIO.format(level) for level in LEVELS]
    ours = [
        ChallengeRow(method, track, levels, sum(levels))
        for (method, track, _), of in scores.items()
        if of.keys() >= set(names)
        for levels in [tuple(of[name] for name in names)]
    ]
    if not ours:
        return []
    published = [ChallengeRow(n, "published", s[:-1], s[-1]) for n, s in PUBLISHED.items()]
    return sorted([*ours, *published], key=lambda row: -row.total)


def challenge_table(rows: Sequence[ChallengeRow]) -> list[list[str]]:
    """The heads, then the texts of each row."""
    heads = ["Method", "Track", *(f"Level {level}" for level in LEVELS), "Sum"]
    return [
        heads,
        *([r.method, r.track, *(f"{s:.2f}" for s in (*r.levels, r.total))] for r in rows),
    ]
