"""Checks of the physics that every method has to obey, however it works."""

import itertools
import math

import numpy as np

from eitbench.benchmark.checks.harness import SkippedError, require
from eitbench.benchmark.checks.method_interface import SAME_FRAME
from eitbench.benchmark.checks.method_under_test import CONTRAST, MethodUnderTest, disc
from eitbench.benchmark.workers.method_service import Frames
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.symmetry import Motion

NO_CONTRAST = 0.05
"""Largest contrast that counts as none, as a fraction of the data range; contacts have more."""

SMALL = 0.1
"""The small contrast; twice as much is compared with it. Physics alone gives a ratio of 2.1."""

EXPONENT = (0.5, 1.5)
"""The response to a contrast c grows as c^p: nearer to c than to a constant or to c^2."""

MOVED = 0.01
"""Difference of a moved image to the image of moved voltages, as a fraction of the contrast's rms.

The voltages are moved exactly and the mesh is symmetric to 1e-6, so that what remains is rounding:
methods without float32 are off by 1e-12, an electrode or a sign taken wrongly by about 1.
"""

GAIN = 1000.0
"""Between V/A and the units of a board: to the numbers that recorded sets hold, about."""

SNR_DB = (60.0, 45.0, 30.0)
DRAWS = 2
NOISE_GROWTH = 2.0
"""Allowed growth of the noise of images over that of frames: a linear method's factor is 1.

Twice leaves room for a method that follows noise more closely where there is more of it.
"""

MONOTONE = 1.25
"""Allowed growth of the noise of images where that of frames falls (two draws)."""
UNSEEN = "the contact is not seen at all."


def zero_contrast(tested: MethodUnderTest) -> str:
    """Require the background as the image of the reference frame."""
    off = float(np.max(np.abs(tested.contrast(tested.reference))))
    said = (
        f"the reference frame gives an image up to {off:.3g} S/m off the background of "
        f"{tested.sensor.background:g} S/m"
    )
    allowed = NO_CONTRAST * tested.sensor.data_range
    require(off <= allowed, f"{said}: return absolute conductivity.")
    return f"{said}; {allowed:.2g} is allowed."


def resistive_contact(tested: MethodUnderTest) -> str:
    """Require a negative contrast where conductivity falls."""
    inside, outside = _inside_and_outside(tested, tested.contact)
    said = (
        f"where conductivity halves, the mean contrast is {inside:.3g} S/m "
        f"({outside:.3g} elsewhere)"
    )
    require(inside < 0 and inside < outside, f"{said}; it should be negative and lower.")
    return f"{said}."


def conductive_contact(tested: MethodUnderTest) -> str:
    """Require a positive contrast where conductivity rises."""
    if tested.sensor.conductivity_range[1] <= 1:
        raise SkippedError("on this sensor, conductivity can only fall.")
    inside, outside = _inside_and_outside(tested, tested.inclusion(1.5))
    said = (
        f"where conductivity is 1.5 times higher, the mean contrast is {inside:.3g} S/m "
        f"({outside:.3g} elsewhere)"
    )
    require(inside > 0 and inside > outside, f"{said}; it should be positive and higher.")
    return f"{said}."


def _inside_and_outside(tested: MethodUnderTest, frame: Frames) -> tuple[float, float]:
    contrast = tested.contrast(frame)[0]
    inside = disc(tested.sensor.image_shape)[tested.sensor.mask]
    return float(contrast[inside].mean()), float(contrast[~inside].mean())


def linearity(tested: MethodUnderTest) -> str:
    """Require about twice the image for twice the contrast, along the image of the simple one."""
    one = tested.contrast(tested.inclusion(1 - SMALL))[0]
    two = tested.contrast(tested.inclusion(1 - 2 * SMALL))[0]
    energy = float(one @ one)
    require(energy > 0, f"a contrast of {SMALL:g} is not seen at all.")
    ratio = float(one @ two) / energy
    low, high = (2**exponent for exponent in EXPONENT)
    said = (
        f"doubling a contrast of {SMALL:g} multiplies the image by {ratio:.3g}; "
        f"{low:.2f} to {high:.2f} is allowed."
    )
    require(low <= ratio <= high, said)
    return said


