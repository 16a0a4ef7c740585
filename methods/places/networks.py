"""Networks from a frame to the place of a press, by what they learn from before the skin itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.places.regressions import FEWEST, learned_from, middle, registered
from eitbench.methods.registry import register_place_method
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.transfer import Presses
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.similarity import Similarity

if TYPE_CHECKING:
    from eitbench.methods.places.place_network import TrainingPhase

SIMULATED_PRESSES = 3000


@dataclass
class Network(PlaceMethod):
    """Networks that learn from other presses first, and from the labelled ones in the end.

    What they say before is registered by the labelled presses, and they go on in its coordinates.

    Attributes:
        simulated, skins: true if they learn from simulated presses, and then from other skins.
        presses: learned from, of each of the other skins.
        seeds: number of networks, whose places are averaged.
    """

    source: ClassVar[str] = "Tobin et al., IROS 2017 (domain randomisation)"
    needs: ClassVar = "torch"
    simulated: ClassVar[bool] = False
    skins: ClassVar[bool] = False
    presses: int = 1000
    seeds: int = 1

    def fit(self, problem: PlaceProblem) -> None:
        """Train the networks.

        Raises:
            InputError: `presses` or `seeds` is no whole number above 0.
        """
        for name, value in (("presses", self.presses), ("seeds", self.seeds)):
            if not (isinstance(value, int) and value > 0):
                raise InputError(f"{name!r} is a whole number above 0, got {value!r}.")
        # Imported here: torch takes long.
        from eitbench.methods.places.place_network import REAL, SIMULATED, SKINS, PlaceNetwork

        self._problem, labelled = problem, problem.labelled
        sensor = problem.physics.sensor
        centre, scale = sensor.outline.centre, sensor.outline.longer_side / 2
        self._networks = [
            PlaceNetwork(sensor.n_measurements, centre, scale, seed) for seed in range(self.seeds)
        ]
        if self.simulated:
            self._learn_first(problem.simulated(SIMULATED_PRESSES), SIMULATED)
        if self.skins:
            self._learn_first(learned_from(problem.others, self.presses)[0], SKINS)
        before = self.simulated or self.skins
        self._blank = not before and len(labelled) < FEWEST
        self._register = registered(self._found, problem) if before else _onto(centre, problem)
        if len(labelled) >= FEWEST:
            seen = labelled.differences, self._register.inverse(labelled.places)
            self._networks = [network.trained(*seen, REAL) for network in self._networks]
        self.train_s = sum(network.train_s for network in self._networks)

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m]; in the coordinates of the sensor where too few are labelled.

        The same for all where nothing was learned from.
        """
        if self._blank:
            return np.tile(middle(self._problem), (len(self._problem.unit(differences)), 1))
        return self._register(self._found(self._problem.unit(differences)))

    def _learn_first(self, seen: Presses, phase: TrainingPhase) -> None:
        self._networks = [
            network.trained_once(seen.differences, seen.places, phase) for network in self._networks
        ]

    def _found(self, x: Array) -> Array:
        return np.asarray(np.mean([network(x) for network in self._networks], axis=0))


def _onto(centre: Array, problem: PlaceProblem) -> Similarity:
    """The shift of the sensor's `centre` (2,) onto the middle of the labelled presses."""
    return Similarity(1.0, np.eye(2), middle(problem) - centre)


@register_place_method("network")
class NetworkAlone(Network):
    """Network, learned from presses of the skin alone."""


@register_place_method("network-simulated")
class NetworkOfSimulation(Network):
    """Network, learned from simulated presses, then from those of the skin."""

    simulated = True


@register_place_method("network-skins")
class NetworkOfSkins(Network):
    """Network, learned from other skins, then from presses of the skin."""

    skins = True


@register_place_method("network-simulated-skins")
class NetworkOfBoth(Network):
    """Network, learned from simulated presses, then from other skins, then from the skin itself."""

    simulated = skins = True
