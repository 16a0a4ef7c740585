"""Samples to learn from, as tensors of torch."""

import torch
from torch.utils.data import TensorDataset

from eitbench.methods.problem import Problem
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.scenario import SimulatedScenario


def training_data(
    source: str | SimulatedScenario | Problem, n: int | None = None, *, split: str = "train"
) -> TensorDataset:
    """Return the first `n` samples of a split as a torch data set, for a `DataLoader`.

    A pair holds a frame minus its reference frame (M,) [V/A], and the conductivity (H, W) [S/m],
    both float32 and writable. They are always the same samples: simulated, the first ones first.

    Args:
        source: a scenario, its name, or the problem that a method is fitted to.
        n: number of samples; all by default.
        split: "train" or "validation"; never "test".

    Raises:
        InputError: an unknown scenario, one without such samples, or one whose conductivity is not
            known.
    """
    if split not in ("train", "validation"):
        raise InputError(f"Learn from the split 'train' or 'validation', not from {split!r}.")
    if not isinstance(source, Problem):
        first = load(source, split=split, limit=1)
        scenario = source
        source = Problem(
            first.sensor,
            first.references[0],
            lambda of, limit: load(scenario, split=of, limit=limit),
        )
    data = source.validation(n) if split == "validation" else source.training(n)
    if data.conductivity is None:
        raise InputError(
            f"Scenario {data.scenario!r} has no true images: learn from a simulated one."
        )
    return TensorDataset(
        torch.tensor(source.differences(data), dtype=torch.float32),
        torch.tensor(data.conductivity, dtype=torch.float32),
    )
