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


def working_precision(device: str) -> torch.autocast:
    """bfloat16 where a kind of device computes in it; float32 elsewhere.

    Processors without it take 15 times as long. Results of the two differ by rounding, so that one
    seed makes one result on one kind of machine.
    """
    return torch.autocast(device, dtype=torch.bfloat16, enabled=_has_bfloat16(device))


def _has_bfloat16(device: str) -> bool:
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    able = torch.cpu.get_capabilities()
    return bool(able.get("amx_bf16") or able.get("avx512_bf16"))
