"""Training: what is learned from a scenario's data, by one loop that survives being killed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.methods.training.learned import train_learned
from eitbench.methods.training.loop import TrainingInterruptedError
from eitbench.methods.training.recipe import Devices
from eitbench.methods.training.refined import train_refined
from eitbench.methods.training.request import Request
from eitbench.methods.training.surrogate import train_surrogate
from eitbench.scenarios.errors import unknown_name

if TYPE_CHECKING:
    from eitbench.methods.training.job import Training

__all__ = ["Devices", "Request", "TrainingInterruptedError", "train"]

TRAINERS = {
    "dnn": train_learned,
    "phydnn": train_learned,
    "coarse-to-fine": train_refined,
    "learned-gn": train_refined,
    "surrogate": train_surrogate,
}


def train(request: Request) -> Training:
    """Train what is asked for, or continue, and put the weights in use.

    Raises:
        InputError: nothing of that name can be trained, or not with these choices; a suite without
            training samples or with several sensors; too few samples; `out` holds a training with
            other settings; weights that it builds on are missing.
        DataCorruptError: what `out` holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same request continues.
        DivergedError: a loss is not finite; the last good state is kept.
        EitbenchError: a folder is not writable or full.
    """
    if request.name not in TRAINERS:
        raise unknown_name("name to train", request.name, TRAINERS)
    return TRAINERS[request.name](request)
