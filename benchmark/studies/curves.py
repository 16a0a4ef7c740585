"""Learning curves, which lie beside trained weights."""

import json

import pandas as pd

from eitbench.methods.learned.image_networks import TrainedMethod
from eitbench.methods.registry import methods
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.sensors.sensor import Sensor, foam16


def learning_curve(method: str, sensor: Sensor) -> pd.DataFrame:
    """Return the learning curve of the weights that `method` uses for `sensor`, a row per epoch.

    Columns: `epoch`, `train` and `validation` (data loss), `train_physical` and
    `validation_physical` where the training logged them, `rate`, `seconds`.

    Raises:
        InputError: there are no weights, or no curve beside them, or the method learns nothing.
        DataCorruptError: the weights or the curve are damaged.
    """
    cls = methods().get(method)
    if cls is None or not issubclass(cls, TrainedMethod):
        raise InputError(f"{method!r} is no method that is trained.")
    path = cls.files.load(sensor).path.with_suffix(".json")
    if not path.is_file():
        raise InputError(f"There is no learning curve {path} beside the weights of {method!r}.")
    try:
        return pd.DataFrame(json.loads(path.read_text())["curve"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataCorruptError(
            f"{path} holds no learning curve: train {method!r} again."
        ) from error


def paper_curves() -> dict[str, pd.DataFrame]:
    """Return the learning curves of "dnn" and "phydnn" on the sensor of the paper.

    Raises:
        InputError, DataCorruptError: as `learning_curve`.
    """
    return {name: learning_curve(name, foam16()) for name in ("dnn", "phydnn")}
