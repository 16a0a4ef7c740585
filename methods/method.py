"""The interface every reconstruction method keeps."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.methods.problem import Problem

Array = NDArray[np.float64]


class Method(ABC):
    """A reconstruction method; the first line of a subclass's docstring is its description.

    Attributes:
        source: the publication it follows.
        search: the values of each parameter that may be chosen on the validation split.
        train_s: time that the weights it loads took to train [s]; NaN if it loads none.
    """

    source: ClassVar[str] = ""
    search: ClassVar[Mapping[str, Sequence[object]]] = {}
    train_s: float = math.nan

    @abstractmethod
    def fit(self, problem: Problem) -> None:
        """Prepare for one problem, once: factorise, load or train."""

    @abstractmethod
    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames `voltages` (n, M).

        Frames are in the units of `problem.reference`; they must not be changed in place.

        Raises:
            InputError: a wrong number of values or a value that is not finite.
        """
