"""Tiers of results: how far somebody else has made them again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.submissions.hidden import (
    Gap,
    gap_of,
    is_retired,
    published_keys,
    read_hidden,
)
from eitbench.benchmark.submissions.rerun import digest, reproduced
from eitbench.benchmark.submissions.statement import STATEMENT
from eitbench.benchmark.submissions.submission import FOLDER
from eitbench.benchmark.submissions.sums import is_noted

Tier = Literal["self-reported", "reproduced", "hidden"]
"""The images are its author's; we made them again from code; we also ran it on a hidden set."""


@dataclass(frozen=True)
class TierOf:
    """The tier of a method of a run on a scenario.

    Attributes:
        tier: the highest that it has reached.
        reproduced_on: what was run again, such as "32 of 36 samples"; "" where nothing was.
        gap: between the open and the hidden set; None below the tier "hidden".
        key_published: True if the key of that hidden set is retired, so that anybody can draw it.
    """

    tier: Tier
    reproduced_on: str
    gap: Gap | None
    key_published: bool = False


def is_submission(run: Path) -> bool:
    """True if the folder of a run is a submission, whose times are its author's in any tier."""
    return (run / STATEMENT).is_file()


def board_of(run: Path) -> Path | None:
    """Return the version of the leaderboard that the folder of a run is in, if it is in one.

    A record is `VERSION/SUITE`, a submission `VERSION/submissions/SUITE/NAME`.
    """
    parents = run.resolve().parents
    if is_submission(run):
        return parents[2] if len(parents) > 2 and parents[1].name == FOLDER else None
    return parents[0]


def tier(run: Run, scenario: str, method: str) -> TierOf:
    """Return the tier of a method of `run`, by what lies beside the run.

    A record that `eitbench board` keeps was run by us. What was reproduced of other runs is noted
    in a file beside their folders, see `rerun`.

    Raises:
        DataCorruptError: a file beside the run is damaged.
    """
    told = reproduced_on(run)
    board = board_of(run.path)
    if told and board is not None:
        keys = published_keys(board)
        # With a key that is still secret first, and of equal ones the newest.
        records = [(is_retired(keys, record.key), record) for record in read_hidden(board)[::-1]]
        for retired, record in sorted(records, key=lambda of: of[0]):
            if gap := gap_of([record], run, scenario, method):
                return TierOf("hidden", told, gap, retired)
    return TierOf("reproduced" if told else "self-reported", told, None)


def is_ranked(run: Run) -> bool:
    """False of a submission that is self-reported: nobody but its author has seen its method run.

    Raises:
        DataCorruptError: a file beside the run is damaged.
    """
    return not is_submission(run.path) or bool(reproduced_on(run))


def reproduced_on(run: Run) -> str:
    """Return what was run again of a run, such as "32 of 36 samples"; "" where nothing was.

    All of a record was run by us, if a version of the board has noted its files.

    Raises:
        DataCorruptError: the file beside the run is damaged, or a file of the record has changed.
    """
    if not run.whole:
        return "all samples, by the maintainers" if is_noted(run.path.resolve()) else ""
    return reproduced(run.path.resolve().parent).get(digest(run.path), "")
