"""What a published claim is, and what becomes of one."""

from collections.abc import Callable
from dataclasses import dataclass, field

from eitbench.reports.claims.evidence import Evidence, NotMeasuredError
from eitbench.reports.claims.verdicts import Verdict


@dataclass(frozen=True)
class Figure:
    """A published figure beside ours.

    Attributes:
        name: what is measured, with its unit.
        published: words where only words are known to us; None where nothing is.
        ours: None where it was not measured.
        interval: ends of the 95 % interval of `ours`, if it has one.
        kept: whether ours is as the rule asks; None where it was not judged.
    """

    name: str
    published: float | str | None
    ours: float | None = None
    interval: tuple[float, float] | None = None
    kept: bool | None = None


@dataclass(frozen=True)
class Finding:
    """What becomes of a claim.

    Attributes:
        figures: the published ones beside ours.
        why: a sentence or two.
        n: number of samples that ours rest on; None where there are none.
        conditions: what ours rest on, in words.
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
        source: where it stands in the paper.
        says: the claim in words.
        published: its figures, beside which ours come.
        tolerance: the rule of the verdict, in words.
        command: what measures it.
        evaluate: applies the rule to what was measured.
    """

    name: str
    source: str
    says: str
    published: tuple[Figure, ...]
    tolerance: str
    command: str
    evaluate: Callable[[Evidence], Finding] = field(repr=False)

    def finding(self, evidence: Evidence) -> Finding:
        """What becomes of it: not testable, with the reason, where something was not measured.

        Raises:
            InputError: several runs hold the same method or operator.
        """
        try:
            return self.evaluate(evidence)
        except NotMeasuredError as missing:
            return Finding(Verdict.untestable, self.published, str(missing))
