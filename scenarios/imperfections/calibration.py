"""Calibration of a sensor from its reference frames, and correction of its other frames.

Reference frames depend on quantities that the nominal description may have wrong: the gain g of
every channel (pair of measuring electrodes), the contact impedance z and the place s of every
electrode, and a common factor c, in which the drive current, the board's units and the background
cannot be separated. The estimate is the most probable one for independent normal priors,

    min  sum_m ((v_m - c g(m) V_m(s, z)) / noise)^2 + sum_k (p_k / deviation_k)^2,

with p the logarithms of g and z and the shifts of s, by Gauss-Newton steps with V's derivative by
differences (Vauhkonen et al., IEEE Trans. Biomed. Eng. 46, 1999, and Heikkinen et al., Meas. Sci.
Technol. 13, 2002, estimate contact impedances in this way). Reciprocity tells gains from geometry:
only gains can break it. Measurements that fit no such sensor, of an electrode without contact or a
channel that clips, get little or no weight (Welsch's weights, in units of the median misfit).

Corrected frames are those that the nominal sensor would have given. With the gains divided out and
J and J_0 the Jacobians of the calibrated and the nominal sensor, a touch that changed the frame by
dv is first guessed by one regularised step x = C J^T (J C J^T + w I)^-1 dv, and then

    v' = V_0 + dv + (J_0 - J) x,

so that only what the two sensors see differently rests on the guess. All methods, learned ones
too, can thus be given the same corrected frames, and on a nominal sensor nothing is changed.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import linalg

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.faults import spoiled
from eitbench.scenarios.imperfections.imperfections import channels, farthest_shifts
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors.sensor import Electrode, Sensor

GAIN_DEVIATION = 0.02
"""Prior standard deviation of the logarithm of a channel's gain."""
CONTACT_DEVIATION = 1.0
"""Of the logarithm of an electrode's contact impedance."""
SHIFT_DEVIATION = 0.05
"""Of an electrode's shift along the rim, in parts of the distance to its neighbour."""
NOISE = 3e-3
"""Least standard deviation of a value of the mean reference frame, relative to the frame's rms:
noise of 50 dB, and a good part of the error of a grid as coarse as the image."""
LINEARISATIONS, STEPS = 2, 3
_LENGTHS = (1.0, 0.5, 0.25, 0.125)
_EXPLAINED = 0.5
_FARTHEST = 4.0  # standard deviations of a prior
_OUTLYING = 6.0  # a misfit of so many median ones counts 0.6 of a small one, of twice as many 0.1
_DIFFERENCE = 1e-2  # of a prior's standard deviation: large against rounding, small against curves
_WEIGHT = 1e-2  # w in parts of the mean diagonal of J C J^T
_EXPONENT = 0.5  # C = diag(J^T J)^-0.5, as NOSER


