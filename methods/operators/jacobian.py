"""The linear forward operator."""

from typing import ClassVar

import torch
from torch import Tensor

from eitbench.methods.operator import Operator
from eitbench.methods.registry import register_operator
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor


@register_operator("jacobian")
class Jacobian(Operator):
    """V = v_ref + J (sigma - background), the forward model linearised at the background."""

    source: ClassVar[str] = "Geselowitz, IEEE Trans. Biomed. Eng. 18(1), 1971"

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        model = forward_model(sensor)
        reference, jacobian = model.linearise(model.background)
        self.reference = torch.from_numpy(reference)
        self.matrix = torch.from_numpy(jacobian.reshape(len(jacobian), -1))

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        """v_ref + J (sigma - background): (n, H, W) to (n, M)."""
        contrast = (sigma - self.sensor.background).flatten(1)
        return self.reference.to(sigma) + contrast @ self.matrix.to(sigma).T
