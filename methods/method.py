"""The interface every reconstruction method keeps."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, same_reference
from eitbench.scenarios.extras import missing
from eitbench.scenarios.sensors.sensor import Sensor

DRAWS = 39
"""Images that state an uncertainty: the truth, if it is one more draw, has one of 40 ranks, of
which 20, 32 and 38 make the central 50, 80 and 95 %."""


class Described:
    """What a method of any kind says of itself.

    Attributes:
        source: the publication it follows.
        needs: module of `scenarios.extras` that it needs beyond a base installation; "" for none.
        trains: true if `fit` asks for the training split, which some recorded sets do not have; a
            run leaves it out there.
        expected_failures: checks of `eitbench check` that it fails by its nature, and why; one that
            passes nevertheless is a failure.
        search: the values of each parameter that may be chosen on the validation split: numbers,
            texts, truth values or None. Empty for a method that asks for that split in `fit`.
        tuned_as: the method whose selected parameters it takes, since its images are the same;
            "" where it has its own.
        differs: what else is different in software that is not ours, such as its electrode model
            and mesh, for the note under a leaderboard; `fit` may say it exactly.
        train_s: time that the weights it loads took to train [s]; NaN if it loads none.
        trained_on: the training behind the weights it loads: `scenario`, the hash `train_data`,
            the number `train_samples` and the `seed`; empty if it loads none.
    """

    source: ClassVar[str] = ""
    needs: ClassVar[str] = ""
    trains: ClassVar[bool] = False
    expected_failures: ClassVar[Mapping[str, str]] = {}
    search: ClassVar[Mapping[str, Sequence[object]]] = {}
    tuned_as: ClassVar[str] = ""
    differs: str = ""
    train_s: float = math.nan
    trained_on: Mapping[str, str] = MappingProxyType({})

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the weights that it loads for `sensor`; "" if it loads none."""
        return ""

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """Return why it cannot be used for `sensor` here, as a sentence; "" if it can.

        A library, weights for the sensor, or a program that it runs, may be missing.
        """
        return missing(cls.needs) if cls.needs else ""


class Method(Described, ABC):
    """A reconstruction method; the first line of a subclass's docstring is its description."""

    @abstractmethod
    def fit(self, problem: Problem) -> None:
        """Prepare for one problem, once: factorise, load or train.

        What is kept of `problem.reference` here is not that of later sessions, see `Problem`.
        """

    @abstractmethod
    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames `voltages` (n, M).

        Frames are in the units of `problem.reference`; they must not be changed in place.

        Raises:
            InputError: a wrong number of values or a value that is not finite.
        """

    def uncertainty(self, voltages: Array) -> Array:
        """How sure the images of `reconstruct` of these frames are. A method need not have it.

        Frames are those that it was asked for just before, with the same reference frame. A frame
        of which this fails, or is not finite, has failed.

        Returns:
            The standard deviation (n, H, W) [S/m] of each pixel about the image, for a normal
            distribution; or images (n, `DRAWS`, H, W) [S/m] from its posterior, as likely as each
            other, which say how sure a place is, too.
        """
        raise NotImplementedError

    @classmethod
    def states_uncertainty(cls) -> bool:
        """True if it has `uncertainty`."""
        return cls.uncertainty is not Method.uncertainty

    def novelty(self, voltages: Array) -> Array:
        """How unlike what the method knows these frames are. A method need not have it.

        Frames and failures are as those of `uncertainty`.

        Returns:
            A score (n,) of each frame, without a unit: the greater, the less its image is to be
            trusted. Only the order of scores counts.
        """
        raise NotImplementedError

    @classmethod
    def states_novelty(cls) -> bool:
        """True if it has `novelty`."""
        return cls.novelty is not Method.novelty


def reconstructed(method: Method, problem: Problem, data: Dataset) -> Array:
    """Images (n, H, W) [S/m] of `data` by a method that is fitted to `problem`.

    The frames of a session are reconstructed together, with their own reference frame.
    """
    images = []
    for rows in same_reference(data.references):
        problem.reference = data.references[rows.start]
        images.append(method.reconstruct(data.voltages[rows]))
    return np.concatenate(images)
