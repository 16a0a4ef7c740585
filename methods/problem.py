"""What a method is told about the problem it is to solve."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors import Sensor

Array = NDArray[np.float64]
Splits = Callable[[str, int | None], Dataset]


class Problem:
    """The nominal sensor, its untouched frame, forward physics and data to learn from.

    Attributes:
        sensor: the nominal sensor, with the range of conductivity to expect; a real one differs.
        reference: (M,) the untouched frame v_ref, measured like any other, in the board's units.
    """

    def __init__(self, sensor: Sensor, reference: ArrayLike, splits: Splits) -> None:
        self.sensor = sensor
        self.reference = self._frames(sensor, np.asarray(reference)[None])[0]
        self._splits = splits

    @property
    def background(self) -> float:
        """Conductivity of the untouched sensor [S/m]."""
        return self.sensor.background

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(H, W): the pixels inside the sensor; outside, an estimate is ignored."""
        return self.sensor.mask

    @cached_property
    def model(self) -> ForwardModel:
        """The exact forward model on the sensor's image grid."""
        return forward_model(self.sensor)

    @cached_property
    def background_voltages(self) -> Array:
        """(M,) [V/A], what the model predicts for the untouched sensor."""
        return self.model.voltages(self.model.background)

    @cached_property
    def jacobian(self) -> Array:
        """(M, H, W) [V/A per S/m], the model's derivative at the background; 0 outside the mask."""
        return self.model.jacobian(self.model.background)

    @cached_property
    def gain(self) -> float:
        """Board units per V/A: the least-squares factor from the model's frame to v_ref."""
        modelled = self.background_voltages
        gain = float(modelled @ self.reference / (modelled @ modelled))
        if not gain > 0:
            raise InputError(
                "The reference frame does not match the sensor's drive pattern: their correlation "
                "is not positive. Check the order and sign of the measurements."
            )
        return gain

    def difference(self, voltages: ArrayLike) -> Array:
        """Frames minus the reference frame, in model units: (n, M) to (n, M) [V/A].

        Raises:
            InputError: a wrong number of values or a value that is not finite.
        """
        return np.asarray((self._frames(self.sensor, voltages) - self.reference) / self.gain)

    def training(self, limit: int | None = None) -> Dataset:
        """The first `limit` samples of the training split, with their truth."""
        return self._splits("train", limit)

    def validation(self, limit: int | None = None) -> Dataset:
        """The first `limit` samples of the validation split, with their truth."""
        return self._splits("validation", limit)

    @staticmethod
    def _frames(sensor: Sensor, voltages: ArrayLike) -> Array:
        frames = np.asarray(voltages, dtype=np.float64)
        if frames.ndim != 2 or frames.shape[1] != sensor.n_measurements:
            raise InputError(
                f"Sensor {sensor.name!r} gives frames of {sensor.n_measurements} values, so "
                f"voltages need shape (n, {sensor.n_measurements}); got {frames.shape}."
            )
        if not np.isfinite(frames).all():
            bad = int(np.flatnonzero(~np.isfinite(frames).all(axis=1))[0])
            raise InputError(f"Frame {bad} holds a value that is not a finite number.")
        return frames
