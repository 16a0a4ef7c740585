"""The rules by which a published figure gets its verdict: pure functions of numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from eitbench.benchmark.metrics.statistics import Interval

Best = Literal["max", "min"]


class Verdict(StrEnum):
    """Results of testing a published claim."""

    holds = "holds"
    in_part = "holds in part"
    fails = "does not hold"
    untestable = "not testable"


@dataclass(frozen=True)
class Tolerance:
    """Largest allowed distance of a figure from a published one.

    Attributes:
        absolute: in the figure's unit.
        relative: as a share of the published figure.
    """

    absolute: float = 0.0
    relative: float = 0.0

    def margin(self, published: float) -> float:
        """The distance that is allowed from `published`, >= 0."""
        return self.absolute + self.relative * abs(published)


def agrees(ours: float, published: float, tolerance: Tolerance) -> bool:
    """True if `ours` lies within the tolerance of `published`, on either side."""
    return abs(ours - published) <= tolerance.margin(published)


def reaches(ours: float, published: float, tolerance: Tolerance, best: Best) -> bool:
    """True if `ours` is as good as `published` within the tolerance, or better."""
    return agrees(ours, published, tolerance) or better(ours - published, best)


def better(difference: float, best: Best) -> bool:
    """True if a `difference` is one for the better."""
    return difference > 0 if best == "max" else difference < 0


def surely_better(difference: Interval, best: Best) -> bool:
    """True if the whole interval of a `difference` lies on the better side of 0."""
    return better(difference.low, best) and better(difference.high, best)


def together(met: Sequence[bool]) -> Verdict:
    """Return the verdict on a claim of several figures: all, some or none of them met."""
    if all(met):
        return Verdict.holds
    return Verdict.in_part if any(met) else Verdict.fails
