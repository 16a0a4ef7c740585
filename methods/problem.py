"""The problem that a method solves, and a record of what the method reads of it."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.methods.normalisation import (
    FAULT_WEIGHT,
    WEIGHT,
    estimate_of_nominal,
    gains_of_reference,
)
from eitbench.methods.smoothness import smoothed
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, same_reference
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.faults import spoiled
from eitbench.scenarios.phantoms.phantom import Contents, contents
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors.sensor import Sensor

# Electrodes hold their contact impedance, which a method needs no more than for a model.
_TRACKED = {"electrodes": "model", "conductivity_range": "conductivity_range"}
_PLAIN = frozenset({"n_electrodes", "describe", "_content"})


class TrackedSensor(Sensor):
    """A sensor equal to the one it stands for; reading what `_TRACKED` names is noted in `_read`.

    Models are cached by sensor, so that looking one up counts as reading the electrodes.
    """

    _plain: Sensor
    _read: set[str]

    def __getattribute__(self, name: str) -> object:
        if name == "__class__":
            return Sensor  # so that `dataclasses.replace` makes a plain one
        if name in _PLAIN:
            return getattr(object.__getattribute__(self, "_plain"), name)
        if name in _TRACKED:
            object.__getattribute__(self, "_read").add(_TRACKED[name])
        return object.__getattribute__(self, name)

    def __hash__(self) -> int:
        self._read.add("model")
        return hash(self._plain)

    def __reduce__(self) -> tuple[object, ...]:
        """A copy is one of the sensor itself, with all that it holds."""
        self._read.update(_TRACKED.values())
        return copy.copy, (self._plain,)


def tracked(sensor: Sensor, read: set[str]) -> Sensor:
    """Return `sensor`, which adds to `read` what is read of it: "model", "conductivity_range"."""
    copied = object.__new__(TrackedSensor)
    copied.__dict__.update(sensor.__dict__, _plain=sensor, _read=read)
    return copied


Splits = Callable[[str, int | None], Dataset]


@dataclass(frozen=True, eq=False)
class SamplesRead:
    """The first `samples` of one split that a method has read, and what each shows."""

    split: str
    scenario: str
    data_hash: str
    samples: int
    contents: Contents


@dataclass(frozen=True, eq=False)
class AccessRecord:
    """Parts of its problem that a method has read, the source of its prior knowledge.

    Attributes:
        model: True if it read the nominal sensor's physics, and with it its contact impedance.
        gain: True if it read the scale from the board's units to the nominal model's.
        conductivity_range: True if it read the range of conductivity to expect.
        samples: what it read of the training and validation splits.
    """

    model: bool
    gain: bool
    conductivity_range: bool
    samples: tuple[SamplesRead, ...]


class Problem:
    """The nominal sensor, its reference frame, forward physics and data to learn from.

    It records what is read of it, see `access_record`.

    Attributes:
        sensor: the nominal sensor, with the range of conductivity to expect; a real one differs.
    """

    def __init__(self, sensor: Sensor, reference: ArrayLike, splits: Splits) -> None:
        self._read: set[str] = set()
        self._samples: dict[str, tuple[int, Callable[[], SamplesRead]]] = {}
        self._nominal = sensor
        self.sensor = tracked(sensor, self._read)
        self._latest: Array = np.empty(0)
        self.reference = np.asarray(reference)
        self._splits = splits

    @property
    def reference(self) -> Array:
        """The reference frame v_ref (M,) of the untouched sensor, in the board's units.

        It is measured like any other, and anew from time to time: it may be another one at every
        call of `Method.reconstruct`, which has to read it, or `difference`, there.
        """
        return self._latest

    @reference.setter
    def reference(self, frame: ArrayLike) -> None:
        try:
            latest = self._frames(self._nominal, np.asarray(frame)[None])[0]
        except InputError as error:
            raise InputError(f"The reference frame cannot be used. {error}") from error
        if np.array_equal(latest, self._latest):
            return  # as after most frames: what follows from it still holds
        self._latest = latest.copy()  # the caller may fill its array with the next
        self._gain: float | None = None
        self._estimates: dict[float, Array | None] = {}

    @property
    def unit_reference(self) -> Array:
        """The reference frame (M,) [V/A] in units of the model; values that a fault spoils are its.

        For what divides by the reference frame: `difference` fills in such values likewise.
        """
        _, kept = self._measured_with(self._latest, 0.0)
        return np.where(kept, self.reference / self.gain, self.background_voltages)

    @property
    def background(self) -> float:
        """Conductivity of the untouched sensor [S/m]."""
        return self._nominal.background

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels (H, W) inside the sensor; outside, an estimate is ignored."""
        return self._nominal.mask

    @property
    def model(self) -> ForwardModel:
        """The exact forward model on the sensor's image grid."""
        self._read.add("model")
        return forward_model(self._nominal)

    @property
    def background_voltages(self) -> Array:
        """Voltages (M,) [V/A] that the model predicts for the untouched sensor."""
        self._read.add("model")
        return self._modelled

    @cached_property
    def jacobian(self) -> Array:
        """Derivative (M, H, W) [V/A per S/m] of the model at the background; 0 outside the mask."""
        return self.model.jacobian(self.model.background)

    @cached_property
    def _modelled(self) -> Array:
        model = forward_model(self._nominal)
        return model.voltages(model.background)

    @property
    def gain(self) -> float:
        """Board units per V/A: the least-squares factor from the model's frame to v_ref."""
        self._read.add("gain")
        if self._gain is None:
            self._gain = float(self._gains(self.reference))
        return self._gain

    def _gains(self, references: Array) -> Array:
        """Gains (...) of reference frames (..., M), from values that no fault spoils."""
        if not references.any(axis=-1).all():
            raise InputError(
                "A reference frame is zero everywhere: is the board connected, and does it drive a "
                "current?"
            )
        modelled = self._modelled
        gains = np.asarray(references @ modelled / (modelled @ modelled))
        wrong = spoiled(references, modelled, self._nominal.pattern)
        for k in map(tuple, np.argwhere(wrong.any(axis=-1))):
            if not references[k][~wrong[k]].any():
                raise InputError(
                    f"No value of a reference frame can be used: {np.sum(references[k] == 0)} of "
                    f"{len(modelled)} are zero, and the others are unlike the sensor's. Check the "
                    "connections of its electrodes."
                )
            sound = modelled * ~wrong[k]
            gains[k] = references[k] @ sound / (sound @ sound)
        if not (gains > 0).all():
            raise InputError(
                "The reference frame does not match the sensor's drive pattern: their correlation "
                "is not positive. Check the order and sign of the measurements."
            )
        return gains

    def difference(self, voltages: ArrayLike, gain_power: float = 0.0) -> Array:
        """Frames minus the reference frame, in model units: (n, M) to (n, M) [V/A].

        Values that a dead electrode or saturation spoils, by the reference frame, are replaced by
        what the others say of them.

        Args:
            voltages: the frames.
            gain_power: with p > 0 the differences are those that the nominal sensor would have
                measured if each measurement of the real one has the gain |v_ref / V|^p, see
                `methods.normalisation`. Where only differences were recorded, the gains are 1 and
                nothing is changed.

        Raises:
            InputError: a wrong number of values or a value that is not finite, or a power below 0.
        """
        change = (self._frames(self._nominal, voltages) - self.reference) / self.gain
        if gain_power not in self._estimates:
            self._estimates[gain_power] = self._estimate(self.reference, gain_power)
        return _estimated(change, self._estimates[gain_power])

    def differences(self, data: Dataset, gain_power: float = 0.0) -> Array:
        """Frames of `data` minus their own reference frames, in model units: (n, M) [V/A].

        They are those that `difference` returns with each of these reference frames.
        """
        self._read.add("gain")
        found = np.empty(data.voltages.shape)
        for rows in same_reference(data.references):
            reference = data.references[rows.start]
            change = (data.voltages[rows] - reference) / float(self._gains(reference))
            found[rows] = _estimated(change, self._estimate(reference, gain_power))
        return found

    def as_estimated(self, differences: Array, gain_power: float) -> Array:
        """Differences (n, M) [V/A] of the nominal sensor as `difference` gives those of this one.

        They are measured with the gains and faults that the reference frame shows, and estimated
        again. Gains cannot be taken out without loss: what is learned from is to lose as much.
        """
        estimate = self._estimate(self.reference, gain_power)
        if estimate is None:
            return differences
        gains, _ = self._measured_with(self.reference, gain_power)
        return _estimated(differences * gains, estimate)

    def estimates(
        self, references: Array, gain_power: float = 0.0
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """What `differences` multiplies the differences to reference frames (n, M) with.

        Returns:
            Number (n,) of the matrix for each reference frame, and the matrices (U, M, M), from
            measured to nominal differences; the first is the identity.
        """
        unchanged = np.eye(references.shape[1], dtype=np.float32)
        numbers, matrices = {sha256(unchanged.tobytes()).digest(): 0}, [unchanged]
        which = np.zeros(len(references), dtype=np.int64)
        for rows in same_reference(references):
            estimate = self._estimate(references[rows.start], gain_power)
            if estimate is None:
                continue
            matrix = estimate.astype(np.float32)
            which[rows] = numbers.setdefault(sha256(matrix.tobytes()).digest(), len(matrices))
            if len(numbers) > len(matrices):  # units with the same dead electrode share theirs
                matrices.append(matrix)
        return which, np.array(matrices)

    def _estimate(self, reference: Array, gain_power: float) -> Array | None:
        """(M, M) from measured to nominal differences; None where nothing is to be changed."""
        gains, kept = self._measured_with(reference, gain_power)
        uneven = not np.allclose(gains[kept], 1, rtol=1e-6)
        if kept.all() and not uneven:
            return None
        estimate = estimate_of_nominal(self._gram, gains, kept, WEIGHT if uneven else FAULT_WEIGHT)
        if not uneven:
            estimate[kept] = np.eye(len(kept))[kept]
        return estimate

    def _measured_with(
        self, reference: Array, gain_power: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Gains (M,) of measurements by a reference frame, and True (M,) where no fault spoils.

        Raises:
            InputError: a power of gains below 0.
        """
        if not 0 <= gain_power < np.inf:
            raise InputError(f"The power of gains is at least 0, got {gain_power}.")
        kept = ~spoiled(reference, self._modelled, self._nominal.pattern)
        return gains_of_reference(reference, self._modelled, kept) ** gain_power, kept

    @cached_property
    def _gram(self) -> Array:
        """G (M, M): covariance of the measurements of the smoothest contrasts."""
        rows = self.jacobian[:, self.mask]
        return np.asarray(rows @ smoothed(rows, self.mask))

    def training(self, limit: int | None = None) -> Dataset:
        """The first `limit` samples of the training split, with their truth."""
        return self._noted(self._splits("train", limit))

    def validation(self, limit: int | None = None) -> Dataset:
        """The first `limit` samples of the validation split, with their truth."""
        return self._noted(self._splits("validation", limit))

    def access_record(self) -> AccessRecord:
        """Return what was read so far."""
        return AccessRecord(
            "model" in self._read,
            "gain" in self._read,
            "conductivity_range" in self._read,
            tuple(samples() for _, samples in self._samples.values()),
        )

    def _noted(self, data: Dataset) -> Dataset:
        """Return `data`, noting that the method has read its samples."""
        known, _ = self._samples.get(data.split, (0, None))
        if len(data) > known:  # they are the first ones, always
            # Compared when it is asked for: a method's set-up is timed.
            phantoms, frames = data.phantoms, None if data.phantoms else data.voltages
            source = (data.split, data.scenario, data.data_hash, len(data))
            self._samples[data.split] = (
                len(data),
                lambda: SamplesRead(*source, contents(phantoms, frames)),
            )
        return data

    @staticmethod
    def _frames(sensor: Sensor, voltages: ArrayLike) -> Array:
        if np.iscomplexobj(voltages):
            raise InputError("Frames are complex: give real values, such as in-phase parts.")
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


def _estimated(change: Array, estimate: Array | None) -> Array:
    return np.asarray(change if estimate is None else change @ estimate.T)


def no_split(split: str, limit: int | None) -> Dataset:
    """Refuse to load a split, for problems whose data are read elsewhere."""
    raise RuntimeError(f"The {split} split is read elsewhere.")