@dataclass(frozen=True, eq=False)
class Calibration:
    """The estimate of a sensor from its reference frames.

    Attributes:
        nominal_sensor: as it is described.
        sensor: as it was found: electrodes shifted, with their contact impedances.
        factor: c, board units per V/A on a sensor of nominal background.
        gains: (C,) relative gain of every channel.
        shifts: (E,) of every electrode along the rim [m].
        contacts: (E,) contact impedance of every electrode, as a multiple of the nominal one.
        deviations: (P,) posterior standard deviation of every unknown (gains, shifts, contact
            impedances), in parts of its prior's: near 1 the frames say nothing of it.
        reference: (M,) mean of the frames that were used, in the board's units.
        misfit_before, misfit_after: median distance from a value of `reference` to the model's,
            relative to the rms of the frame; nominal and calibrated.
    """

    nominal_sensor: Sensor
    sensor: Sensor
    factor: float
    gains: Array
    shifts: Array
    contacts: Array
    deviations: Array
    reference: Array
    misfit_before: float
    misfit_after: float

    @property
    def credible(self) -> bool:
        """True if it explains at least half of the misfit of the nominal sensor.

        Else there is nothing but noise to explain, or the sensor differs in other ways; frames are
        then left as they are.
        """
        return self.misfit_after < _EXPLAINED * self.misfit_before

    def describe(self) -> dict[str, object]:
        """Return the estimates as plain values: shifts in mm, each with its standard deviation.

        That of a contact impedance is a factor.
        """
        channels_end = len(self.gains)
        gain, shift, contact = np.split(
            self.deviations, [channels_end, channels_end + len(self.shifts)]
        )
        electrodes = {
            "electrode": np.arange(len(shift)),
            "shift_mm": 1e3 * self.shifts,
            "shift_mm_sd": 1e3 * SHIFT_DEVIATION * _spacing(self.sensor) * shift,
            "contact_impedance": self.contacts,
            "contact_impedance_sd_factor": np.exp(CONTACT_DEVIATION * contact),
        }
        measured = {
            "channel": [list(pair) for pair in channels(self.sensor.pattern)[1]],
            "gain": self.gains,
            "gain_sd": GAIN_DEVIATION * gain,
        }
        return {
            "sensor": self.sensor.name,
            "misfit_before": self.misfit_before,
            "misfit_after": self.misfit_after,
            "credible": self.credible,
            "factor": self.factor,
            "electrodes": pd.DataFrame(electrodes).to_dict("records"),
            "channels": pd.DataFrame(measured).to_dict("records"),
        }

    @cached_property
    def nominal(self) -> Array:
        """Reference frame (M,) of the nominal sensor, in the board's units."""
        if not self.credible:
            return self.reference
        model = forward_model(self.nominal_sensor)
        return np.asarray(self.factor * model.voltages(model.background))

    def corrected(self, voltages: ArrayLike) -> Array:
        """Frames (n, M) as the nominal sensor would have given them, in the board's units.

        Raises:
            InputError: frames of another length.
        """
        frames = _frames(self.sensor, voltages)
        if not self.credible:
            return frames
        mask, nominal = self.sensor.mask, forward_model(self.nominal_sensor)
        found = ForwardModel(self.sensor, nominal.mesh)
        modelled = nominal.voltages(nominal.background)
        sound = ~spoiled(self.reference, modelled, self.sensor.pattern)
        # Values that a fault spoils rest on the guess alone.
        jacobian = found.jacobian(found.background)[:, mask] * sound[:, None]
        difference = nominal.jacobian(nominal.background)[:, mask] - jacobian
        prior = np.maximum(np.sum(jacobian**2, axis=0), 1e-300) ** -_EXPONENT
        gram = (jacobian * prior) @ jacobian.T
        weighted = gram + _WEIGHT * np.trace(gram) / len(gram) * np.eye(len(gram))
        cross = (difference * prior) @ jacobian.T
        # (M, M): (J_0 - J) C J^T (J C J^T + w I)^-1, transposed
        seen_differently = linalg.solve(weighted, cross.T, assume_a="pos")
        change = (frames - self.reference) / self.gains[channels(self.sensor.pattern)[0]] * sound
        return np.asarray(self.nominal + change + change @ seen_differently)


def calibrate(sensor: Sensor, frames: ArrayLike) -> Calibration:
    """Estimate the errors of the nominal `sensor` from reference frames (n, M) in any units.

    Raises:
        InputError: frames of another length, with values that are not finite, or that do not
            resemble the sensor's at all.
    """
    reference = _frames(sensor, frames).mean(axis=0)
    if not np.isfinite(reference).all():
        raise InputError("A reference frame holds a value that is not a finite number.")
    problem = _Problem(sensor, reference)
    found = np.zeros(problem.size)
    for _ in range(LINEARISATIONS):
        slopes = problem.slopes(found)
        for _ in range(STEPS):
            # Slopes are dear and hardly change within the priors.
            found = problem.step(found, slopes)
    gains, shifts, contacts = problem.parts(found)
    values = problem.modelled(found)
    return Calibration(
        nominal_sensor=sensor,
        sensor=problem.built(found),
        factor=problem.factor(values),
        gains=gains,
        shifts=shifts,
        contacts=contacts,
        deviations=problem.deviations(found, slopes),
        reference=reference,
        misfit_before=problem.misfit(problem.modelled(np.zeros(problem.size))),
        misfit_after=problem.misfit(values),
    )


def _frames(sensor: Sensor, given: ArrayLike) -> Array:
    frames = np.asarray(given, dtype=np.float64)
    if frames.ndim != 2 or frames.shape[1] != sensor.n_measurements:
        raise InputError(
            f"Frames of {sensor.name!r} need shape (n, {sensor.n_measurements}), got "
            f"{frames.shape}."
        )
    return frames


