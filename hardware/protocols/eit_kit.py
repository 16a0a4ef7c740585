"""The text of boards derived from EIT-kit: n x n values, zero on driven pairs, among free text.

Row i drives (i, i + k), column j measures (j, j + k), with the offset k of the sensor's pattern.
Lines are `v, v, ...` with 4 decimals, or begin with ORIGIN_DATA, the board's own reference, or
FRAME_DATA. There is no checksum: a line counts if it has n x n numbers and its zeros are the
pattern's.
"""

import math
import re

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.protocols.lines import NUMBERS, LineProtocol, numbers
from eitbench.hardware.protocols.protocol import Device
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor

ORIGIN, FRAME = b"ORIGIN_DATA,", b"FRAME_DATA,"

_LEAST = 8  # electrodes; rows of fewer numbers are free text
_CHATTER = 50  # frames from one line of free text of the emulated board to the next


def driven(n_electrodes: int, offset: int) -> NDArray[np.bool_]:
    """(n, n): the entries whose pair shares an electrode with the drive pair."""
    i, j = np.indices((n_electrodes, n_electrodes))
    apart = (j - i) % n_electrodes
    return np.isin(apart, [0, offset, n_electrodes - offset])


def offset_of(sensor: Sensor) -> int | None:
    """The offset k of a pattern of pairs (i, i + k); None if it has others."""
    src, sink, a, b = sensor.pattern.table.T
    offsets = np.concatenate([sink - src, b - a]) % sensor.n_electrodes
    return int(offsets[0]) if (offsets == offsets[0]).all() else None


class _EitKitDevice(Device):
    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.running = True

    def obey(self, data: bytes) -> bytes:
        return b""

    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        n = self.sensor.n_electrodes
        matrix = np.zeros((n, n))
        matrix[self.sensor.pattern.table[:, 0], self.sensor.pattern.table[:, 2]] = values
        line = ", ".join(f"{value:.4f}" for value in matrix.ravel())
        chatter = "" if number % _CHATTER else f"Frame {number}, {n} electrodes\n"
        return f"{chatter}{line}\n".encode()


class EitKit(LineProtocol):
    """Matrices of values in the board's own units, of which the pattern's entries are taken."""

    name = "eit-kit"
    baud = 115_200
    device = _EitKitDevice

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._n = sensor.n_electrodes
        self._zeros = driven(self._n, offset_of(sensor) or 0)

    @classmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor with other pairs than (i, i + k), or with driven ones."""
        table = sensor.pattern.table
        offset = offset_of(sensor)
        if offset is None or driven(sensor.n_electrodes, offset)[table[:, 0], table[:, 2]].any():
            raise InputError(
                f"Board {cls.name!r} drives and measures pairs (i, i + k) that share no electrode, "
                f"and sensor {sensor.name!r} has other pairs: choose a sensor such as 'foam16'."
            )

    def _values(self, line: bytes) -> Array | None:
        origin, frame = line.rfind(ORIGIN), line.rfind(FRAME)
        marked = max(origin, frame)
        if marked >= 0:
            text = line[line.index(b",", marked) + 1 :]
        else:
            # Free text may stand before the first number.
            text = line[len(line.rstrip(NUMBERS)) :]
        values = numbers(text)
        matrix = self._matrix(values)
        if matrix is None:
            matrix = self._matrix(self._last(line))
        if matrix is None:
            self._look_into(values)
            self.health.damaged += marked >= 0 or line.count(b",") > self._n**2 // 2
        elif origin <= frame:
            table = self.sensor.pattern.table
            return matrix[table[:, 0], table[:, 2]]
        return None

    def _matrix(self, values: Array) -> Array | None:
        """The matrix (n, n) of `values`; None if they are not as many, or not 0 on driven pairs."""
        if len(values) != self._n**2:
            return None
        matrix = values.reshape(self._n, self._n)
        return matrix if (matrix[self._zeros] == 0).all() else None

    def _last(self, line: bytes) -> Array:
        """The last n x n numbers of a `line`, whatever stands before them."""
        texts = line.rstrip(b", \t").rsplit(b",", self._n**2 - 1)
        if len(texts) < self._n**2:
            return np.empty(0)
        # The first is 0, as it is a driven pair; what stood before may be glued to it.
        return np.concatenate([[0.0], numbers(b",".join(texts[1:]))])

    def _look_into(self, values: Array) -> None:
        """Refuse the `values` of a line with the pattern that they seem to have."""
        n, side = self._n, math.isqrt(len(values))
        if len(values) < min(n, _LEAST) ** 2:
            return  # free text
        advice = "choose the sensor that is on it, or set the board to its pattern."
        has = f"where sensor {self.sensor.name!r} has {n} and {offset_of(self.sensor)}: {advice}"
        zero = values[: side**2].reshape(side, side) == 0
        # k and n - k have the same zeros.
        offset = next((k for k in range(1, side // 2 + 1) if zero[driven(side, k)].all()), None)
        if side**2 != len(values):
            self._refuse(f"The board sends {len(values)} values a line, not {n} x {n}: {advice}")
        elif offset is not None:
            self._refuse(f"The board measures with {side} electrodes and offset {offset} {has}")
        else:
            self._refuse(f"The board sends {side} x {side} values that are not 0 on driven pairs.")

    @classmethod
    def recognises(cls, data: bytes) -> bool:
        """A mark, or many numbers with 4 decimals."""
        return re.search(rb"ORIGIN_DATA,|FRAME_DATA,|(?:-?\d+\.\d{4}, ?){32}", data) is not None
