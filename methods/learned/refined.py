"""Reconstruction in steps: physics proposes changes of an image, a network weighs them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.gauss_newton_update import SNR_DB, GaussNewtonUpdate
from eitbench.methods.learned.image_networks import Dnn, DnnLarge, ImageNetworkMethod, TrainedMethod
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.symmetry import mean_over, motions

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Mapping, Sequence

    from torch import Tensor, nn

    from eitbench.methods.learned.refiner_training import RefinerTask
    from eitbench.methods.networks.refiner import Refiner, SpreadNetwork
    from eitbench.methods.problem import Problem
    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.sensors.sensor import Sensor


@dataclass
class RefinementMethod(TrainedMethod):
    """Base of the methods whose network (see `Refiner`) refines a first image.

    Attributes:
        n_inputs: images that the network takes, the one to be refined among them.
        baseline: what the network gives before it is trained.
        begun_from: SHA-256 of the weights that the first images need; "" if they need none.
        begun_gain_power: what these weights were trained with, see `gain_power`; None if there are
            none.
    """

    recipe: ClassVar = Recipe(epochs=30, patience=15)
    options: ClassVar[tuple[str, ...]] = ("limit", "loss", "gain_power")
    n_inputs: ClassVar[int]
    baseline: ClassVar[str] = "the image that it refines"
    begun_from = ""
    begun_gain_power: float | None = None

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        from eitbench.methods.learned.refiner_training import train_refiner

        return train_refiner(cls, job)

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`."""
        import torch

        self.start(problem)
        if metadata["begun_from"] != self.begun_from:
            raise InputError(self.of_another_first())
        self.check_gain_power(float(metadata.get("gain_power", "0")))
        self.train_s += self.begun_train_s
        self._network = self.network(problem)
        torch.nn.Sequential(self._network).load_state_dict(tensors)
        self._network.eval().requires_grad_(requires_grad=False)
        self._device = "cpu"
        self._motions = motions(problem.sensor, problem.jacobian)

    @classmethod
    def of_another_first(cls) -> str:
        """The sentence that the weights continue others than those that are there."""
        return (
            f"The weights of {cls.files.name!r} were trained for another first image than there is "
            f"now: train them again with `{cls.files.command}`."
        )

    def check_gain_power(self, gain_power: float) -> None:
        """Check that the first images come from differences as those it is trained with.

        Raises:
            InputError: they were trained with another power of gains.
        """
        if self.begun_gain_power not in (None, gain_power):
            raise InputError(
                f"The weights that {self.files.name!r} begins with were trained with --gain-power "
                f"{self.begun_gain_power:g}, and its own with {gain_power:g}: train one of them "
                "with that of the other."
            )

    def network(self, problem: Problem) -> Refiner | SpreadNetwork:
        """Return a new network."""
        import torch

        from eitbench.methods.networks.refiner import Refiner

        return Refiner(torch.from_numpy(problem.mask.copy()), self.n_inputs)

    def task(self, network: nn.Module, motions: Sequence[Symmetry], loss: str) -> RefinerTask:
        """Return what a new network is trained by."""
        from eitbench.methods.learned.refiner_training import RefinerTask

        return RefinerTask(network, motions, loss)

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`."""
        return self.output(self.inputs(difference))

    def output(self, inputs: Images) -> Images:
        """The network's images: the mean over the sensor's symmetries, under which inputs move."""
        import torch

        moved = np.concatenate([motion.images(inputs) for motion in self._motions])
        images: Images = self._network(torch.from_numpy(moved).to(self._device)).cpu().numpy()
        return mean_over(self._motions, images)

    def to(self, device: str) -> None:
        """Move its networks to a device, where another method is trained on its images."""
        self._device = device
        self._network.to(device)

    @abstractmethod
    def start(self, problem: Problem, device: str = "cpu") -> None:
        """Prepare `inputs` for a problem, worked out on a device as far as they are a network's.

        Raises:
            InputError: something that they need is missing.
        """

    @abstractmethod
    def inputs(self, difference: Array) -> Images:
        """Return the network's inputs (n, n_inputs, H, W) of differences (n, M) [V/A].

        They are conductivity over background, the image to be refined first, and what physics adds.
        """


@register("coarse-to-fine")
@dataclass
class CoarseToFine(RefinementMethod):
    """A U-Net that refines coarse images: NOSER's, at three strengths of regularisation."""

    source: ClassVar[str] = "Hamilton and Hauptmann, IEEE Trans. Med. Imaging 37(10), 2018"
    files: ClassVar = WeightFiles("coarse-to-fine")
    n_inputs: ClassVar = 3

    regularisations: ClassVar = (0.01, 0.001, 0.1)
    """NOSER's weights, the first for the image that is refined: what suits 30 dB to clean."""

    def start(self, problem: Problem, device: str = "cpu") -> None:
        """See `RefinementMethod`; there is no network."""
        del device
        self._background = problem.background
        self._noser = [Noser(weight, "clausius-mossotti") for weight in self.regularisations]
        for noser in self._noser:
            noser.fit(problem)

    def inputs(self, difference: Array) -> Images:
        """See `RefinementMethod`; the other two images are taken relative to the first."""
        first, *others = (
            (noser.of_difference(difference) / self._background).astype(np.float32)
            for noser in self._noser
        )
        return np.stack([first, *(other - first for other in others)], axis=1)


class ContinuedMethod(RefinementMethod):
    """Base of the methods that begin with the image of another method with weights.

    Attributes:
        first: that method.
    """

    first: ClassVar[type[ImageNetworkMethod | RefinementMethod]] = Dnn

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """See `Trainable`; its own, whose metadata name those of `first` that they continue."""
        return super().weights_hash(sensor) if cls.first.weights_hash(sensor) else ""

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        if why := super().unusable(sensor) or cls.first.unusable(sensor):
            return why
        first = cls.first.weights_hash(sensor)
        continued = cls.files.metadata(sensor).get("begun_from", first)
        return "" if continued == first else cls.of_another_first()

    def start(self, problem: Problem, device: str = "cpu") -> None:
        """See `RefinementMethod`."""
        self._first = self.first()
        self._first.fit(problem)
        self._first.to(device)
        self.begun_from = self.first.weights_hash(problem.sensor)
        self.begun_train_s = self._first.train_s
        self.begun_gain_power = self._first.effective_gain_power
        self._range = problem.sensor.conductivity_range

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`; what `first` learned from was learned from, too."""
        super().prepare(problem, tensors, metadata)
        before, unlimited = self._first.trained_on, self.trained_on["unlimited"]
        if int(before["train_samples"]) > int(self.trained_on["train_samples"]):
            self.trained_on = before
        self.trained_on = {**self.trained_on, "unlimited": max(unlimited, before["unlimited"])}

    def to(self, device: str) -> None:
        """See `RefinementMethod`."""
        super().to(device)
        self._first.to(device)

    def guesses(self, difference: Array) -> Images:
        """Images (n, H, W) of `first`, over the background."""
        return self._first.relative(difference).clip(*self._range)


@register("learned-gn")
@dataclass
class LearnedGaussNewton(ContinuedMethod):
    """A Gauss-Newton step through the exact model from the image of `dnn`, corrected by a network.

    `first` is the method whose image it starts from.
    """

    source: ClassVar[str] = "Adler and Oktem, Inverse Problems 33(12), 2017"
    files: ClassVar = WeightFiles("learned-gn")
    n_inputs: ClassVar = 1 + len(SNR_DB)

    def start(self, problem: Problem, device: str = "cpu") -> None:
        """See `RefinementMethod`."""
        super().start(problem, device)
        self._update = GaussNewtonUpdate(problem)

    def inputs(self, difference: Array) -> Images:
        """See `RefinementMethod`; the image of `first` and its Gauss-Newton updates."""
        guesses = self.guesses(difference)
        updates = self._update(difference, guesses)
        return np.concatenate([guesses[:, None], updates], axis=1)


@register("learned-gn-2")
@dataclass
class SecondGaussNewton(LearnedGaussNewton):
    """A second Gauss-Newton step, from the image of `learned-gn`, corrected by its own network."""

    files: ClassVar = WeightFiles("learned-gn-2")
    first: ClassVar = LearnedGaussNewton


@register("learned-gn-large")
@dataclass
class LargeGaussNewton(LearnedGaussNewton):
    """A Gauss-Newton step from the image of `dnn-large`, corrected by its own network."""

    files: ClassVar = WeightFiles("learned-gn-large")
    recipe: ClassVar = Recipe(epochs=40, batch=128)
    first: ClassVar = DnnLarge


@register("dnn-heteroscedastic")
@dataclass
class HeteroscedasticDnn(ContinuedMethod):
    """The image of `dnn`, and a network that gives the deviation of each pixel from it."""

    source: ClassVar[str] = (
        "Nix and Weigend, IEEE ICNN 1994, 55; Kendall and Gal, NIPS 30, 2017; trained by CRPS: "
        "Gneiting et al., Mon. Weather Rev. 133, 2005, 1098"
    )
    files: ClassVar = WeightFiles("dnn-heteroscedastic")
    recipe: ClassVar = Recipe(epochs=8, patience=15)
    options: ClassVar = ("limit", "gain_power")
    n_inputs: ClassVar = 1
    baseline: ClassVar = "one deviation for all pixels"

    def network(self, problem: Problem) -> SpreadNetwork:
        """See `RefinementMethod`."""
        from eitbench.methods.networks.refiner import SpreadNetwork

        return SpreadNetwork(problem.mask.shape)

    def task(self, network: nn.Module, motions: Sequence[Symmetry], loss: str) -> RefinerTask:
        """See `RefinementMethod`."""
        from eitbench.methods.learned.refiner_training import SpreadTask

        return SpreadTask(network, motions, loss)

    def inputs(self, difference: Array) -> Images:
        """See `RefinementMethod`; the image of `dnn`."""
        return self.guesses(difference)[:, None]

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`; that image."""
        return self.guesses(difference)

    def uncertainty(self, voltages: Array) -> Array:
        """Standard deviation (n, H, W) [S/m] of frames (n, M)."""
        spread = self.output(self.inputs(self.amplified(voltages))) / self.amplification
        return np.asarray(spread * self._problem.background)
