"""Published claims, their verdicts, and the judgements of their evaluation."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from eitbench.benchmark.metrics.metric_spec import Best
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.claims.evidence import Evidence, NotMeasuredError


class Verdict(StrEnum):
    """Results of testing a published claim or one of its figures."""

    holds = "holds"
    in_part = "holds in part"
    fails = "does not hold"
    undecided = "undecided"
    untestable = "not testable"


LEAST_SAMPLES = 100
"""Fewer test samples decide nothing: their intervals are too narrow, and their phantoms few."""


@dataclass(frozen=True)
class Range:
    """Values that meet a claim; the ends themselves decide nothing."""

    low: float = -math.inf
    high: float = math.inf

    def test(self, interval: Interval, n: int) -> Verdict:
        """Test a figure by its whole interval: one that holds an end of the range is undecided."""
        if n < LEAST_SAMPLES or not math.isfinite(interval.low + interval.high):
            return Verdict.undecided
        if self.low < interval.low and interval.high < self.high:
            return Verdict.holds
        outside = interval.high < self.low or self.high < interval.low
        return Verdict.fails if outside else Verdict.undecided


def around(published: float, *, absolute: float = 0.0, relative: float = 0.0) -> Range:
    """Return the values as far from `published` as is allowed, on either side."""
    room = absolute + relative * abs(published)
    return Range(published - room, published + room)


def towards(best: Best, allowed: Range) -> Range:
    """Return the values in the `allowed` range and better ones."""
    return Range(allowed.low) if best == "max" else Range(high=allowed.high)


def better(best: Best) -> Range:
    """Return the differences that are for the better; 0 is none."""
    return Range(low=0.0) if best == "max" else Range(high=0.0)


def together(verdicts: Sequence[Verdict]) -> Verdict:
    """Return the verdict on a claim of several tested figures.

    The claim is about all of them, so that one that does not hold refutes it: it holds in part
    where another one does, or where one itself holds in part.
    """
    if Verdict.in_part in verdicts:
        return Verdict.in_part
    if Verdict.fails in verdicts:
        return Verdict.in_part if Verdict.holds in verdicts else Verdict.fails
    return Verdict.holds if {*verdicts} == {Verdict.holds} else Verdict.undecided


@dataclass(frozen=True)
class Figure:
    """A published figure beside ours.

    Attributes:
        name: what is measured, with its unit.
        published: None where no number is printed.
        ours: None where it was not measured.
        interval: ends of the 95 % interval of `ours`, if it has one.
        verdict: of this figure alone; None where it was not tested.
    """

    name: str
    published: float | None
    ours: float | None = None
    interval: list[float] | None = None
    verdict: Verdict | None = None


@dataclass(frozen=True)
class Judgement:
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
    evaluate: Callable[[Evidence], Judgement] = field(repr=False)

    def judgement(self, evidence: Evidence) -> Judgement:
        """Return the verdict: not testable, with the reason, where something was not measured.

        Raises:
            InputError: several runs hold the same method or operator.
        """
        try:
            return self.evaluate(evidence)
        except NotMeasuredError as missing:
            return Judgement(Verdict.untestable, self.published, str(missing))
