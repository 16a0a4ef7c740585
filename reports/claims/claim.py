"""Published claims, and the findings of their evaluation."""

from collections.abc import Callable
from dataclasses import dataclass, field

from eitbench.reports.claims.evidence import Evidence, NotMeasuredError
from eitbench.reports.claims.verdicts import Verdict


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
