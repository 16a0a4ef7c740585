"""Summaries of studies: those that come with the package, and your own."""

import json
from importlib.resources import files
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
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder} holds no finished study: run `eitbench study` with --out {folder}."
        ) from error
    return summary


def packaged_studies() -> dict[str, Row]:
    """The summaries of the studies that come with the package, by name."""
    folder = files("eitbench.reports") / "studies"
    found = [json.loads(file.read_text()) for file in folder.iterdir() if file.name[-5:] == ".json"]
    return {summary["study"]: summary for summary in found}


def budget(summary: Row) -> str:
    """What the trainings of a study were, in words."""
    samples = "all" if summary["limit"] is None else f"{summary['limit']:,}"
    epochs = "the published" if summary["epochs"] is None else summary["epochs"]
    judged = "all" if summary["judged"] is None else f"the first {summary['judged']:,}"
    return (
        f"trainings on {samples} samples of {summary['suite']!r} for {epochs} epochs, judged on "
        f"{judged} samples of each scenario; {summary['training_hours']:.3g} hours in all"
    )
