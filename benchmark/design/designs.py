"""Designs of a sensor compared: drive patterns and numbers of electrodes, within a frame rate.

All designs have the same noise in volts at the same current, that of the board; an SNR is of the
frames of the sensor as it is given. (At the same SNR of its own frames, a pattern of small voltages
would get a better board.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eitbench.benchmark.design.bounds import (
    LEAST_PIXELS,
    Maps,
    Noise,
    Touch,
    averaged,
    maps,
    noise_of,
    whitened_jacobian,
)
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import FRAME_S
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern, opposition_pattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, even_electrodes

OWN = "own"
"""The pattern of the sensor as it is given."""


@dataclass(frozen=True, eq=False)
class Design:
    """One design and what it can feel.

    Attributes:
        pattern: its name: `offset=K`, `opposition` or `own`.
        sensor: the sensor of this design.
        given: it is the sensor as it was given, with its own pattern and electrodes.
        independent: number of measurements that are linearly independent for every conductivity.
        above_noise: number of singular values of the whitened Jacobian that exceed the noise for
            an image with the energy of the touch.
        condition: greatest over least singular value of those of the independent measurements.
        frame_s: time of one frame [s].
        frames: how many frames are averaged within the time that the frame rate leaves; 0 where
            one takes longer. 1 without a frame rate.
        maps: the bounds; None where the design is too slow.
    """

    pattern: str
    sensor: Sensor
    given: bool
    independent: int
    above_noise: int
    condition: float
    frame_s: float
    frames: int
    maps: Maps | None


def compare(
    sensor: Sensor,
    snr_db: float | None,
    *,
    touch: Touch | None = None,
    drift: float = 0.0,
    patterns: Sequence[str] = (),
    electrodes: Sequence[int] = (),
    measurement_s: float | None = None,
    frame_rate: float | None = None,
) -> list[Design]:
    """Return the designs of `sensor`, every pattern with every number of electrodes.

    Args:
        sensor: the sensor as it is given.
        snr_db: SNR of its frames [dB], which gives the noise in volts of all designs.
        touch: what is felt; by default of `default_touch`.
        drift: of the conductivity since the reference frame, relative.
        patterns: `offset=K` or `opposition`; by default the sensor's own.
        electrodes: numbers of electrodes; by default the sensor's own.
        measurement_s: time of one measurement [s]; by default such that the sensor as it is given
            has 10 frames/s.
        frame_rate: frames/s that a design has to reach; faster ones average frames.

    Raises:
        InputError: noise that is not given, an unknown or impossible pattern, electrodes that
            overlap, no room for the touch, a time or a frame rate that is not above 0.
    """
    touch = default_touch(sensor) if touch is None else touch
    if measurement_s is None:
        measurement_s = FRAME_S / sensor.n_measurements
    if not 0 < measurement_s < np.inf:
        raise InputError(
            f"The time of a measurement has to be above 0 ms, got {1e3 * measurement_s:g}."
        )
    if frame_rate is not None and not 0 < frame_rate < np.inf:
        raise InputError(f"The frame rate has to be above 0 frames/s, got {frame_rate:g}.")
    noise = noise_of(sensor, snr_db, drift)
    # All designs are made before the first is worked out, which takes time.
    made = [
        (pattern, with_design(sensor, pattern, count))
        for count in electrodes or (sensor.n_electrodes,)
        for pattern in patterns or (OWN,)
    ]
    return [
        _worked_out(name, of, of == sensor, noise, touch, measurement_s, frame_rate)
        for name, of in made
    ]


def default_touch(sensor: Sensor) -> Touch:
    """A touch of a tenth of the sensor's shorter side in diameter, 30 % less conductive.

    On coarse pixels it is larger: the smallest that they can show, see `lattice`.
    """
    return Touch(max(0.05 * sensor.outline.shorter_side, LEAST_PIXELS * max(sensor.pixel_size)))


def best(designs: Sequence[Design]) -> Design | None:
    """The design with the smallest median bound of the place; None where all are too slow."""
    fast = [of for of in designs if of.maps is not None]
    return min(fast, key=lambda of: median(of.maps.place if of.maps else None), default=None)


def median(values: Array | None) -> float:
    """The median over the places of a map, NaN for none; inf counts as greater than all."""
    some = np.empty(0) if values is None else values[~np.isnan(values)]
    # Of an even number the greater middle one: no mean with inf.
    return float(np.sort(some)[len(some) // 2]) if len(some) else np.nan


def with_design(sensor: Sensor, pattern: str, n_electrodes: int) -> Sensor:
    """The `sensor` with another pattern and number of electrodes.

    Another number lies evenly on the same rim from the first electrode's place on, in the same
    direction, and covers the same share of it.

    Raises:
        InputError: an unknown or impossible pattern or number of electrodes.
    """
    if n_electrodes < 4:
        raise InputError(f"EIT needs at least 4 electrodes, got {n_electrodes}.")
    if n_electrodes != sensor.n_electrodes:
        if pattern == OWN:
            raise InputError(
                f"The pattern of {sensor.name!r} belongs to its {sensor.n_electrodes} electrodes: "
                "name patterns for other numbers, for example `--compare offset=1,offset=3`."
            )
        electrodes = _spread(sensor, n_electrodes)
    else:
        electrodes = sensor.electrodes
    # In one step: the old pattern may name electrodes that are no longer there.
    return replace(
        sensor,
        electrodes=electrodes,
        pattern=sensor.pattern if pattern == OWN else _pattern(pattern, n_electrodes),
    )


def _spread(sensor: Sensor, count: int) -> tuple[Electrode, ...]:
    given = sensor.electrodes
    perimeter = sensor.outline.perimeter
    clockwise = (given[1].centre - given[0].centre) % perimeter > perimeter / 2
    width = sum(e.width for e in given) / count
    contact = float(np.exp(np.mean(np.log([e.contact_impedance for e in given]))))
    # Half a step from the corner where the first electrode of the sensor is so, too.
    own = perimeter / len(given)
    start = given[0].centre
    if not isinstance(sensor.outline, Disc) and np.isclose(start % own, own / 2, rtol=1e-3):
        start = (perimeter / count) / 2 + (start - own / 2)
    return even_electrodes(sensor.outline, count, width, contact, start=start, clockwise=clockwise)


def _pattern(name: str, n_electrodes: int) -> DrivePattern:
    if name == "opposition":
        if n_electrodes % 2:
            raise InputError(
                f"The pattern opposition needs an even number of electrodes, got {n_electrodes}."
            )
        return opposition_pattern(n_electrodes)
    key, _, value = name.partition("=")
    if key != "offset" or not value.removeprefix("-").isdecimal():
        raise InputError(
            f"Unknown pattern {name!r}: write offset=K, such as offset=3, or opposition."
        )
    return offset_pattern(n_electrodes, int(value))


def independent_measurements(pattern: DrivePattern) -> int:
    """The number of linearly independent measurements, whatever the conductivity.

    Every value is a sum of products of the drive's and the sense pair's incidence with the
    symmetric resistance matrix; the rank of these products is counted. Magnitudes count as signed.
    """
    electrodes = int(pattern.table.max()) + 1
    unit = np.eye(electrodes)
    src, sink, a, b = pattern.table.T
    products = np.einsum("mi,mj->mij", unit[a] - unit[b], unit[src] - unit[sink])
    symmetric = products + products.swapaxes(1, 2)
    upper = np.triu_indices(electrodes)
    return int(np.linalg.matrix_rank(symmetric[:, upper[0], upper[1]]))


def _worked_out(
    pattern: str,
    sensor: Sensor,
    given: bool,
    noise: Noise,
    touch: Touch,
    measurement_s: float,
    frame_rate: float | None,
) -> Design:
    frame_s = measurement_s * sensor.n_measurements
    # Rounding must not make a frame of exactly the time that there is too long.
    frames = 1 if frame_rate is None else int(1 / (frame_rate * frame_s) + 1e-9)
    of = whitened_jacobian(sensor, averaged(noise, max(frames, 1)))
    independent = independent_measurements(sensor.pattern)
    # The norm of the touch's image; the integral of exp(-2 d^2 / r^2) is pi r^2 / 2.
    pixels = np.pi * touch.radius**2 / 2 / np.prod(sensor.pixel_size)
    size = sensor.background * abs(touch.contrast) * np.sqrt(pixels)
    return Design(
        pattern=pattern,
        sensor=sensor,
        given=given,
        independent=independent,
        above_noise=int(np.sum(of.singular * size > 1)),
        condition=float(of.singular[0] / of.singular[min(independent, len(of.singular)) - 1]),
        frame_s=frame_s,
        frames=frames,
        maps=maps(of, touch) if frames else None,
    )
