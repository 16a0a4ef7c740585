"""Published claims, their verdicts, and the findings of their evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.claims.evidence import Evidence, NotMeasuredError

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


def agrees(ours: float, published: float, tolerance: Tolerance) -> bool:
    """True if `ours` lies within the tolerance of `published`, on either side."""
    return abs(ours - published) <= tolerance.absolute + tolerance.relative * abs(published)


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


@dataclass(frozen=True)
class Figure:
    """A published figure beside ours.

    Attributes:
        name: what is measured, with its unit.
        published: text where no number is known to us; None where nothing is.
        ours: None where it was not measured.
        interval: ends of the 95 % interval of `ours`, if it has one.
        met: True if ours meets the rule of the claim; None where it was not tested.
    """

    name: str
    published: float | str | None
    ours: float | None = None
    interval: tuple[float, float] | None = None
    met: bool | None = None


@dataclass(frozen=True)
class Finding:
    """The verdict on a claim, with its reasons.

    Attributes:
        figures: the published ones beside ours.
        why: a sentence or two.
        n: number of samples that ours rest on; None where there are none.
        conditions: description of the samples, or trainings, that ours rest on.
    """

    verdict: Verdict
    figures: tuple[Figure, ...]
    why: str
    n: int | None = None
    conditions: str = ""


@dataclass(frozen=True)
class Claim:
    """A published claim.

    Attributes:
        name: for programs and links.
        source: its place in the paper.
        says: the claim as a sentence.
        published: its figures, without ours.
        tolerance: the rule of the verdict, as text.
        command: the command that measures it.
        evaluate: applies the rule to the evidence.
    """

    name: str
    source: str
    says: str
    published: tuple[Figure, ...]
    tolerance: str
    command: str
    evaluate: Callable[[Evidence], Finding] = field(repr=False)

    def finding(self, evidence: Evidence) -> Finding:
        """Return the verdict: not testable, with the reason, where something was not measured.

        Raises:
            InputError: several runs hold the same method or operator.
        """
        try:
            return self.evaluate(evidence)
        except NotMeasuredError as missing:
            return Finding(Verdict.untestable, self.published, str(missing))