class _Problem:
    """The estimate's unknowns p: logarithms of gains, shifts, logarithms of contact impedances.

    Each is in units of its prior's standard deviation.
    """

    def __init__(self, sensor: Sensor, reference: Array) -> None:
        self.sensor, self.reference = sensor, reference
        self.channel, pairs = channels(sensor.pattern)
        self.n_channels = len(pairs)
        self.spacing, self.farthest = _spacing(sensor), farthest_shifts(sensor)
        self.mesh = forward_model(sensor).mesh
        self.size = self.n_channels + 2 * sensor.n_electrodes
        nominal = self.modelled(np.zeros(self.size))
        self.sound = ~spoiled(reference, nominal, sensor.pattern)
        if not self.sound.any() or self.factor(nominal) <= 0:
            raise InputError(
                f"The reference frame does not resemble that of {sensor.name!r}: check the sensor "
                "and the order and sign of the measurements."
            )

    def parts(self, p: Array) -> tuple[Array, Array, Array]:
        """Gains (C,), shifts (E,) [m] and contact impedances (E,) relative to the nominal ones."""
        gains, shifts, contacts = np.split(
            p, [self.n_channels, self.n_channels + self.sensor.n_electrodes]
        )
        moved = SHIFT_DEVIATION * self.spacing * shifts
        return (
            np.exp(GAIN_DEVIATION * gains),
            np.clip(moved, -self.farthest, self.farthest),  # electrodes do not overlap
            np.exp(CONTACT_DEVIATION * contacts),
        )

    def built(self, p: Array) -> Sensor:
        """The sensor with its electrodes as `p` says."""
        _, shifts, contacts = self.parts(p)
        electrodes = tuple(
            Electrode(e.centre + float(s), e.width, e.contact_impedance * float(z))
            for e, s, z in zip(self.sensor.electrodes, shifts, contacts, strict=True)
        )
        return replace(self.sensor, electrodes=electrodes)

    def modelled(self, p: Array) -> Array:
        """The frame (M,) that `p` explains, with the factor c = 1 [V/A]."""
        model = ForwardModel(self.built(p), self.mesh)
        return np.asarray(self.parts(p)[0][self.channel] * model.voltages(model.background))

    def slopes(self, p: Array) -> Array:
        """Derivative (M, P) of `modelled`: exact for gains, by differences for electrodes."""
        values = self.modelled(p)
        gains = GAIN_DEVIATION * values[:, None] * np.eye(self.n_channels)[self.channel]
        moves = _DIFFERENCE * np.eye(self.size)[self.n_channels :]
        electrodes = [(self.modelled(p + move) - values) / _DIFFERENCE for move in moves]
        return np.column_stack([gains, *electrodes])

    def step(self, p: Array, slopes: Array) -> Array:
        """A Gauss-Newton step from `p`, shortened until it improves; the factor has no prior."""
        values = self.modelled(p)
        weight = self._weights(values)
        rows = self._rows(values, weight, slopes)
        residual = weight * (self.reference - _factor(values, self.reference, weight) * values)
        normal = rows.T @ rows + np.eye(self.size)
        update = linalg.solve(normal, rows.T @ residual - p, assume_a="pos")
        now = residual @ residual + p @ p
        for length in _LENGTHS:
            tried = np.clip(p + length * update, -_FARTHEST, _FARTHEST)
            values = self.modelled(tried)
            residual = weight * (self.reference - _factor(values, self.reference, weight) * values)
            if residual @ residual + tried @ tried < now:
                return tried
        return p

    def deviations(self, p: Array, slopes: Array) -> Array:
        """Posterior standard deviations (P,) at `p`, in those of the priors."""
        values = self.modelled(p)
        rows = self._rows(values, self._weights(values), slopes)
        covariance = linalg.inv(rows.T @ rows + np.eye(self.size))
        return np.asarray(np.sqrt(np.diag(covariance)))

    def _rows(self, values: Array, weight: Array, slopes: Array) -> Array:
        """Weighted slopes (M, P) of the frame with the common factor that fits it best."""
        rows, frame = weight[:, None] * slopes, weight * values
        factor = _factor(values, self.reference, weight)
        return np.asarray(factor * (rows - np.outer(frame, frame @ rows) / (frame @ frame)))

    def _weights(self, values: Array) -> Array:
        """Weights (M,) of the residuals: one over the noise, less where no such sensor fits."""
        residual = self.reference - self.factor(values) * values
        noise = NOISE * float(np.sqrt(np.mean(self.reference[self.sound] ** 2)))
        typical = max(noise, float(np.median(np.abs(residual[self.sound]))))
        fitting = np.exp(-((residual / (_OUTLYING * typical)) ** 2) / 2)
        return np.asarray(fitting * self.sound / noise)

    def misfit(self, values: Array) -> float:
        """Median distance of sound values of the reference frame from the model's, over its rms."""
        residual = self.reference - self.factor(values) * values
        rms = np.sqrt(np.mean(self.reference[self.sound] ** 2))
        return float(np.median(np.abs(residual[self.sound])) / rms)

    def factor(self, values: Array) -> float:
        """Units of the reference frame per V/A of the modelled frame (M,), by sound values."""
        return _factor(values[self.sound], self.reference[self.sound])


def _spacing(sensor: Sensor) -> float:
    """From one electrode to the next [m]."""
    return sensor.outline.perimeter / sensor.n_electrodes


def _factor(values: Array, reference: Array, weight: Array | None = None) -> float:
    """The factor from a modelled frame to the reference frame.

    It is that of least squares with the given weights; without, the median ratio of large values,
    which a few wrong ones do not change.
    """
    if weight is None:
        large = np.abs(values) >= np.median(np.abs(values))
        return float(np.median(reference[large] / values[large]))
    frame = weight * values
    return float(frame @ (weight * reference) / (frame @ frame))
