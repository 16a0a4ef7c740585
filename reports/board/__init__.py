"""The leaderboard in the repository, by version; nothing of it is ever edited.

`VERSION/SUITE` are records of whole runs: run directories whose tables are whole and whose images
are those that reports show, see `records`. `VERSION/submissions/SUITE/NAME` are the runs of others,
see `submissions`. `VERSION/hidden` has figures on hidden sets, a file for each run, and
`hidden.toml` the hashes of the keys that draw them. All is said in `docs/board.md`.
"""
