"""The interface of methods that say where a press is, without an image, and their problem."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from eitbench.methods.method import Described
from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.data.transfer import Learnable, Presses
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate

if TYPE_CHECKING:
    from eitbench.methods.problem import Splits


class PlaceProblem:
    """A skin whose presses are to be located, and all that there is to learn from.

    Differences are frames minus the reference frame in the units of the board: what a press changes
    is known up to a factor only. Where the recorded set has no reference frame, that of `physics`
    is the model's. It records what is read of it, see `read`.

    Attributes:
        physics: the problem of a method that makes images of this skin: its nominal sensor, the
            forward model with its Jacobian, the reference frame, and the simulated presses of
            `Problem.training`. It has no validation samples.
    """

    def __init__(self, given: Learnable, splits: Splits) -> None:
        self.physics = Problem(given.sensor, given.reference, splits)
        self._given = given
        self._read: dict[str, int] = {}

    @property
    def labelled(self) -> Presses:
        """Presses of this skin with their places, as many as the scenario declares."""
        self._note("labelled", len(self._given.labelled))
        return self._given.labelled

    @property
    def unlabelled(self) -> Array:
        """Differences (u, M) of presses of this skin without their places, in the order of time.

        Those of `labelled` are among them; those that are located later are not.
        """
        self._note("unlabelled", len(self._given.unlabelled))
        return self._given.unlabelled

    @property
    def others(self) -> Mapping[str, Presses]:
        """All presses of other skins with their places, by the name of the recorded set.

        Each has a board, a gel and a robot of its own. Places are those on this sensor, in its
        coordinates, where electrodes of the same number lie on each other.
        """
        self._note("other-skin", sum(map(len, self._given.others.values())))
        return self._given.others

    def simulated(self, limit: int | None = None) -> Presses:
        """The first `limit` simulated presses of the nominal sensor.

        Differences are in V/A. Places are in the sensor's coordinates, which are those of the robot
        up to a similarity, which nobody knows exactly.
        """
        data = self.physics.training(limit)
        assert data.conductivity is not None  # simulated
        contrast = data.conductivity - data.sensor.background
        return Presses(data.voltages - data.references, locate(contrast, data.sensor))

    @property
    def read(self) -> Mapping[str, int]:
        """What was read of the real presses: the number of each kind."""
        return dict(self._read)

    def unit(self, differences: ArrayLike) -> Array:
        """The `differences` (n, M) divided by their rms, since a place has no strength.

        Raises:
            InputError: a wrong number of values or a value that is not finite.
        """
        frames = np.asarray(differences, dtype=np.float64)
        m = self.physics.sensor.n_measurements
        if frames.ndim != 2 or frames.shape[1] != m:
            raise InputError(f"Differences need the shape (n, {m}), got {frames.shape}.")
        if not np.isfinite(frames).all():
            raise InputError("A difference holds a value that is not a finite number.")
        return unit_frames(frames)

    def _note(self, kind: str, number: int) -> None:
        if number:
            self._read[kind] = number


class PlaceMethod(Described, ABC):
    """A method that says where a press is; the first line of its docstring is its description.

    With `problem.labelled` its places are in the coordinates of the skin's robot. Without labelled
    presses nobody can know these: its places may be in any coordinates that are similar to them,
    turned, mirrored, shifted and scaled, and the benchmark fits that similarity to presses whose
    places it never shows. A method that says the same place for all of them is taken to mean the
    median of these presses.
    """

    @abstractmethod
    def fit(self, problem: PlaceProblem) -> None:
        """Prepare for one skin, once. There may be no labelled presses."""

    @abstractmethod
    def locate(self, differences: Array) -> Array:
        """Places (n, 2) [m] of the presses that make `differences` (n, M), each on its own.

        Differences are in the units of those of the problem; they must not be changed in place.

        Raises:
            InputError: a wrong number of values or a value that is not finite.
        """
