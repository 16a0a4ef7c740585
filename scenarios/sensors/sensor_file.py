"""Sensors in files: declared in TOML by people, and stored as JSON in SI units by recordings."""

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from eitbench.scenarios.declaration import Declaration, Name, field_error, read_declaration
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon, rectangle
from eitbench.scenarios.sensors.patterns import DrivePattern, ring_pattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, even_electrodes

MAX_PIXELS = 1024
"""Greatest width and height of an image that a file may ask for."""

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Index = Annotated[int, Field(ge=0, le=10_000)]
Row = tuple[Index, Index, Index, Index]
Side = Annotated[int, Field(ge=2, le=MAX_PIXELS)]
ConductivityRange = tuple[
    Annotated[float, Field(gt=0, lt=1)], Annotated[float, Field(ge=1, allow_inf_nan=False)]
]
_MM = 1e-3


class _Fields(Declaration):
    name: Name
    background: Positive = 1.0
    image_shape: tuple[Side, Side] = (48, 48)
    data_range: Positive | None = None
    conductivity_range: ConductivityRange = (0.05, 20.0)

    def with_parts(
        self, outline: Outline, electrodes: tuple[Electrode, ...], pattern: DrivePattern
    ) -> Sensor:
        fields = {name: getattr(self, name) for name in _Fields.model_fields}
        if self.data_range is None:
            del fields["data_range"]
        return Sensor(outline=outline, electrodes=electrodes, pattern=pattern, **fields)


class _Polygon(Declaration):
    polygon: tuple[tuple[Number, Number], ...]


class _Disc(Declaration):
    disc: Number


class _Pattern(Declaration):
    table: tuple[Row, ...]
    magnitudes: bool


class _Description(_Fields):
    outline: _Polygon | _Disc
    electrodes: tuple[tuple[Number, Number, Number], ...] = Field(min_length=2)
    pattern: _Pattern


