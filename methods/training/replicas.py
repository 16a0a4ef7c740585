"""Replicas of a training on several devices, which share every batch."""

from __future__ import annotations

import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import joblib
import torch
from torch import Tensor, distributed

if TYPE_CHECKING:
    import numpy as np

    from eitbench.methods.training.request import Devices


@dataclass(frozen=True)
class Replica:
    """One of `count` processes that train the same network, each on a device of its own.

    Attributes:
        device: its device.
        rank: its number, from 0.
    """

    device: torch.device
    rank: int = 0
    count: int = 1

    @property
    def device_name(self) -> str:
        """The name of its GPU, or "cpu"."""
        if self.device.type == "cuda":
            return torch.cuda.get_device_name(self.device)
        return self.device.type

    def seed(self, rng: np.random.Generator) -> int:
        """Return its own of the seeds that all replicas draw."""
        return int(rng.integers(2**63, size=self.count)[self.rank])

    def shares(self, order: Tensor, batch: int) -> list[Tensor]:
        """Return its share of every batch of the samples (n,) in `order`.

        A last batch that has not a sample for everybody is left out.
        """
        parts = torch.split(order, batch)
        return [part[self.rank :: self.count] for part in parts if len(part) >= self.count]

    def average_gradients(self, parameters: Sequence[Tensor]) -> None:
        """Give all replicas the mean of their gradients."""
        if self.count > 1:
            gradients = [p.grad for p in parameters if p.grad is not None]
            together = torch.cat([gradient.flatten() for gradient in gradients]) / self.count
            distributed.all_reduce(together)
            sizes = [gradient.numel() for gradient in gradients]
            for gradient, mean in zip(gradients, torch.split(together, sizes), strict=True):
                gradient.copy_(mean.view_as(gradient))

    def mean(self, total: Tensor, count: int) -> float:
        """Return the mean over all replicas of the sum `total` of `count` values."""
        sums = torch.stack([total, torch.full_like(total, count)])
        if self.count > 1:
            distributed.all_reduce(sums)
        return float(sums[0] / sums[1])


@contextmanager
def replicas(
    devices: Devices, run: Callable[..., Iterator[object]], arguments: Sequence[Any]
) -> Iterator[Replica]:
    """Run `run(*arguments, replica, moved)` for all devices but the first; yield the first.

    The others run in processes of their own, beside the body of the `with` statement.
    """
    cuda = devices.kind == "cuda" or (devices.kind == "auto" and torch.cuda.is_available())
    first, *others = (
        Replica(torch.device("cuda", rank) if cuda else torch.device("cpu"), rank, devices.count)
        for rank in range(devices.count)
    )
    if not others:
        yield first
        return
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        # With one job for each device, none of which waits: a single job would run in this process.
        running = joblib.Parallel(n_jobs=devices.count, return_as="generator")(
            joblib.delayed(_run)(replica, store, run, arguments) for replica in others
        )
        try:
            with _process_group(first, store):
                yield first
            deque(running, maxlen=0)  # their errors, if any
        finally:
            running.close()


def _run(
    replica: Replica, store: Path, run: Callable[..., Iterator[object]], arguments: Sequence[Any]
) -> None:
    with _process_group(replica, store):
        deque(run(*arguments, replica, lambda epochs: None), maxlen=0)


@contextmanager
def _process_group(replica: Replica, store: Path) -> Iterator[None]:
    distributed.init_process_group(
        "nccl" if replica.device.type == "cuda" else "gloo",
        init_method=store.as_uri(),
        rank=replica.rank,
        world_size=replica.count,
    )
    try:
        yield
    finally:
        distributed.destroy_process_group()
