"""What a frame is compared with: the transfer resistances between all electrodes of a sensor.

Every value of a linear sensor is V = R[a, src] - R[b, src] - R[a, sink] + R[b, sink] of one
symmetric matrix R (E, E), so that one matrix predicts the frame of any wiring. It is the model's,
or, for a skin that no model describes, the model's with the least change that explains a frame
measured while the wiring was right. What that frame holds is taken as it was measured, as boards
are not quite linear: some show another size for a drive and its reverse.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import difference_map, forward_model, signed_voltages
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.wiring.hypotheses import Table


def modelled_resistances(sensor: Sensor) -> Array:
    """Transfer resistances (E, E) [Ohm] of the untouched nominal `sensor`."""
    model = forward_model(sensor)
    _, fields = model.voltages_and_fields(model.background[None])
    return np.array(fields[0, len(model.mesh.nodes) :])


def all_values(resistances: Array) -> Array:
    """(E, E, E, E): the value of every row src, sink, a, b from `resistances` (E, E)."""
    between = resistances[:, None, :] - resistances[None, :, :]  # a, b, electrode driven
    return np.asarray(np.moveaxis(between[..., :, None] - between[..., None, :], (0, 1), (2, 3)))


@dataclass(frozen=True, eq=False)
class Completion:
    """From a frame of a sensor to the values of any row, measured or not.

    Attributes:
        sensor: nominal.
        modelled: (E, E) its resistances.
    """

    sensor: Sensor
    modelled: Array

    @cached_property
    def _inverse(self) -> Array:
        """(E * E, M): the least change of resistances that explains a change of values."""
        differences = difference_map(self.sensor.pattern.table, self.sensor.n_electrodes)
        return np.asarray(np.linalg.pinv(differences, rcond=1e-6))

    @cached_property
    def measured(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(E, E, E, E): which value of a frame each row is, -1 for none, and its sign.

        Of a row and its reverses or its reciprocal the same one is taken where it was measured.
        """
        e = self.sensor.n_electrodes
        row, sign = np.full((e,) * 4, -1), np.ones((e,) * 4, dtype=np.int64)
        src, sink, a, b = self.sensor.pattern.table.T
        here = np.arange(len(src))
        # The last one counts: the same row, after its reverses, after reciprocal ones.
        for first, second in (((a, b), (src, sink)), ((src, sink), (a, b))):
            for turned in ((1, 1), (0, 1), (1, 0), (0, 0)):
                i, j = first[:: -1 if turned[0] else 1]
                k, m = second[:: -1 if turned[1] else 1]
                row[i, j, k, m] = here
                sign[i, j, k, m] = -1 if sum(turned) == 1 else 1
        return row, sign

    def resistances(self, frame: Array) -> Array:
        """Resistances (E, E) that explain `frame` (M,), nearest to the model's times a gain."""
        pattern = self.sensor.pattern
        expected = signed_voltages(pattern.table, self.modelled)
        signed = frame * np.where(expected < 0, -1.0, 1.0) if pattern.magnitudes else frame
        gain = float(signed @ expected / (expected @ expected))
        # A skin that the model does not describe has a size beside it, but hardly a gain.
        size = float(np.median(np.abs(signed)) / np.median(np.abs(expected)))
        gain = float(np.copysign(max(abs(gain), 0.1 * size), gain))
        change = self._inverse @ (signed - gain * expected)
        return np.asarray(gain * self.modelled + change.reshape(self.modelled.shape))

    def values(self, frame: Array, table: Table) -> Array:
        """Values (M',) of the rows of `table` (M', 4) on the sensor that gave `frame` (M,).

        Magnitudes where the sensor's pattern has them.
        """
        row, sign = (part[tuple(table.T)] for part in self.measured)
        taken = frame[row] * (1 if self.sensor.pattern.magnitudes else sign)
        if (row < 0).any():
            modelled = signed_voltages(table, self.resistances(frame))
            modelled = np.abs(modelled) if self.sensor.pattern.magnitudes else modelled
            taken = np.where(row < 0, modelled, taken)
        return np.asarray(taken)

    def all_values(self, frame: Array) -> Array:
        """(E, E, E, E): the value of every row src, sink, a, b.

        Raises:
            InputError: a frame of another length, of zeros, or of values that are no numbers.
        """
        wanted = self.sensor.n_measurements
        if frame.shape != (wanted,) or not np.isfinite(frame).all() or not frame.any():
            raise InputError(
                f"A frame of the right wiring has {wanted} values that are numbers and not all 0, "
                f"got shape {frame.shape}: take one of sensor {self.sensor.name!r}."
            )
        row, sign = self.measured
        rest = all_values(self.resistances(frame))
        signs = np.where(rest < 0, -1, 1) if self.sensor.pattern.magnitudes else sign
        return np.where(row < 0, rest, frame[row] * signs)


def known_values(frames: Array, sensor: Sensor) -> Array:
    """(E, E, E, E): the value of every row, from `frames` (n, M) of the right wiring.

    Raises:
        InputError: frames of zeros, or of values that are no numbers.
    """
    completion = Completion(sensor, modelled_resistances(sensor))
    return completion.all_values(np.median(frames, axis=0))
