"""The text of OpenEIT boards: magnitudes of an opposition pattern, one line a frame."""

import re
from collections.abc import Sequence

import numpy as np

from eitbench.hardware.protocols.lines import LineProtocol, numbers
from eitbench.hardware.protocols.protocol import Device
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor

MARK = b"magnitudes: "
MODES = {8: b"c", 16: b"d", 32: b"e"}
"""The letter that has a board measure with so many electrodes."""

_COUNTS = {n: opposition_pattern(n).n_measurements for n in MODES}
_UNIT = 1e-3  # V/A; the emulator's, as boards have arbitrary ones


class _OpenEitDevice(Device):
    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.running = True
        self._electrodes = 8  # until a letter comes

    def obey(self, data: bytes) -> bytes:
        # It measures with the electrodes that the sensor has, whichever letter comes.
        if any(line in MODES.values() for line in self._lines(data)):
            self._electrodes = self.sensor.n_electrodes
        return b""

    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        sent = np.zeros(_COUNTS[self._electrodes])
        if self._electrodes == self.sensor.n_electrodes:
            sent[:] = np.abs(values) / _UNIT
        tenths = np.rint(sent * 1e4).astype(np.int64)
        text = "".join(
            f"{whole:8d}.{rest:04d},"
            for whole, rest in zip(*np.divmod(tenths, 10_000), strict=True)
        )
        return MARK + text.encode() + b"\r\n"


class OpenEit(LineProtocol):
    """`magnitudes: ` and 32, 192 or 896 values in the board's own units, for 8, 16 or 32."""

    name = "openeit"
    baud = 115_200
    default_sensor = "ohmc16"
    device = _OpenEitDevice

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._first = True

    @classmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor with another pattern than opposition."""
        n = sensor.n_electrodes
        if n not in MODES or not (
            sensor.pattern.magnitudes
            and np.array_equal(sensor.pattern.table, opposition_pattern(n).table)
        ):
            raise InputError(
                f"Board {cls.name!r} measures magnitudes of the opposition pattern with 8, 16 or "
                f"32 electrodes, and sensor {sensor.name!r} has another pattern: choose a sensor "
                "such as 'ohmc16'."
            )

    def begin(self) -> None:
        """See `Protocol`; the first line may be the end of one."""
        super().begin()
        self._first = True

    def starting(self) -> Sequence[bytes]:
        """The letter of the sensor's number of electrodes."""
        return (MODES[self.sensor.n_electrodes] + b"\n",)

    def _values(self, line: bytes) -> Array | None:
        at, first = line.rfind(MARK), self._first
        self._first = False
        if at < 0:  # without its beginning, a line of values is still known by its commas
            self.health.damaged += not first and line.count(b",") > self.sensor.n_measurements // 2
            return None
        values = numbers(line[at + len(MARK) :])
        if len(values) == self.sensor.n_measurements:
            return values
        self.health.damaged += len(values) not in _COUNTS.values()
        if len(values):
            self._refuse(
                f"The board sends {len(values)} values a frame where sensor {self.sensor.name!r} "
                f"has {self.sensor.n_measurements} (8, 16 and 32 electrodes have 32, 192 and 896): "
                "choose the sensor that is on it."
            )
        return None

    @classmethod
    def recognises(cls, data: bytes) -> bool:
        """The mark, and a number of its form."""
        return re.search(re.escape(MARK) + rb" *\d+\.\d{4},", data) is not None
