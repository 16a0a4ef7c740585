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
from eitbench.hardware.protocols.protocol import Array, Device
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors import Sensor

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
    title = "text of boards derived from EIT-kit, n x n values a line"
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
            found = numbers(line[line.index(b",", marked) + 1 :])
        else:
            # Free text may stand before the first number.
            found = numbers(line[len(line.rstrip(NUMBERS)) :])
        matrix = self._matrix(found)
        if matrix is None:
            self.health.damaged += marked >= 0 or len(found) > self._n**2 // 2
        elif not origin > frame:
            table = self.sensor.pattern.table
            return matrix[table[:, 0], table[:, 2]]
        return None

    def _matrix(self, values: Array) -> Array | None:
        """The matrix (n, n) at the end of a line's `values`; None if there is none."""
        n, side = self._n, math.isqrt(len(values))
        if side != n and side**2 == len(values) and side >= _LEAST:
            other = values.reshape(side, side)
            if any(_matches(other, k) for k in _offsets(side)):
                self._refuse(
                    f"The board measures with {side} electrodes where sensor "
                    f"{self.sensor.name!r} has {n}: choose the sensor that is on it."
                )
                return None
        if len(values) < n**2:
            return None
        matrix = values[-(n**2) :].reshape(n, n)
        if (matrix[self._zeros] == 0).all():
            return matrix
        for offset in _offsets(n):
            if _matches(matrix, offset):
                self._refuse(
                    f"The board's zeros are those of offset {offset} where sensor "
                    f"{self.sensor.name!r} has offset {offset_of(self.sensor)}: choose the sensor "
                    "that is on it, or set the board to its offset."
                )
        return None

    @classmethod
    def recognises(cls, data: bytes) -> bool:
        """A mark, or many numbers with 4 decimals."""
        return re.search(rb"ORIGIN_DATA,|FRAME_DATA,|(?:-?\d+\.\d{4}, ?){32}", data) is not None


def _offsets(n_electrodes: int) -> range:
    """Offsets that the zeros tell apart: k and n - k have the same."""
    return range(1, n_electrodes // 2 + 1)


def _matches(matrix: Array, offset: int) -> bool:
    return bool((matrix[driven(len(matrix), offset)] == 0).all())