def rotation_equivariance(tested: MethodUnderTest) -> str:
    """Require the turned image for the voltages of a turned sensor."""
    turns = [motion for motion in tested.motions if motion.turns and not motion.mirrored]
    if not turns:
        raise SkippedError("no turn brings this sensor onto itself.")
    motion = turns[0]  # of 90 degrees, or of 180 where that is none: all others follow from it
    return _require_equivariance(tested, motion, f"turned by {90 * motion.turns} degrees")


def mirror_equivariance(tested: MethodUnderTest) -> str:
    """Require the mirrored image for the voltages of a mirrored sensor."""
    mirrors = [motion for motion in tested.motions if motion.mirrored]
    if not mirrors:
        raise SkippedError("no mirror brings this sensor onto itself.")
    return _require_equivariance(tested, mirrors[0], "mirrored")


def _require_equivariance(tested: MethodUnderTest, motion: Motion, how: str) -> str:
    """Require the moved image for moved voltages.

    Differences to the reference are moved, so that its frame need not be symmetric.
    """
    difference = tested.contact - tested.reference
    moved = tested.images(tested.reference + motion.voltages(difference))
    mask, background = tested.sensor.mask, tested.sensor.background
    expected = motion.images(tested.images(tested.contact))
    contrast = _rms(expected[:, mask] - background)
    apart = _rms(moved[:, mask] - expected[:, mask])
    require(contrast > 0, UNSEEN)
    said = (
        f"voltages of the sensor {how} give an image that differs from the {how.split()[0]} one by "
        f"{apart / contrast:.2g} of its contrast (rms); {MOVED:g} is allowed."
    )
    require(apart <= MOVED * contrast, said)
    return said


def gain_invariance(tested: MethodUnderTest) -> str:
    """Require images that do not depend on the board's units, which frames and reference share."""
    require(_rms(tested.contrast(tested.contact)) > 0, UNSEEN)
    other = tested.refit(tested.contact * GAIN, gain=GAIN)
    what = f"images of frames and of {GAIN:g} times these (the reference too)"
    return tested.close(tested.images(tested.contact), other, SAME_FRAME, what)


def noise_growth(tested: MethodUnderTest) -> str:
    """Require noise in images in proportion to that of frames, and below the contact's contrast."""
    clean = tested.contrast(tested.contact)
    require(_rms(clean) > 0, UNSEEN)
    noisy = [_noisy(tested.contact[0], snr_db) for snr_db in SNR_DB]
    seen = tested.contrast(np.concatenate(noisy)).reshape(len(SNR_DB), DRAWS, -1)
    errors = [_rms(images - clean) for images in seen]
    figures = ", ".join(
        f"{error:.2g} S/m at {snr_db:g} dB" for snr_db, error in zip(SNR_DB, errors, strict=True)
    )
    said = f"noise adds {figures} to an image (rms)"
    for less, more in itertools.pairwise(errors):
        require(less <= MONOTONE * more, f"{said}; it should grow with the noise.")
    allowed = NOISE_GROWTH * 10 ** ((SNR_DB[0] - SNR_DB[-1]) / 20)
    floor = SAME_FRAME * tested.sensor.data_range
    grown = errors[-1] / max(errors[0], floor / allowed)
    require(grown <= allowed, f"{said}, {grown:.0f} times more; {allowed:.0f} is allowed.")
    most = CONTRAST * tested.sensor.background
    require(errors[-1] <= most, f"{said}; more than {most:g} hides the contact.")
    return f"{said}."


def _noisy(frame: Array, snr_db: float) -> Array:
    """Return noisy frames (DRAWS, M): each draw is the same at every level but for its strength."""
    rngs = (generator("method check", "noise", draw) for draw in range(DRAWS))
    return np.stack([add_noise(frame, snr_db, rng) for rng in rngs])


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(np.square(values))))
