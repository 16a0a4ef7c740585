"""Published claims, the rules that test them, and the ledger of their verdicts."""
