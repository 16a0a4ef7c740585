"""Summaries of studies, as `eitbench study` leaves them."""

import json
from pathlib import Path
from typing import Any, TypedDict

from eitbench.benchmark import InputError

StudyRow = dict[str, Any]
"""The choices of a training, or of two that are compared, and figures of what they give."""


class StudySummary(TypedDict):
    """The options of `eitbench study`, the time of all trainings, and the rows of the study.

    `epochs`, `limit` and `scored` are None for the published number and for all samples.
    """

    study: str
    suite: str
    epochs: int | None
    limit: int | None
    scored: int | None
    operator: str
    training_hours: float
    rows: list[StudyRow]


def read_study(folder: Path) -> StudySummary:
    """Read the summary that `write_study` left in `folder`.

    Raises:
        InputError: it holds no finished study.
    """
    try:
        summary: StudySummary = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{folder} holds no finished study: run `eitbench study` with --out {folder}."
        ) from error
    return summary


def training_budget(summary: StudySummary) -> str:
    """Describe the samples, epochs and hours of the trainings of a study."""
    samples = "all" if summary["limit"] is None else f"{summary['limit']:,}"
    epochs = "the published" if summary["epochs"] is None else summary["epochs"]
    scored = "all" if summary["scored"] is None else f"the first {summary['scored']:,}"
    return (
        f"trainings on {samples} samples of {summary['suite']!r} for {epochs} epochs, scored on "
        f"{scored} samples of each scenario; {summary['training_hours']:.3g} hours in all"
    )
