"""The leaderboard in the repository: `VERSION/SUITE` are records of whole runs, never edited.

A record is a run directory whose tables are whole and whose images are those that reports show; see
`records`. What the versions are, and how to make them, is said in `docs/board.md`.
"""
