"""Analyses of stored runs: leaderboards, standings, comparisons."""
