"""Regression of the place of a single contact, without an image."""

from typing import TYPE_CHECKING

from eitbench.methods.places.kernel_ridge import KernelRidge, kernel_ridge
from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.methods.places.place_network import PlaceNetwork, TrainingPhase

__all__ = ["KernelRidge", "PlaceNetwork", "TrainingPhase", "kernel_ridge"]

# Networks need torch, which takes a second to import.
__getattr__, __dir__ = lazy_names(
    __name__, {"PlaceNetwork": "place_network", "TrainingPhase": "place_network"}
)
