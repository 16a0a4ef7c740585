"""The record of a method that is too slow for all presses of the suite `skins`, from a stored run.

`python -m docs.studies.skins.record RUN` writes `tv.csv`: of each skin, the number of its first
presses that the run has, and the median error of the place. The run is one of `tv` with `--limit`.
"""

import sys
from pathlib import Path

from docs.tables.record import record

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.few_bytes import FRAME_DIGITS
from eitbench.scenarios.errors import InputError


def write(run: Path) -> None:
    """Write the record of a run directory.

    Raises:
        InputError: the run has presses that the record of the leaderboard does not have.
    """
    samples = read_run(run).samples
    frames = record("skins").samples["input_hash"]
    if not samples["input_hash"].str[:FRAME_DIGITS].isin(set(frames)).all():
        raise InputError(f"{run} has other presses than the record of skins: run it again.")
    errors = samples.groupby("scenario")["localisation_mm"].agg(["count", "median"])
    errors.to_csv(Path(__file__).with_name("tv.csv"), float_format="%.5g")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
