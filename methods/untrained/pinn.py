"""Physics-informed networks of the coordinates, fitted to a single frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from eitbench.methods.registry import register
from eitbench.methods.untrained.network_per_frame import FittedPerFrame, Objective
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from torch import Tensor, nn

    from eitbench.methods.problem import Problem
    from eitbench.scenarios.arrays import Array


@register("pinn")
@dataclass
class Pinn(FittedPerFrame):
    """Networks of the coordinates for conductivity and potentials, fitted to each frame (PINN).

    The misfit of the differences that both predict is minimised, plus the weighted residual of the
    potentials' equation, see `weak_form`. For the other attributes see `FittedPerFrame`.

    Attributes:
        physics: weight of the residual.
        bandwidth: of the random frequencies of the coordinates [periods over the longer side].
    """

    source: ClassVar[str] = (
        "Raissi et al., J. Comput. Phys. 378, 2019; Bar and Sochen, SIAM J. Imaging Sci. 14, 2021"
    )
    expected_failures: ClassVar = asymmetry("its random frequencies have no symmetry")
    name: ClassVar = "pinn"
    learning_rate: ClassVar[float] = 0.003

    steps: int = 250
    physics: float = 1e3
    bandwidth: float = 0.5

    def fit(self, problem: Problem) -> None:
        """Prepare the equations.

        Raises:
            InputError: as of `FittedPerFrame.fit`; a weight or bandwidth that is not positive.
        """
        from eitbench.methods.operators.fem import Fem
        from eitbench.methods.untrained.misfit import Misfit
        from eitbench.methods.untrained.weak_form import WeakForm

        if not (0 < self.physics < math.inf and 0 < self.bandwidth < math.inf):
            raise InputError(
                f"{self.name!r} needs a positive weight of its physics and a positive "
                f"bandwidth, got physics={self.physics} and bandwidth={self.bandwidth}."
            )
        super().fit(problem)
        self._misfit = Misfit(problem, Fem(problem.sensor))
        self._equations = WeakForm(problem.model)

    def network(self) -> nn.Module:
        """Return networks of conductivity and of secondary potentials."""
        from eitbench.methods.networks.coordinate_network import FieldNetworks

        sensor = self._problem.sensor
        points, electrodes = self._equations.points, sensor.n_electrodes
        return FieldNetworks(
            sensor.image_shape, sensor.pixel_size, points, electrodes, self.bandwidth
        )

    def image(self, output: Tensor, first: Tensor) -> Tensor:
        """See `FittedPerFrame`; the output is added to the first image, within the range.

        A logit would have to keep away from the ends of the range, where the background may be: a
        first image that is off by so little everywhere has quite other voltages.
        """
        return (first + output).clamp(*self._problem.sensor.conductivity_range)

    def objective(self, difference: Array, first: Array) -> Objective:
        """See `FittedPerFrame`; the misfit of the data, and the residual of the potentials.

        The network of potentials adds to those of the first image, so that the two agree at first.
        """
        misfit, equations = self._misfit.of(difference), self._equations
        begun = equations.potentials(first * self._problem.background)

        def loss(network: nn.Module, relative: Tensor) -> Tensor:
            potentials = begun + equations.scale * network.get_submodule("potentials")()
            predicted, residual = equations.of(relative, potentials)
            return misfit(predicted) + self.physics * residual

        return loss
