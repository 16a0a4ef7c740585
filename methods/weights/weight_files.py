"""Weights of networks: one file for each network and sensor, the user's own or a packaged one."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.storage.files import sha256_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.scenarios.sensors.sensor import Sensor


LEFT_OUT = "*-large-*.safetensors"
"""Weights that packages lack (`exclude` in pyproject.toml); the metadata of these are there."""


class Weights(NamedTuple):
    """Weights of a file, with its path and the metadata of their training."""

    path: Path
    tensors: dict[str, Tensor]
    metadata: dict[str, str]


@dataclass(frozen=True)
class WeightFiles:
    """The files with weights of one network, for any sensor.

    Attributes:
        name: of the method or operator that uses them.
        version: of the network, raised whenever weights of before no longer fit or mean something
            else.
        made_by: the command that makes such a file; by default `eitbench train`.
    """

    name: str
    version: str = "1"
    made_by: str = ""

    @property
    def command(self) -> str:
        """Command that makes such a file."""
        return self.made_by or f"eitbench train {self.name} --suite SUITE"

    def file_name(self, sensor: Sensor) -> str:
        """Return the name of the file with weights for `sensor`."""
        return f"{self.name}-{sensor.name}-{sensor_key(sensor)[:12]}.safetensors"

    def save(
        self, path: Path, sensor: Sensor, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """Write a file of weights for `sensor`, with `metadata` of their training.

        Raises:
            EitbenchError: the folder is not writable or full.
        """
        fixed = {
            "network_version": self.version,
            "sensor": sensor.name,
            "sensor_key": sensor_key(sensor),
            "weights_of": self.name,
        }
        arrays = {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}
        write_arrays(path, arrays, {**metadata, **fixed})

    def load(self, sensor: Sensor, path: Path | None = None) -> Weights:
        """Return weights for `sensor`: of the file `path`, or the user's own, or the packaged ones.

        Raises:
            InputError: there are none, or they belong to another sensor or version of the network.
            DataCorruptError: the file is damaged.
        """
        given = path is not None
        path = path or self._found(sensor)
        if path is None:
            raise InputError(self.missing(sensor))
        try:
            found = read_arrays(path)
        except DataCorruptError as error:
            raise DataCorruptError(f"{error} {self._again(path, given)}") from error
        if found is None:
            raise InputError(f"There is no file of weights {path}: make it with `{self.command}`.")
        arrays, metadata = found
        if metadata.get("sensor_key") != sensor_key(sensor):
            raise InputError(
                f"{path} holds weights for another sensor than {sensor.name!r}: they were trained "
                f"for {metadata.get('sensor')!r}. {self._again(path, given)}"
            )
        if (of := metadata.get("weights_of", self.name)) != self.name:
            raise InputError(
                f"{path} holds weights of {of!r}, not of {self.name!r}. {self._again(path, given)}"
            )
        if metadata.get("network_version") != self.version:
            raise InputError(
                f"{path} holds weights for version {metadata.get('network_version')} of "
                f"{self.name!r}, and this is version {self.version}. {self._again(path, given)}"
            )
        from torch import from_numpy

        return Weights(path, {name: from_numpy(array) for name, array in arrays.items()}, metadata)

    def metadata(self, sensor: Sensor) -> Mapping[str, str]:
        """Metadata of the file that `load` takes for `sensor`; none if it cannot be read."""
        found = None
        if path := self._found(sensor):
            with suppress(DataCorruptError):  # `load` says so
                found = read_arrays(path)
        return found[1] if found else {}

    def missing(self, sensor: Sensor) -> str:
        """Return the sentence that there are no weights for `sensor`, and what to do."""
        height, width = sensor.image_shape
        name = self.file_name(sensor)
        trained = (packaged_weights() / name).with_suffix(".json").is_file()
        if trained and fnmatch(name, LEFT_OUT):
            return (
                f"The weights of {self.name!r} for the sensor {sensor.name!r} are in no package, "
                f"for their size: copy methods/weights/{LEFT_OUT} from the repository to "
                f"{user_weights()}."
            )
        return (
            f"{self.name!r} has no weights for the sensor {sensor.name!r} with "
            f"{sensor.n_measurements} measurements on {height} x {width} pixels: train them with "
            f"`{self.command}`{'' if self.made_by else ', where SUITE simulates this sensor'}."
        )

    def content_hash(self, sensor: Sensor) -> str:
        """SHA-256 (hex) of the file that `load` takes for `sensor`; "" if there is none."""
        path = self._found(sensor)
        return sha256_of(path) if path else ""

    def _found(self, sensor: Sensor) -> Path | None:
        places = (
            folder / self.file_name(sensor) for folder in (user_weights(), packaged_weights())
        )
        return next((path for path in places if path.is_file()), None)

    def _again(self, path: Path, given: bool) -> str:
        if given:
            return f"Name another file, or train with `{self.command}`."
        if path.parent == packaged_weights():
            return f"Install eitbench again, or train your own weights with `{self.command}`."
        return f"Delete it, or train again with `{self.command}`."


def sensor_key(sensor: Sensor) -> str:
    """SHA-256 (hex) of what decides voltages; sensors that differ only in priors share it."""
    physics = sensor.describe()
    del physics["data_range"], physics["conductivity_range"]
    return content_hash(physics)


def user_weights() -> Path:
    """Return the folder of the weights that the user trained; they precede the packaged ones."""
    return cache_dir() / "weights"


def packaged_weights() -> Path:
    """Return the folder of the weights that come with the package."""
    return Path(str(files("eitbench.methods"))) / "weights"
