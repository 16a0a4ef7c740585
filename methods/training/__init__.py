"""Training: what is learned from a scenario's data, by one loop that survives being killed."""

from pathlib import Path

from eitbench.methods.training.loop import TrainingInterruptedError
from eitbench.methods.training.surrogate import SurrogateTraining, train_surrogate
from eitbench.scenarios.errors import unknown_name

__all__ = ["TrainingInterruptedError", "train"]

TRAINABLE = {"surrogate": train_surrogate}


def train(
    name: str,
    suite: str,
    *,
    epochs: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    out: Path | None = None,
    progress: bool = False,
) -> SurrogateTraining:
    """Train what is called `name` on the data of `suite`; see `train_surrogate`.

    Raises:
        InputError: nothing of that name can be trained.
    """
    if name not in TRAINABLE:
        raise unknown_name("name to train", name, TRAINABLE)
    return TRAINABLE[name](suite, epochs=epochs, seed=seed, jobs=jobs, out=out, progress=progress)
