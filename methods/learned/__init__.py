"""Reconstruction with parameters learned from simulated data."""

from eitbench.methods.learned.image_networks import Dnn, PhyDnn, TrainedMethod
from eitbench.methods.learned.linear_learned import LinearLearned
from eitbench.methods.learned.linear_touch import LinearTouch
from eitbench.methods.learned.refined import CoarseToFine, LearnedGaussNewton

__all__ = [
    "CoarseToFine",
    "Dnn",
    "LearnedGaussNewton",
    "LinearLearned",
    "LinearTouch",
    "PhyDnn",
    "TrainedMethod",
]
