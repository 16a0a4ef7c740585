"""The claims as they are declared."""

from tests.reports.claims.conftest import NAMES, findings

from eitbench.reports.claims.claim import (
    Verdict,
)
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS


def test_every_claim_says_what_it_is() -> None:
    assert len(set(NAMES)) == len(NAMES)
    for claim in CLAIMS:
        assert claim.says.endswith(".")
        assert claim.tolerance
        # What nobody outside can measure has neither figures nor a command.
        assert bool(claim.published) == claim.command.startswith("eitbench ")


def test_without_runs_nothing_is_testable_and_the_published_figures_stand() -> None:
    for claim in CLAIMS:
        found = claim.judgement(Evidence([]))
        assert found.verdict is Verdict.untestable
        assert found.figures == claim.published
        assert all(figure.ours is None and figure.verdict is None for figure in found.figures)
        assert found.why.endswith(".")
    assert "'phydnn'" in findings()["table2-phydnn"].why
