"""Weights of the surrogate: one file for each sensor, the user's own or one from the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from eitbench.methods.tensor_file import read_tensors, write_tensors
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.sensors import content_hash

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.scenarios.sensors import Sensor

# Raised by one whenever weights of before no longer fit the network or mean something else.
NETWORK_VERSION = "1"

TRAIN = "eitbench train surrogate --suite SUITE"


def sensor_key(sensor: Sensor) -> str:
    """SHA-256 (hex) of what decides voltages; sensors that differ only in priors share it."""
    physics = sensor.describe()
    del physics["data_range"], physics["conductivity_range"]
    return content_hash(physics)


def file_name(sensor: Sensor) -> str:
    """What the file with weights for `sensor` is called."""
    return f"surrogate-{sensor.name}-{sensor_key(sensor)[:12]}.safetensors"


def user_weights() -> Path:
    """Where the weights that the user trained are kept; they come before the packaged ones."""
    return cache_dir() / "weights"


def packaged_weights() -> Path:
    """Where the weights that come with the package are kept."""
    return Path(str(files("eitbench.methods.operators"))) / "weights"


def save_weights(
    path: Path, sensor: Sensor, tensors: Mapping[str, Tensor], about: Mapping[str, str]
) -> None:
    """Write a file of weights for `sensor`, with what is known `about` their training.

    Raises:
        EitbenchError: the folder is not writable or full.
    """
    fixed = {
        "network_version": NETWORK_VERSION,
        "sensor": sensor.name,
        "sensor_key": sensor_key(sensor),
    }
    write_tensors(path, tensors, {**about, **fixed})


def load_weights(sensor: Sensor) -> tuple[Path, dict[str, Tensor], dict[str, str]]:
    """The file with the weights for `sensor`, the weights, and what is known of their training.

    Raises:
        InputError: there are none, or they belong to another sensor or version of the network.
        DataCorruptError: the file is damaged.
    """
    for folder in (user_weights(), packaged_weights()):
        path = folder / file_name(sensor)
        try:
            found = read_tensors(path)
        except DataCorruptError as error:
            raise DataCorruptError(f"{error} {_again(folder)}") from error
        if found is None:
            continue
        tensors, about = found
        if about.get("sensor_key") != sensor_key(sensor):
            raise InputError(
                f"{path} holds weights for another sensor, {about.get('sensor')!r}, than "
                f"{sensor.name!r}. {_again(folder)}"
            )
        if about.get("network_version") != NETWORK_VERSION:
            raise InputError(
                f"{path} holds weights for version {about.get('network_version')} of the "
                f"surrogate, and this is version {NETWORK_VERSION}. {_again(folder)}"
            )
        return path, tensors, about
    height, width = sensor.image_shape
    raise InputError(
        f"The surrogate has no weights for the sensor {sensor.name!r} with {sensor.n_measurements} "
        f"measurements on {height} x {width} pixels: train them with `{TRAIN}`, where SUITE "
        "simulates this sensor."
    )


def _again(folder: Path) -> str:
    if folder == user_weights():
        return f"Delete it, or train again with `{TRAIN}`."
    return f"Install eitbench again, or train your own weights with `{TRAIN}`."
