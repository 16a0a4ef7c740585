"""Training of the networks that methods and operators use, by one loop that can be interrupted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.methods.registry import METHOD_REGISTRY, OPERATOR_REGISTRY
from eitbench.methods.training.request import (
    DivergedError,
    Recipe,
    Trainable,
    TrainingInterruptedError,
    TrainingRequest,
)
from eitbench.scenarios.errors import InputError, unknown_name

if TYPE_CHECKING:
    from eitbench.methods.training.job import TrainingResult

__all__ = [
    "DivergedError",
    "Recipe",
    "Trainable",
    "TrainingInterruptedError",
    "TrainingRequest",
    "train",
]


def train(request: TrainingRequest) -> TrainingResult:
    """Train what is asked for, or continue, and put the weights in use.

    Raises:
        InputError: nothing of that name can be trained, or not with these options; a suite without
            training samples or with several sensors; too few samples; `out` holds a training with
            other settings; weights that it builds on are missing.
        DataCorruptError: the checkpoint in `out` is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same request continues.
        DivergedError: a loss is not finite; the last good state is stored.
        EitbenchError: a folder is not writable or full.
    """
    from eitbench.methods.training.job import TrainingJob

    known = METHOD_REGISTRY.known() | OPERATOR_REGISTRY.known()
    trainable = {name: cls for name, cls in known.items() if issubclass(cls, Trainable)}
    if request.name in known and request.name not in trainable:
        raise InputError(
            f"{request.name!r} has no training of its own; these have: {', '.join(trainable)}."
        )
    if request.name not in trainable:
        raise unknown_name("name to train", request.name, trainable)
    model = trainable[request.name]
    request.check_options(model.options)
    return model.train(TrainingJob(request, model))
