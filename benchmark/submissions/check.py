"""Checks of a run that is submitted to a leaderboard: complete, on our data, scored by us.

Nothing that the directory says of itself is believed where it can be had otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.submissions.figure_checks import (
    curves_follow,
    failures_are_reported,
    frames_are_ours,
    is_plausible,
    leaderboard_follows,
    notes_are_ours,
    registrations_are_ours,
    scores_are_ours,
    statements_are_whole,
)
from eitbench.benchmark.submissions.run_checks import (
    files_hold_nothing_else,
    holds_nothing_else,
    is_complete,
    is_packaged,
    learned_apart,
    measured_is_possible,
    names_are_clear,
    names_its_version,
    says_who,
    tracks_are_ranked,
)
from eitbench.benchmark.submissions.submission import Submission
from eitbench.scenarios.errors import EitbenchError


@dataclass(frozen=True)
class Check:
    """One thing that was checked of a submission.

    Attributes:
        name: what was checked.
        problem: what is wrong, as a sentence; "" where nothing is.
        refutes: true if the method was run again, and is not what the run says.
    """

    name: str
    problem: str
    refutes: bool = False


def check_submission(submission: Submission) -> list[Check]:
    """Check a submission by all `CHECKS`, or to the first of `FIRST` that it fails."""
    found = []
    for name, check in CHECKS.items():
        found.append(Check(name, _problem(check, submission)))
        if check in FIRST and found[-1].problem:
            break
    return found


def _problem(check: Callable[[Submission], str], submission: Submission) -> str:
    """Problem that `check` finds; what it cannot read is one."""
    try:
        return check(submission)
    except EitbenchError as error:
        return str(error)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return (
            f"The {manifests.FILE_NAME} or a table lacks an entry that every run writes ({error}): "
            "send what the run wrote."
        )


FIRST = (
    holds_nothing_else,
    says_who,
    is_packaged,
    names_its_version,
    names_are_clear,
    is_complete,
)
"""What fails one of these is not looked at any further."""

CHECKS: dict[str, Callable[[Submission], str]] = {
    "the directory holds what a run writes": holds_nothing_else,
    "its author says what is asked": says_who,
    "the suite is one of eitbench's": is_packaged,
    "it names its version of eitbench": names_its_version,
    "names are clear": names_are_clear,
    "every sample of every method has its row": is_complete,
    "tables and images hold what a run writes": files_hold_nothing_else,
    "times and memory are possible": measured_is_possible,
    "tracks are ranked": tracks_are_ranked,
    "no test samples were learned from": learned_apart,
    "frames, truth and geometry are ours": frames_are_ours,
    "registrations and load calibrations are those of the stored images": registrations_are_ours,
    "figures are those of the stored images": scores_are_ours,
    "stated uncertainty and novelty are of all frames": statements_are_whole,
    "curves of stated uncertainty follow from its figures": curves_follow,
    "failures are reported": failures_are_reported,
    "notes on recordings are ours": notes_are_ours,
    "the leaderboard follows from the figures": leaderboard_follows,
    "figures are plausible": is_plausible,
}
