"""Declaration of what `eitbench train` can train: a method or an operator with weights."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.methods.training.recipe import Recipe
    from eitbench.methods.weights.weight_files import WeightFiles
    from eitbench.scenarios.sensors.sensor import Sensor


class Trainable(ABC):
    """Base of the methods and operators whose networks `eitbench train` trains.

    Attributes:
        files: where weights are looked for.
        recipe: hyper-parameters of the training, unless others are asked for.
        options: those of `TrainingRequest` that its training takes, among `request.OPTIONS`.
    """

    files: ClassVar[WeightFiles]
    recipe: ClassVar[Recipe]
    options: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the weights that it loads for `sensor`; "" if there are none."""
        return cls.files.content_hash(sensor)

    @classmethod
    @abstractmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """Train its networks; see `eitbench.methods.training.train`."""
