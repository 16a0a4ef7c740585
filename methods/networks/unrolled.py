"""Learned proximal gradient: unrolled steps through a fixed linear model, each with a network."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from eitbench.methods.classical.noser import noser_covariance
from eitbench.methods.networks.image_network import FEWER_CHANNELS, ImageNetwork, PatchUNet
from eitbench.scenarios.physics.forward import forward_model

if TYPE_CHECKING:
    from eitbench.scenarios.sensors.sensor import Sensor

STEPS = 3

REGULARISATIONS = (1e-3, 1e-1)
"""First weights w of the two gradients of a step: for frames without noise, and with."""


class UnrolledNetwork(ImageNetwork):
    """`ImageNetwork`, whose image is refined by `STEPS` proximal steps, each a `ProximalStep`.

    The contrast x is to minimise |A f(x) - d|^2 + R(x) with an unknown R, where A (K, H * W) is the
    exact model's derivative at the background, d (n, K) [V/A] are the differences, and f takes a
    contrast to its Clausius-Mossotti factor, in which the model is more linear (`Linearisation`).
    The plain gradient A^T (A f - d) gets nowhere, as the singular values of A differ by orders of
    magnitude. So the steps follow

        g_w = C A^T (A C A^T + w I)^-1 (d - A f(x)),

    with the covariance C of NOSER: damped Gauss-Newton steps, which make it a proximal Newton
    method.
    """

    rows: Tensor
    prior: Tensor
    gram: Tensor

    def __init__(self, sensor: Sensor, backbone: str) -> None:
        super().__init__(sensor, backbone)
        model = forward_model(sensor)
        jacobian = model.jacobian(model.background) * sensor.background
        rows = self.averaging.T.double() @ torch.from_numpy(jacobian).flatten(1)
        covariance = torch.from_numpy(noser_covariance(rows.numpy())) * self.mask.flatten()
        prior = rows * covariance
        gram = prior @ rows.T
        scale = gram.diagonal().mean()
        # They follow from the sensor, so that they need not be stored.
        self.register_buffer("rows", rows.float(), persistent=False)
        self.register_buffer("prior", (prior / scale).float(), persistent=False)
        self.register_buffer("gram", gram / scale, persistent=False)
        self.steps = nn.ModuleList(ProximalStep(sensor.image_shape) for _ in range(STEPS))

    def forward(self, difference: Tensor) -> Tensor:
        """Conductivity over background (n, H, W); 1 outside the sensor."""
        image: Tensor = self.backbone(self.inputs(difference)) * self.mask
        for step in self.steps:
            logs = step.get_parameter("log_weights")
            image = step(image, self.gradients(image, difference, logs)) * self.mask
        return 1 + image

    def gradients(self, image: Tensor, difference: Tensor, log_weights: Tensor) -> Tensor:
        """g_w (n, len(w), H, W) at contrasts `image` (n, H, W), relative to the mean of A C A^T."""
        with torch.autocast(image.device.type, enabled=False):
            relative = (1 + image).clamp(*self.sensor.conductivity_range)
            factors = 2 * (relative - 1) / (relative + 1)
            missing = difference @ self.averaging - factors.flatten(1) @ self.rows.T
            identity = torch.eye(len(self.gram), dtype=self.gram.dtype, device=image.device)
            damped = self.gram + log_weights.exp()[:, None, None] * identity
            solved = torch.linalg.solve(damped, missing.to(self.gram).T)
            gradients: Tensor = solved.transpose(1, 2).float() @ self.prior
        return gradients.transpose(0, 1).reshape(len(image), -1, *image.shape[1:])


class ProximalStep(nn.Module):
    """A step along the gradients, then a network in place of the proximal map of R.

    The image stays as it is at first.

    Source: Adler and Oktem, "Learned Primal-Dual Reconstruction", IEEE Trans. Med. Imaging 37(6),
    2018, section III (learned proximal operators); Monga, Li and Eldar, IEEE Signal Process. Mag.
    38(2), 2021, for the family.

    Attributes:
        log_weights: (2,) logarithms of the weights w.
        lengths: (2,) of the steps along the gradients.
    """

    def __init__(self, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.log_weights = nn.Parameter(torch.tensor([math.log(w) for w in REGULARISATIONS]))
        self.lengths = nn.Parameter(torch.zeros(len(REGULARISATIONS)))
        self.unet = PatchUNet(1 + len(REGULARISATIONS), 0, image_shape, FEWER_CHANNELS)

    def forward(self, image: Tensor, gradients: Tensor) -> Tensor:
        """The next contrasts (n, H, W) of `image` (n, H, W) with `gradients` (n, 2, H, W)."""
        with torch.autocast(image.device.type, enabled=False):
            moved = image + torch.einsum("w,nwhx->nhx", self.lengths, gradients)
        change: Tensor = self.unet(torch.cat([moved[:, None], gradients], dim=1))
        return moved + change.float()
