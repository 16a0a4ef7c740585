"""Leaderboards as tables: for a terminal, and as Markdown, LaTeX, HTML, CSV and JSON."""
