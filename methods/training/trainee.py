"""What is trained: a network with its loss."""

from __future__ import annotations

from abc import abstractmethod

import torch
from lightning.pytorch import LightningModule
from torch import Tensor, nn

Data = tuple[Tensor, ...]
"""Samples, along the first axis that all tensors have in common."""


class Trainee(LightningModule):
    """A network in training.

    Its training step returns what is minimised and logs "train"; its validation step logs
    "validation", by which the best epoch is chosen; what else they log is kept in the curve.

    Attributes:
        epochs_done: how many epochs were finished, also before an interruption.
    """

    epochs_done: int = 0

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def log_train(self, loss: Tensor, n: int) -> None:
        """Log the loss of `n` training samples, which counts for the epoch, on all devices."""
        self.log("train", loss, on_step=False, on_epoch=True, batch_size=n, sync_dist=True)

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam with decoupled weight decay; the loop sets its learning rate."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4)


class OneLoss(Trainee):
    """A network with one loss, minimised on training and watched on validation samples."""

    @abstractmethod
    def loss(self, batch: Data) -> Tensor:
        """Mean loss () over a batch of samples, tensors with a first axis in common."""

    def training_step(self, batch: Data, index: int) -> Tensor:
        """The loss of one batch."""
        loss = self.loss(batch)
        self.log_train(loss, len(batch[0]))
        return loss

    def validation_step(self, batch: Data, index: int) -> None:
        """Log the loss of one batch."""
        self.log("validation", self.loss(batch), batch_size=len(batch[0]))