def toml_string(text: str) -> str:
    """The text as a string of a TOML file, which is UTF-8: TOML has no pairs of surrogates."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


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
    rim, pattern = found.outline, found.pattern
    return found.with_parts(
        Polygon(rim.polygon) if isinstance(rim, _Polygon) else Disc(rim.disc),
        tuple(Electrode(*values) for values in found.electrodes),
        DrivePattern(np.array(pattern.table), pattern.magnitudes),
    )


def sensor_to_toml(sensor: Sensor, remarks: Sequence[str] = ()) -> str:
    """The sensor file of `sensor`, with every row of its pattern, below lines of `remarks`.

    `read_sensor` reads it, as the same sensor but where no number of mm is exactly a length.
    """

    def listed(values: Iterable[float]) -> str:
        return "[" + ", ".join(repr(float(value)) for value in values) + "]"

    rim = sensor.outline
    if isinstance(rim, Disc):
        outline = f"disc_radius_mm = {float(_millimetres(rim.radius))!r}"
    else:
        outline = "polygon_mm = [\n"
        outline += (
            "".join(f"    {listed((_millimetres(x), _millimetres(y)))},\n" for x, y in rim.vertices)
            + "]"
        )
    of = sensor.electrodes
    lines = [
        *(f"# {' '.join(remark.split())}" for remark in remarks),
        f"name = {toml_string(sensor.name)}",
        f"background = {float(sensor.background)!r}",
        f"image_shape = {list(sensor.image_shape)}",
        f"data_range = {float(sensor.data_range)!r}",
        f"conductivity_range = {listed(sensor.conductivity_range)}",
        "",
        "[outline]",
        outline,
        "",
        "[electrodes]",
        f"centres_mm = {listed(_millimetres(electrode.centre) for electrode in of)}",
        f"width_mm = {listed(_millimetres(electrode.width) for electrode in of)}",
        f"contact_impedance = {listed(electrode.contact_impedance for electrode in of)}",
        "",
        "[pattern]  # src, sink, a, b of each value",
        f"magnitudes = {str(sensor.pattern.magnitudes).lower()}",
        "table = [",
        *(f"    {row}," for row in sensor.pattern.table.tolist()),
        "]",
    ]
    return "\n".join(lines) + "\n"


def _millimetres(metres: float) -> float:
    """The number [mm] of fewest digits that is read as this length, or the nearest."""
    near = metres / _MM
    found = [float(f"{near:.{digits}g}") for digits in (15, 16, 17)]
    found += [math.nextafter(near, end) for end in (-math.inf, math.inf)]
    return next((mm for mm in found if mm * _MM == metres), near)


def _several(value: object) -> object:
    return tuple(value) if isinstance(value, list) else (value,)


OneOrEach = Annotated[tuple[Positive, ...], BeforeValidator(_several)]


class OutlineDeclaration(Declaration):
    """The rim: one of the three.

    Attributes:
        rectangle_mm: width and height [mm]; the lower-left corner is the origin.
        disc_radius_mm: radius [mm]; the centre is the origin.
        polygon_mm: vertices (x, y) [mm], counter-clockwise.
    """

    rectangle_mm: tuple[Positive, Positive] | None = None
    disc_radius_mm: Positive | None = None
    polygon_mm: tuple[tuple[Number, Number], ...] | None = None

    @model_validator(mode="after")
    def _one(self) -> "OutlineDeclaration":
        if len(self.model_fields_set) != 1:
            raise ValueError("it has one of `rectangle_mm`, `disc_radius_mm` and `polygon_mm`")
        return self

    def build(self) -> Outline:
        """The outline [m]."""
        if self.rectangle_mm is not None:
            width, height = self.rectangle_mm
            return rectangle(width * _MM, height * _MM)
        if self.disc_radius_mm is not None:
            return Disc(self.disc_radius_mm * _MM)
        return Polygon(tuple((x * _MM, y * _MM) for x, y in self.polygon_mm or ()))


class ElectrodesDeclaration(Declaration):
    """The electrodes on the rim: `count` of them evenly, or one at each of `centres_mm`.

    Arc lengths start at the first corner of a rectangle or polygon, and at the positive x axis of
    a disc, and run counter-clockwise.

    Attributes:
        count: number of electrodes, which are evenly spaced.
        start_mm: arc length of the first one's centre [mm].
        clockwise: they are numbered clockwise.
        centres_mm: arc length of every centre [mm].
        width_mm: width along the rim [mm], one for all or one for each.
        contact_impedance: [Ohm*m2], with conductivities in S/m; one for all or one for each.
    """

    count: Annotated[int, Field(ge=2, le=1024)] | None = None
    start_mm: Number = 0.0
    clockwise: bool = False
    centres_mm: tuple[Number, ...] | None = Field(default=None, min_length=2)
    width_mm: OneOrEach
    contact_impedance: OneOrEach = (1e-3,)

    @model_validator(mode="after")
    def _either(self) -> "ElectrodesDeclaration":
        if (self.count is None) == (self.centres_mm is None):
            raise ValueError("it has either `count` or `centres_mm`")
        if self.centres_mm is not None and self.model_fields_set & {"start_mm", "clockwise"}:
            raise ValueError("`start_mm` and `clockwise` go with `count`")
        for name in ("width_mm", "contact_impedance"):
            given = len(getattr(self, name))
            if given not in (1, self.n):
                raise ValueError(f"`{name}` has {given} values for {self.n} electrodes")
        return self

    @property
    def n(self) -> int:
        """Their number."""
        return self.count or len(self.centres_mm or ())

    def build(self, outline: Outline) -> tuple[Electrode, ...]:
        """The electrodes [m].

        Raises:
            InputError: a centre is farther along the rim than it is long.
        """
        centres = [centre * _MM for centre in self.centres_mm or ()]
        if centres and max(map(abs, centres)) > outline.perimeter:
            raise InputError(
                f"`centres_mm` are along the rim, which has {outline.perimeter / _MM:.1f} mm; got "
                f"{max(centres, key=abs) / _MM:g}."
            )
        if self.count is not None:
            start = self.start_mm * _MM
            even = even_electrodes(outline, self.count, 1, 1, start=start, clockwise=self.clockwise)
            centres = [electrode.centre for electrode in even]
        widths = np.broadcast_to(np.multiply(self.width_mm, _MM), self.n).tolist()
        impedances = np.broadcast_to(self.contact_impedance, self.n).tolist()
        return tuple(map(Electrode, centres, widths, impedances))


class PatternDeclaration(Declaration):
    """The drive pattern: `offset`, `drive` with `sense`, or `table`.

    Attributes:
        offset: drive (i, i + offset), measure (j, j + offset).
        drive: drive (i, i + drive); a negative offset -k drives (i + k, i).
        sense: measure (j, j + sense); a negative offset -k measures (j + k, j).
        rotating: j ascends from i, not from 0 (EIDORS: `rotate_meas`; not with `table`).
        driven: pairs that share an electrode with the drive are measured, too (not with `table`).
        table: one row src, sink, a, b for each value.
        magnitudes: the board reports values without their sign.
    """

    offset: int | None = None
    drive: int | None = None
    sense: int | None = None
    rotating: bool = False
    driven: bool = False
    table: tuple[Row, ...] | None = Field(default=None, min_length=1)
    magnitudes: bool = False

    @model_validator(mode="after")
    def _one(self) -> "PatternDeclaration":
        given = [name for name in ("offset", "drive", "table") if getattr(self, name) is not None]
        if len(given) != 1 or (self.drive is None) != (self.sense is None):
            raise ValueError("it has one of `offset`, `drive` with `sense`, and `table`")
        if (self.driven or self.rotating) and self.table is not None:
            raise ValueError("`driven` and `rotating` do not go with `table`")
        return self

    def build(self, n_electrodes: int) -> DrivePattern:
        """The pattern of `n_electrodes`."""
        if self.table is None:
            drive = self.offset or self.drive or 0
            sense = self.offset or self.sense or 0
            return ring_pattern(
                n_electrodes, drive, sense,
                rotating=self.rotating, driven=self.driven, magnitudes=self.magnitudes,
            )  # fmt: skip
        table = np.array(self.table, dtype=np.int64)
        if table.max() >= n_electrodes:
            raise InputError(
                f"The table uses electrode {table.max()}, and there are electrodes 0 to "
                f"{n_electrodes - 1}."
            )
        return DrivePattern(table, magnitudes=self.magnitudes)


class SensorDeclaration(_Fields):
    """A sensor file; `Sensor` explains the fields."""

    outline: OutlineDeclaration
    electrodes: ElectrodesDeclaration
    pattern: PatternDeclaration


def read_sensor(path: Path) -> Sensor:
    """The sensor declared in the TOML file at `path`.

    Raises:
        InputError: the file cannot be read or declares something wrong; the field is named.
    """
    declared = read_declaration("Sensor", path, SensorDeclaration)
    field = "outline"
    try:
        outline = declared.outline.build()
        field = "pattern"
        pattern = declared.pattern.build(declared.electrodes.n)
        field = "electrodes"
        return declared.with_parts(outline, declared.electrodes.build(outline), pattern)
    except InputError as error:
        # Beside where electrodes are, a sensor refuses pixels that are too coarse for its outline.
        field = "image_shape" if "image_shape" in str(error) else field
        raise field_error("Sensor", path, (field,), error) from error
