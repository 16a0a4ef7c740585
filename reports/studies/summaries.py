"""Summaries of studies, as `eitbench study` leaves them."""

import json
from pathlib import Path
from typing import Any

from eitbench.benchmark import InputError

Row = dict[str, Any]


def read_study(folder: Path) -> Row:
    """What `write_study` wrote of the study in `folder`.

    Raises:
        InputError: it holds no finished study.
    """
    try:
        summary: Row = json.loads((folder / "summary.json").read_text())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{folder} holds no finished study: run `eitbench study` with --out {folder}."
        ) from error
    return summary


def budget(summary: Row) -> str:
    """What the trainings of a study were, in words."""
    samples = "all" if summary["limit"] is None else f"{summary['limit']:,}"
    epochs = "the published" if summary["epochs"] is None else summary["epochs"]
    scored = "all" if summary["scored"] is None else f"the first {summary['scored']:,}"
    return (
        f"trainings on {samples} samples of {summary['suite']!r} for {epochs} epochs, scored on "
        f"{scored} samples of each scenario; {summary['training_hours']:.3g} hours in all"
    )
