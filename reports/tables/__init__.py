"""Leaderboards as tables: for a terminal, and as Markdown, LaTeX, HTML, CSV and JSON."""

from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows, write_leaderboard

__all__ = ["FORMATS", "ranked_rows", "write_leaderboard"]
