"""Runs that others submit to the leaderboard: checked, run again, and judged on hidden sets."""
