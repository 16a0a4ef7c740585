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

from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from eitbench.hardware.emulation.emulated_sensor import Touch
from eitbench.scenarios.declaration import Declaration, read_declaration

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ScriptedTouch(Declaration):
    """One touch: from `start_s` to `end_s` a disc presses at (`x_mm`, `y_mm`)."""

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


class TouchScript(Declaration):
    """The touches of an emulated board."""

    touches: tuple[ScriptedTouch, ...] = Field(min_length=1)

    def at(self, time_s: float) -> list[Touch]:
        """The touches at `time_s` [s]."""
        return [t.touch for t in self.touches if t.start_s <= time_s < t.end_s]


def read_script(path: Path) -> TouchScript:
    """The touches scripted in the TOML file at `path`.

    Raises:
        InputError: the file cannot be read or scripts something wrong (the field is named).
    """
    return read_declaration("Touch script", path, TouchScript)
