"""Hyper-parameters selected on the validation split, with one budget for all methods."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.tuning.selection import (
        Selection,
        Trial,
        TuningBudget,
        recorded_selection,
        selected_parameters,
    )
    from eitbench.benchmark.tuning.tuner import tune

__all__ = [
    "Selection",
    "Trial",
    "TuningBudget",
    "recorded_selection",
    "selected_parameters",
    "tune",
]

# Tuning loads Optuna, which a run with selected parameters does not need.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Selection": "selection",
        "Trial": "selection",
        "TuningBudget": "selection",
        "recorded_selection": "selection",
        "selected_parameters": "selection",
        "tune": "tuner",
    },
)
