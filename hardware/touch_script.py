"""Touches of an emulated board, scripted in a TOML file.

    [[touches]]
    start_s = 5.0
    end_s = 8.0
    x_mm = 30.0
    y_mm = 60.0
    radius_mm = 6.0
    pressure_kpa = 20.0

Times count from the moment the board is switched on; places are in the sensor's frame.
"""

import json
import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from eitbench.hardware.emulated_sensor import Touch
from eitbench.scenarios.declaration import key_lines
from eitbench.scenarios.errors import InputError

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ScriptedTouch(BaseModel):
    """One touch: from `start_s` to `end_s` a disc presses at (`x_mm`, `y_mm`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    start_s: Finite = Field(ge=0)
    end_s: Finite
    x_mm: Finite
    y_mm: Finite
    radius_mm: Finite = Field(gt=0)
    pressure_kpa: Finite = Field(gt=0)

    @field_validator("end_s")
    @classmethod
    def _later(cls, value: float, info: ValidationInfo) -> float:
        if value <= info.data.get("start_s", -1.0):
            raise ValueError("a touch ends later than it starts")
        return value

    @property
    def touch(self) -> Touch:
        """The touch, in SI units."""
        return Touch(
            self.x_mm * 1e-3, self.y_mm * 1e-3, self.radius_mm * 1e-3, self.pressure_kpa * 1e3
        )


class TouchScript(BaseModel):
    """What happens to an emulated board."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    touches: tuple[ScriptedTouch, ...] = Field(min_length=1)

    def at(self, time_s: float) -> list[Touch]:
        """The touches at `time_s` [s]."""
        return [t.touch for t in self.touches if t.start_s <= time_s < t.end_s]


def read_script(path: Path) -> TouchScript:
    """The touches scripted in the TOML file at `path`.

    Raises:
        InputError: the file cannot be read or scripts something wrong (the line and the field are
            named).
    """
    try:
        text = path.read_text(encoding="utf-8")
        declared = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"Cannot read the touch script {path}: {reason}.") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"The touch script {path} is not valid TOML: {error}.") from error
    try:
        return TouchScript.model_validate_json(json.dumps(declared, default=str), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = first["loc"]
        field = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in key).lstrip(".")
        lines = key_lines(text)
        while key not in lines:
            key = key[:-1]
        problem = first["msg"].removeprefix("Value error, ").rstrip(".")
        raise InputError(
            f"Touch script {path}, line {lines[key]}, field {field!r}: {problem}."
        ) from error
