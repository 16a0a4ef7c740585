"""Recordings as plain values and arrays, as CSV and MATLAB files hold them."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.recordings.files.recording_file import (
    Content,
    header_of,
    table_of,
    table_rows,
)
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import sensor_from_json

COLUMNS = ("number", "time_s", "received_s")
"""Columns of every frame beside its values."""
NO_TIMES = "imported without times: 1 s between frames is assumed"


def head_of(content: Content) -> dict[str, Any]:
    """All of a recording but its frames, as values that JSON has."""
    return {
        **header_of(content),
        "reference": content.reference.tolist(),
        "labels": content.labels.to_dict("list"),
        "events": content.events.to_dict("list"),
    }


def content_of(
    head: dict[str, Any], columns: dict[str, NDArray[Any]], values: NDArray[Any], path: Path
) -> Content:
    """Return the recording of a header by `head_of`, columns and values (n, M) of its frames.

    Raises:
        DataCorruptError: something is missing, or of another kind.
    """
    try:
        content = Content(
            sensor=sensor_from_json(head["sensor"]),
            board=str(head["board"]),
            firmware=str(head["firmware"]),
            emulated=bool(head["emulated"]),
            started=str(head["started"]),
            number=columns["number"].astype(np.int64),
            time_s=columns["time_s"].astype(np.float64),
            received_s=columns["received_s"].astype(np.float64),
            values=values.astype(np.float64),
            reference=np.array(head["reference"], dtype=np.int64).reshape(-1),
            labels=table_of(table_rows(pd.DataFrame(head["labels"]), layout.LABEL)),
            events=table_of(table_rows(pd.DataFrame(head["events"]), layout.EVENT)),
        )
    except InputError as error:
        raise DataCorruptError(f"{path} cannot be imported: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataCorruptError(
            f"{path} cannot be imported: its header is not complete ({error})."
        ) from error
    check_width(content.values, content.sensor, path)
    return content


def frames_alone(values: NDArray[np.float64], sensor: Sensor | None, path: Path) -> Content:
    """Return a recording of frames (n, M) alone.

    Raises:
        InputError: no sensor, or one of another number of values.
    """
    if sensor is None:
        raise InputError(f"{path} does not say on which sensor it was measured: give --sensor.")
    check_width(values, sensor, path)
    count = np.arange(len(values))
    return Content(
        sensor=sensor,
        board="imported",
        firmware="",
        emulated=False,
        started="unknown",
        number=count,
        time_s=count.astype(np.float64),
        received_s=count.astype(np.float64),
        values=values,
        reference=np.empty(0, dtype=np.int64),
        labels=table_of(np.empty(0, dtype=layout.LABEL)),
        events=pd.DataFrame({"time_s": [0.0], "text": [NO_TIMES]}),
    )


def check_width(values: NDArray[np.float64], sensor: Sensor, path: Path) -> None:
    """Refuse frames (n, M) that `sensor` does not measure.

    Raises:
        InputError: another number of values.
    """
    if values.ndim != 2 or values.shape[1] != sensor.n_measurements:
        raise InputError(
            f"{path} has values of shape {values.shape}, and a frame of sensor {sensor.name!r} "
            f"has {sensor.n_measurements}: name the sensor that it was measured on."
        )
