"""Published claims, the rules that test them, and the ledger of their verdicts."""

from eitbench.reports.claims.claim import Claim, Figure, Judgement, Verdict
from eitbench.reports.claims.ledger import Ledger, claim_ledger
from eitbench.reports.claims.published_claims import CLAIMS

__all__ = ["CLAIMS", "Claim", "Figure", "Judgement", "Ledger", "Verdict", "claim_ledger"]
