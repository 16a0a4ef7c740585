"""Training tasks: a network with the loss that it is trained by."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor, nn

Data = tuple[Tensor, ...]
"""Samples, along the first axis that all tensors have in common."""


class TrainingTask(nn.Module):
    """A network and the losses that it is trained and validated by.

    `training` is true while the network learns, and false in validation.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def optimizer(self) -> torch.optim.Optimizer:
        """Return Adam with decoupled weight decay; the loop sets its learning rate."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4)

    @abstractmethod
    def objective(self, batch: Data, epochs_done: int) -> tuple[Tensor, Tensor]:
        """Return what is minimised on a batch, and the loss that the curve shows, both ()."""

    @abstractmethod
    def losses(self, batch: Data) -> dict[str, Tensor]:
        """Return losses () of a batch by name; that named "" chooses the best epoch."""


class OneLossTask(TrainingTask):
    """A network with one loss, minimised on training and observed on validation samples."""

    @abstractmethod
    def loss(self, batch: Data) -> Tensor:
        """Return the mean loss () over a batch."""

    def objective(self, batch: Data, epochs_done: int) -> tuple[Tensor, Tensor]:
        """See `TrainingTask`."""
        loss = self.loss(batch)
        return loss, loss

    def losses(self, batch: Data) -> dict[str, Tensor]:
        """See `TrainingTask`."""
        return {"": self.loss(batch)}
