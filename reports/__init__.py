"""How it is shown: leaderboards and figures made from stored results."""
