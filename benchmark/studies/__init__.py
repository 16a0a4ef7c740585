"""Experiments of many runs or trainings: training studies, published claims, real presses."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.studies.reproduce import run_claims
    from eitbench.benchmark.studies.training_study import run_study

__all__ = ["run_claims", "run_study"]

# Studies load PyTorch, which published claims do not need.
__getattr__, __dir__ = lazy_names(
    __name__, {"run_claims": "reproduce", "run_study": "training_study"}
)
