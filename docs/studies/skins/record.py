"""The record of the suite `skins`: figures, the board over skins and the maps, from stored runs.

`python docs/studies/skins/record.py RUN...` writes this folder anew, of which `make tables` makes
the tables of docs/results/skins.md. Runs with `--limit` make a record of their own, `part.csv`: all
methods on the presses of those runs.
"""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from eitbench.benchmark.analysis.leaderboard import is_whole, ranked_boards
from eitbench.benchmark.analysis.overall import overall
from eitbench.benchmark.analysis.results import GUESS, Run, read_run
from eitbench.reports.figures.error_maps import error_maps_figure
from eitbench.reports.figures.style import PAGE, STYLE, save
from eitbench.reports.page.error_maps import error_maps

OUT = Path(__file__).resolve().parent
_COLUMNS = ("scenario", "method", "track", "n", "coverage", "data_hash", *GUESS.values(), *GUESS)
_RUN = ("started", "git_commit", "versions", "machine", "threads")


def write(paths: list[Path]) -> None:
    """Write the record of run directories."""
    read = [read_run(path) for path in paths]
    runs = [run for run in read if run.manifest["plan"]["limit"] is None]
    parts = [run for run in read if run not in runs]
    rows, panels, figures, guesses = [], [], {}, {}
    for board in ranked_boards(runs):
        skin = board[0].row["scenario"]
        whole = {of.row["method"]: of for of in board if is_whole(of.row)}
        rows += [{name: of.row[name] for name in _COLUMNS} for of in whole.values()]
        figures[skin] = {name: -of.row["localisation_mm"] for name, of in whole.items()}
        guesses[skin] = board[0].row["guess_mm"]
        methods = {name: (of.run, name) for name, of in whole.items()}
        about = error_maps(methods, {name: of.cell for name, of in whole.items()}, skin)
        assert about is not None
        panels.append((skin, about, about["maps"][0]))
    found = overall(figures, guesses)
    assert found is not None
    about = {
        "command": "eitbench run skins",
        "runs": [{name: run.manifest[name] for name in _RUN} for run in read],
        "overall": asdict(found),
    }
    OUT.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(OUT / "skins.csv", index=False, float_format="%.5g")
    (OUT / "skins.json").write_text(json.dumps(about, indent=1) + "\n")
    if parts:
        part(runs, parts).to_csv(OUT / "part.csv", index=False, float_format="%.5g")
    with mpl.rc_context(STYLE):
        save(error_maps_figure(panels, PAGE, 5), OUT / "maps", ("svg",))


def part(runs: list[Run], parts: list[Run]) -> pd.DataFrame:
    """The median error of every method on the presses that the runs with `--limit` have."""
    columns = ["scenario", "method", "input_hash", "localisation_mm"]
    some = pd.concat([run.samples for run in parts])
    rows = pd.concat([some, *(run.samples for run in runs)])[columns]
    rows = rows[rows["input_hash"].isin(some["input_hash"])]
    errors = rows.groupby(["scenario", "method"], as_index=False)["localisation_mm"]
    return errors.agg(["count", "median"])


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
