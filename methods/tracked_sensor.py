"""A nominal sensor that tracks which of its physical constants are read."""

import copy

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
