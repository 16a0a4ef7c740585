"""Base of the backbones: a linear map from voltages to an image, and a correction of it."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor, nn


class Backbone(nn.Module):
    """Relative contrasts (n, H, W) from standardised differences (n, K).

    It begins as a linear map, for the correction begins at zero. The map is computed in full
    precision whatever the autocast: what is lost on voltages comes back magnified in the image.
    """

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.image_shape = image_shape
        self.linear = nn.Linear(n_inputs, image_shape[0] * image_shape[1])

    def forward(self, inputs: Tensor) -> Tensor:
        """The linear image plus its correction."""
        with torch.autocast(inputs.device.type, enabled=False):
            image = self.linear(inputs).view(-1, *self.image_shape)
        corrected: Tensor = image + self.correction(inputs, image).float()
        return corrected

    @abstractmethod
    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """Return what to add (n, H, W) to the linear `image` (n, H, W) of `inputs` (n, K)."""

    def start_from(self, matrix: Tensor) -> None:
        """Make `matrix` (K, H * W) the linear map."""
        with torch.no_grad():
            self.linear.weight.copy_(matrix.T)
            self.linear.bias.zero_()
