"""The sensor behind an emulated board, and its scripted touches; no method has its physics."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.declaration import Declaration, read_declaration
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import FRAME_S, TYPICAL
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.phantoms.regions import Circle, Pose
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.sensor import Sensor

SNR_DB = 60.0
RELAXATION_S = 3.0
"""Time constant with which the material creeps under a touch, and recovers after it [s]."""


@dataclass(frozen=True)
class Touch:
    """A round indenter on the sensor.

    Attributes:
        x_m, y_m: its centre in the sensor's frame [m].
        radius_m: [m].
        pressure_pa: [Pa].
    """

    x_m: float
    y_m: float
    radius_m: float
    pressure_pa: float


class EmulatedSensor:
    """One unit of a sensor with all imperfections of `imperfections.TYPICAL`, in time.

    Fields are solved on a finer mesh than any method uses, electrodes lie off their places, the
    material drifts and relaxes, and the board's channels are uneven, noisy and rounded.

    Attributes:
        imperfections: what makes it differ from the nominal sensor.
    """

    def __init__(self, sensor: Sensor, unit: int = 0, snr_db: float = SNR_DB) -> None:
        self.imperfections = TYPICAL.model_copy(update={"unit": unit})
        self._snr_db = snr_db
        self._pattern = sensor.pattern
        built = replace(sensor, electrodes=self.imperfections.built(sensor))
        # Converged triangles take too long for 10 frames/s.
        self._model = ForwardModel(built.refined(2))
        self._untouched = self._model.voltages(self._model.background)
        # Logarithms of conductivity: what the touch has left, and what the touch makes of it.
        self._crept = self._pressed = np.zeros(self._model.sensor.image_shape)
        self._solved = (self._model.background, self._untouched)
        self._time_s: float | None = None
        self._count = 0

    def frame(self, time_s: float, touches: Sequence[Touch], frame_s: float = FRAME_S) -> Array:
        """The frame (M,) [V/A] that the board measures from `time_s` [s], under these touches.

        It takes `frame_s` [s]. Times must not go backwards: the material remembers.
        """
        return self.scan(time_s, frame_s, [(time_s, touches)])

    def scan(
        self, begin_s: float, frame_s: float, course: Sequence[tuple[float, Sequence[Touch]]]
    ) -> Array:
        """The frame (M,) [V/A] whose values are measured one after the other in `frame_s` [s].

        Args:
            begin_s: when the first value is measured [s]; times must not go backwards.
            frame_s: value m is measured `frame_s * m / M` later.
            course: touches, and the time [s] from which each of them are there, in order; the
                first ones at `begin_s`.
        """
        clean = np.empty_like(self._untouched)
        measured_at = begin_s + frame_s * np.arange(len(clean)) / len(clean)
        for time_s, touches in course:
            later = measured_at >= time_s
            clean[later] = self._voltages(time_s, touches)[later]
        return self._measured(begin_s, frame_s, clean)

    def _voltages(self, time_s: float, touches: Sequence[Touch]) -> Array:
        sensor = self._model.sensor
        logarithm = np.zeros(sensor.image_shape)
        for touch in touches:
            region = Circle(touch.radius_m, Pose(touch.x_m, touch.y_m))
            distance = region.distance(*sensor.pixel_centres)
            logarithm += np.log(FOAM.pressed(touch.pressure_pa, distance))
        self._creep(time_s)
        self._pressed = logarithm
        drift = self.imperfections.drifted(sensor, time_s)
        sigma = self._model.background * drift * np.exp(logarithm + self._crept)
        if not np.array_equal(sigma, self._solved[0]):  # an ideal material stays as it is
            self._solved = (sigma, self._model.voltages(sigma))
        return self._solved[1]

    def _creep(self, time_s: float) -> None:
        """Let the material follow the last touch until now; a share of it remains for a while."""
        elapsed = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        kept = float(np.exp(-elapsed / RELAXATION_S))
        followed = self.imperfections.relaxation * self._pressed
        self._crept = kept * self._crept + (1 - kept) * followed
        self._time_s = time_s

    def _measured(self, time_s: float, frame_s: float, clean: Array) -> Array:
        board, untouched, pattern = self.imperfections, self._untouched, self._pattern
        times_s = np.array([time_s])
        (analogue,) = board.analogue(clean[None], untouched, pattern, times_s, frame_s)
        rng = generator("emulated sensor", board.unit, self._count)
        self._count += 1
        noisy = add_noise(analogue, self._snr_db, rng)
        (sent,) = board.digital(noisy[None], untouched, pattern)
        return np.asarray(sent)


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
            raise ValueError("end_s has to be later than start_s")
        return value

    @property
    def touch(self) -> Touch:
        """The touch, in SI units."""
        return Touch(
            self.x_mm * 1e-3, self.y_mm * 1e-3, self.radius_mm * 1e-3, self.pressure_kpa * 1e3
        )


class TouchScript(Declaration):
    """The touches of an emulated board, as a TOML file scripts them.

        [[touches]]
        start_s = 5.0
        end_s = 8.0
        x_mm = 30.0
        y_mm = 60.0
        radius_mm = 6.0
        pressure_kpa = 20.0

    Times count from the moment the board is switched on; places are in the sensor's frame.
    """

    touches: tuple[ScriptedTouch, ...] = Field(min_length=1)

    def at(self, time_s: float) -> list[Touch]:
        """The touches at `time_s` [s]."""
        return [t.touch for t in self.touches if t.start_s <= time_s < t.end_s]


def read_script(path: Path, sensor: Sensor) -> TouchScript:
    """The touches on `sensor` that are scripted in the TOML file at `path`.

    Raises:
        InputError: the file cannot be read, scripts something wrong (the field is named), or
            touches outside the sensor.
    """
    script = read_declaration("Touch script", path, TouchScript)
    for number, scripted in enumerate(script.touches):
        try:
            sensor.check_place(scripted.touch.x_m, scripted.touch.y_m)
        except InputError as error:
            raise InputError(f"Touch script {path}: touch {number} at {error}") from error
    return script
