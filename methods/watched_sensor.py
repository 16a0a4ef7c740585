"""A nominal sensor that notes which of its physical constants are read."""

import copy

from eitbench.scenarios.sensors.sensor import Sensor

# Electrodes hold their contact impedance, which a method needs no more than for a model.
_NOTED = {"electrodes": "model", "conductivity_range": "conductivity_range"}
_PLAIN = frozenset({"n_electrodes", "describe", "_content"})


class WatchedSensor(Sensor):
    """Equal to the sensor it stands for; reading what `_NOTED` names is noted in `_read`.

    Models are cached by sensor, so that looking one up counts as reading the electrodes.
    """

    _plain: Sensor
    _read: set[str]

    def __getattribute__(self, name: str) -> object:
        if name == "__class__":
            return Sensor  # so that `dataclasses.replace` makes a plain one
        if name in _PLAIN:
            return getattr(object.__getattribute__(self, "_plain"), name)
        if name in _NOTED:
            object.__getattribute__(self, "_read").add(_NOTED[name])
        return object.__getattribute__(self, name)

    def __hash__(self) -> int:
        self._read.add("model")
        return hash(self._plain)

    def __reduce__(self) -> tuple[object, ...]:
        """A copy is one of the sensor itself, with all that it holds."""
        self._read.update(_NOTED.values())
        return copy.copy, (self._plain,)


def watched(sensor: Sensor, read: set[str]) -> Sensor:
    """`sensor`, noting in `read` what is read of it: "model" or "conductivity_range"."""
    noting = object.__new__(WatchedSensor)
    noting.__dict__.update(sensor.__dict__, _plain=sensor, _read=read)
    return noting
