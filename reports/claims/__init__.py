"""Published claims, their verdicts, the ledger."""
