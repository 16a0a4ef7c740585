"""Training: what is learned from a scenario's data, by one loop that survives being killed."""

from pathlib import Path

from eitbench.methods.training.learned import (
    METHODS,
    SHIPPED,
    Choices,
    LearnedTraining,
    train_learned,
)
from eitbench.methods.training.loop import TrainingInterruptedError
from eitbench.methods.training.recipe import ONE_DEVICE, Devices
from eitbench.methods.training.surrogate import SurrogateTraining, train_surrogate
from eitbench.scenarios.errors import InputError, unknown_name

__all__ = ["Choices", "Devices", "TrainingInterruptedError", "train"]


def train(
    name: str,
    suite: str,
    *,
    epochs: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: Path | None = None,
    devices: Devices = ONE_DEVICE,
    choices: Choices = SHIPPED,
    progress: bool = False,
) -> SurrogateTraining | LearnedTraining:
    """Train what is called `name` on the data of `suite`; see `train_learned`, `train_surrogate`.

    Raises:
        InputError: nothing of that name can be trained, or not with these choices.
    """
    if name == "surrogate":
        if choices != SHIPPED:
            raise InputError(f"Training of 'surrogate' takes no{choices.arguments()}.")
        return train_surrogate(
            suite, epochs=epochs, seed=seed, jobs=jobs, out=out, devices=devices, progress=progress
        )
    if name not in METHODS:
        raise unknown_name("name to train", name, [*METHODS, "surrogate"])
    return train_learned(
        name,
        suite,
        epochs=epochs,
        seed=seed,
        jobs=jobs,
        out=out,
        devices=devices,
        choices=choices,
        progress=progress,
    )
