"""Reconstruction in steps: physics proposes changes of an image, a network weighs them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.gauss_newton_update import SNR_DB, GaussNewtonUpdate
from eitbench.methods.learned.image_networks import LEARNED_SYMMETRY, Dnn, TrainedMethod
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.methods.networks.refiner import Refiner
    from eitbench.methods.problem import Problem
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.sensors.sensor import Sensor


@dataclass
class RefinementMethod(TrainedMethod):
    """Base of the methods whose networks (see `Refiner`) refine a first image, step by step.

    Attributes:
        steps: how often the image is refined, each time by a network of its own.
        n_inputs: images that a network takes, the one to be refined among them.
    """

    recipe: ClassVar = Recipe(epochs=30, patience=15)
    options: ClassVar = ("limit",)
    steps: ClassVar[int]
    n_inputs: ClassVar[int]

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        from eitbench.methods.learned.refiner_training import train_refiners

        return train_refiners(cls, job)

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`."""
        self.start(problem)
        if metadata["begun_from"] != self.begun_from():
            raise InputError(
                f"The weights of {self.files.name!r} continue another network than the present "
                f"one of 'dnn': train them again with `{self.files.command}`."
            )
        self._networks = []
        for step in range(self.steps):
            prefix = f"{step}."
            network = self.network(problem)
            network.load_state_dict(
                {k.removeprefix(prefix): t for k, t in tensors.items() if k.startswith(prefix)}
            )
            self._networks.append(network.eval().requires_grad_(requires_grad=False))

    def network(self, problem: Problem) -> Refiner:
        """Return a new network for one step."""
        import torch

        from eitbench.methods.networks.refiner import Refiner

        return Refiner(torch.from_numpy(problem.mask.copy()), self.n_inputs)

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`."""
        import torch

        images = self.first_guesses(difference)
        for network in self._networks:
            images = network(torch.from_numpy(self.inputs(difference, images))).numpy()
        return images

    def begun_from(self) -> str:
        """Return the SHA-256 of the weights that the first guesses need; "" if they need none."""
        return ""

    @abstractmethod
    def start(self, problem: Problem) -> None:
        """Prepare `first_guesses` and `inputs` for a problem.

        Raises:
            InputError: something that they need is missing.
        """

    @abstractmethod
    def first_guesses(self, difference: Array) -> Images:
        """Return images to begin with, conductivity over background (n, H, W), of (n, M) [V/A]."""

    @abstractmethod
    def inputs(self, difference: Array, guesses: Images) -> Images:
        """Return a network's inputs (n, n_inputs, H, W): the guess, then what physics adds."""


@register("coarse-to-fine")
@dataclass
class CoarseToFine(RefinementMethod):
    """A U-Net that refines coarse images: NOSER's, at three strengths of regularisation."""

    source: ClassVar[str] = "Hamilton and Hauptmann, IEEE Trans. Med. Imaging 37(10), 2018"
    expected_failures: ClassVar = asymmetry(LEARNED_SYMMETRY, 0.078, 0.071)
    files: ClassVar = WeightFiles("coarse-to-fine", version="1")
    steps: ClassVar = 1
    n_inputs: ClassVar = 3

    regularisations: ClassVar = (0.01, 0.001, 0.1)
    """NOSER's weights, the first for the image that is refined: what suits 30 dB to clean."""

    def start(self, problem: Problem) -> None:
        """See `RefinementMethod`."""
        self._background = problem.background
        self._noser = [Noser(weight, "clausius-mossotti") for weight in self.regularisations]
        for noser in self._noser:
            noser.fit(problem)

    def first_guesses(self, difference: Array) -> Images:
        """See `RefinementMethod`."""
        return self._coarse(self._noser[0], difference)

    def inputs(self, difference: Array, guesses: Images) -> Images:
        """See `RefinementMethod`; the other two images are taken relative to the guess."""
        others = [self._coarse(noser, difference) - guesses for noser in self._noser[1:]]
        return np.stack([guesses, *others], axis=1)

    def _coarse(self, noser: Noser, difference: Array) -> Images:
        return (noser.of_difference(difference) / self._background).astype(np.float32)


@register("learned-gn")
@dataclass
class LearnedGaussNewton(RefinementMethod):
    """Gauss-Newton steps through the exact model from the image of `dnn`, each then corrected."""

    source: ClassVar[str] = "Adler and Oktem, Inverse Problems 33(12), 2017"
    expected_failures: ClassVar = asymmetry(LEARNED_SYMMETRY, 0.056, 0.046)
    files: ClassVar = WeightFiles("learned-gn", version="1")
    steps: ClassVar = 1
    n_inputs: ClassVar = 1 + len(SNR_DB)

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """See `Trainable`; its own, whose metadata name those of `dnn` that they continue."""
        return super().weights_hash(sensor) if Dnn.weights_hash(sensor) else ""

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return super().unusable(sensor) or Dnn.unusable(sensor)

    def begun_from(self) -> str:
        """See `RefinementMethod`."""
        return self._dnn_hash

    def start(self, problem: Problem) -> None:
        """See `RefinementMethod`."""
        self._dnn = Dnn()
        self._dnn.fit(problem)
        self._dnn_hash = Dnn.weights_hash(problem.sensor)
        self._range = problem.sensor.conductivity_range
        self._update = GaussNewtonUpdate(problem)

    def first_guesses(self, difference: Array) -> Images:
        """See `RefinementMethod`."""
        return self._dnn.relative(difference).clip(*self._range)

    def inputs(self, difference: Array, guesses: Images) -> Images:
        """See `RefinementMethod`; the guess and its Gauss-Newton updates."""
        guesses = guesses.clip(*self._range)
        updates = self._update(difference, guesses)
        return np.concatenate([guesses[:, None], updates], axis=1)
