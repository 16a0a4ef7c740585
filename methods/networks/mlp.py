"""A multilayer perceptron: knows nothing of neighbours, and shows what convolutions are worth."""

from __future__ import annotations

from torch import Tensor, nn

from eitbench.methods.networks.backbone import Backbone

WIDTH = 256


class Mlp(Backbone):
    """Two hidden layers beside the linear map."""

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__(n_inputs, image_shape)
        last = nn.Linear(WIDTH, image_shape[0] * image_shape[1])
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(
            nn.Linear(n_inputs, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU(), last
        )

    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """See `Backbone`."""
        change: Tensor = self.layers(inputs)
        return change.view(image.shape)
