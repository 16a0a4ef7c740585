"""Hyper-parameters selected on the validation split, with one budget for all methods."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.tuning.selection import recorded_selection
    from eitbench.benchmark.tuning.tuner import tune

__all__ = ["recorded_selection", "tune"]

# Tuning loads Optuna, which a run with selected parameters does not need.
__getattr__, __dir__ = lazy_names(__name__, {"recorded_selection": "selection", "tune": "tuner"})
