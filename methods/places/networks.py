"""Networks from a frame to the place of a press, by what they learn from before the skin itself."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.place_method import PlaceMethod, PlaceProblem
from eitbench.methods.places.regressions import FEWEST, common, learned_from, registered
from eitbench.methods.registry import register_place_method
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.similarity import fit_similarity

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
    simulated: ClassVar[bool] = False
    skins: ClassVar[bool] = False
    presses: int = 1000
    seeds: int = 1

    def fit(self, problem: PlaceProblem) -> None:
        """Train the networks."""
        # Imported here: torch takes long.
        from eitbench.methods.places.place_network import REAL, SIMULATED, SKINS, PlaceNetwork

        start = time.perf_counter()
        self._problem = problem
        m = problem.physics.sensor.n_measurements
        self._networks = [PlaceNetwork(m, (0.0, 0.0), 1.0, seed) for seed in range(self.seeds)]
        if self.simulated:
            seen = problem.simulated(SIMULATED_PRESSES)
            self._train(unit_frames(seen.differences), common(seen.places), SIMULATED)
        if self.skins:
            x, y, _ = learned_from(problem.others, self.presses)
            # Simulated presses came in other coordinates.
            onto = fit_similarity(y, self._found(x)) if self.simulated else None
            self._train(x, y if onto is None else onto(y), SKINS)
        labelled = problem.labelled
        before = self.simulated or self.skins
        self._blank = not before and len(labelled) < FEWEST
        self._register = registered(self._found if before else None, problem)
        if len(labelled) >= FEWEST:
            self._train(
                problem.unit(labelled.differences), self._register.inverse(labelled.places), REAL
            )
        self.train_s = time.perf_counter() - start

    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m]; in coordinates of their own where no presses are labelled.

        The same for all where nothing was learned from.
        """
        if self._blank:
            return np.zeros((len(self._problem.unit(differences)), 2))
        return self._register(self._found(self._problem.unit(differences)))

    def _train(self, x: Array, y: Array, phase: TrainingPhase) -> None:
        self._networks = [network.trained(x, y, phase) for network in self._networks]

    def _found(self, x: Array) -> Array:
        return np.asarray(np.mean([network(x) for network in self._networks], axis=0))


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
