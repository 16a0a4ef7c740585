"""Sensors as JSON in SI units, as recordings store them; `sensor_file` is the form for people."""

import json
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from eitbench.scenarios.declaration import Declaration, Name
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor

MAX_PIXELS = 1024
"""Greatest width and height of an image that a file may ask for."""

Number = Annotated[float, Field(allow_inf_nan=False)]
Index = Annotated[int, Field(ge=0, le=10_000)]
Side = Annotated[int, Field(ge=2, le=MAX_PIXELS)]


class _Outline(Declaration):
    polygon: tuple[tuple[Number, Number], ...] | None = None
    disc: Number | None = None

    def build(self) -> Outline:
        if self.polygon is not None:
            return Polygon(self.polygon)
        if self.disc is not None:
            return Disc(self.disc)
        raise InputError("A sensor needs an outline: a polygon or a disc.")


class _Pattern(Declaration):
    table: tuple[tuple[Index, Index, Index, Index], ...]
    magnitudes: bool


class _Description(Declaration):
    name: Name
    outline: _Outline
    electrodes: tuple[tuple[Number, Number, Number], ...] = Field(min_length=2)
    pattern: _Pattern
    background: Number
    image_shape: tuple[Side, Side]
    data_range: Number
    conductivity_range: tuple[Number, Number]


def sensor_to_json(sensor: Sensor) -> str:
    """Return all of `sensor` with its name as JSON, without loss."""
    return json.dumps({"name": sensor.name, **sensor.describe()}, allow_nan=False)


def sensor_from_json(text: str) -> Sensor:
    """Read the sensor that `sensor_to_json` wrote.

    Raises:
        InputError: text of another kind, or a sensor that cannot be.
    """
    try:
        found = _Description.model_validate_json(text, strict=True)
    except ValidationError as error:
        (first, *_) = error.errors(include_url=False)
        where = ".".join(str(part) for part in first["loc"])
        raise InputError(f"Its sensor is described wrongly: {where}: {first['msg']}.") from error
    return Sensor(
        found.name,
        found.outline.build(),
        tuple(Electrode(*values) for values in found.electrodes),
        DrivePattern(np.array(found.pattern.table, dtype=np.int64), found.pattern.magnitudes),
        found.background,
        found.image_shape,
        found.data_range,
        found.conductivity_range,
    )
