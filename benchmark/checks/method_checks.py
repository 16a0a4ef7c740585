"""The checks of methods: every public function, in the order they run.

First the interface, then the physics that every method has to obey, last the process: output,
threads, memory, time, files, network and programs.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.checks.harness import (
    NO_NETWORK,
    NO_PROGRAMS,
    NO_WRITING,
    GivenUpError,
    SkippedError,
    require,
    require_own_generators,
    require_quiet,
    require_refusal,
    require_unseen,
    steady_memory,
)
from eitbench.benchmark.checks.method_under_test import (
    CONTRAST,
    GAIN,
    MethodUnderTest,
    disc,
)
from eitbench.benchmark.run.method_cell import WILD
from eitbench.benchmark.workers.messages import BROKEN_CONTRACT
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.symmetry import Motion

# Fractions of the sensor's data range: what float32 rounds; what an iteration that stops at a
# tolerance may make of sums taken in another order.
SAME_RUN, SAME_FRAME = 1e-5, 1e-3
OTHER_SEED = 12345

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

LATER_DB = 30.0
"""SNR of a reference frame that is measured after the fit: what is kept of the first one shows."""

SNR_DB = (60.0, 45.0, 30.0)
DRAWS = 2
NOISE_GROWTH = 2.0
"""Allowed growth of the noise of images over that of frames: a linear method's factor is 1.

Twice leaves room for a method that follows noise more closely where there is more of it.
"""

MONOTONE = 1.25
"""Allowed growth of the noise of images where that of frames falls (two draws)."""

OTHER_DRAWS = 0.3
"""Allowed relative change of deviations by other draws: those of 39 vary by 1 / sqrt(2 * 38)."""

BATCH = 8

REFUSES = "Problem.difference(voltages) raises one."


def shape(tested: MethodUnderTest) -> None:
    """Returns (n, H, W)."""
    _require_sound(tested, "shape")


def dtype(tested: MethodUnderTest) -> None:
    """Returns real numbers."""
    _require_sound(tested, "dtype")


def unchanged_input(tested: MethodUnderTest) -> None:
    """Leaves its input unchanged."""
    _require_sound(tested, "mutated")


def _require_sound(tested: MethodUnderTest, kind: str) -> None:
    """Require that plain frames cause no failure of `kind`, and no error.

    No other check can run on a method that fails on these.
    """
    failure = tested.ask(tested.frames).failure
    if failure is None or (BROKEN_CONTRACT.intersection(failure.kinds) - {kind}):
        return
    who = "reconstruct " if kind in failure.kinds else ""
    raise GivenUpError(f"{who}{failure.message.rstrip('.')}.", failure.trace)


def finite(tested: MethodUnderTest) -> None:
    """Returns finite values.

    In every pixel inside the sensor.
    """
    images = tested.images(tested.frames)[:, tested.sensor.mask]
    bad = int((~np.isfinite(images)).sum())
    require(bad == 0, f"{bad} of {images.size} pixels are NaN or infinite.")


def batch_equals_single(tested: MethodUnderTest) -> str:
    """A batch equals its single frames."""
    frames = tested.frames
    together = tested.images(frames)
    alone = np.concatenate([tested.images(frame[None]) for frame in frames])
    return tested.close(together, alone, SAME_FRAME, "images of a frame alone and in a batch")


def order(tested: MethodUnderTest) -> str:
    """The order of frames does not matter."""
    frames = tested.frames
    backwards = tested.images(np.ascontiguousarray(frames[::-1]))[::-1]
    what = "images of a batch, and of the same frames in reverse order,"
    return tested.close(tested.images(frames), backwards, SAME_FRAME, what)


def seed(tested: MethodUnderTest) -> str:
    """The global seed does not matter."""
    first = tested.images(tested.contact)
    other = tested.refit(tested.contact, seed=OTHER_SEED)
    what = "images with two seeds of the global random generators"
    return tested.close(first, other, SAME_RUN, what)


def random_state(tested: MethodUnderTest) -> None:
    """Leaves the global random state alone."""
    require_own_generators(tested.answer(dict[str, list[str]], "random_state", tested.contact))


def wrong_length(tested: MethodUnderTest) -> None:
    """Refuses frames of the wrong length."""
    require_refusal(tested.ask(tested.frames[:, :-1]), "frames with a value too few", REFUSES)


def nan_voltages(tested: MethodUnderTest) -> None:
    """Refuses frames with NaN."""
    frames = tested.frames.copy()
    frames[1, 0] = np.nan
    require_refusal(tested.ask(frames), "frames with a NaN", REFUSES)


def zero_contrast(tested: MethodUnderTest) -> str:
    """Zero contrast gives the background."""
    off = float(np.max(np.abs(tested.contrast(tested.reference))))
    said = (
        f"the reference frame gives an image up to {off:.3g} S/m off the background of "
        f"{tested.sensor.background:g} S/m"
    )
    allowed = NO_CONTRAST * tested.sensor.data_range
    require(off <= allowed, f"{said}: return absolute conductivity.")
    return f"{said}; {allowed:.2g} is allowed."


def resistive_contact(tested: MethodUnderTest) -> str:
    """A resistive contact is negative."""
    return _require_sign(tested, 1 - CONTRAST, -1, "conductivity halves", "negative and lower")


def conductive_contact(tested: MethodUnderTest) -> str:
    """A conductive contact is positive."""
    if tested.sensor.conductivity_range[1] <= 1:
        raise SkippedError("the conductivity range of this sensor allows it to fall only.")
    where = "conductivity is 1.5 times higher"
    return _require_sign(tested, 1.5, 1, where, "positive and higher")


def _require_sign(
    tested: MethodUnderTest, factor: float, sign: int, where: str, wanted: str
) -> str:
    contrast = tested.contrast(tested.inclusion(factor))[0]
    contact = disc(tested.sensor.image_shape)[tested.sensor.mask]
    inside, outside = float(contrast[contact].mean()), float(contrast[~contact].mean())
    said = f"where {where}, the mean contrast is {inside:.3g} S/m ({outside:.3g} elsewhere)"
    right = sign * inside > 0 and sign * inside > sign * outside
    require(right, f"{said}; it should be {wanted}.")
    return f"{said}."


def linearity(tested: MethodUnderTest) -> str:
    """Small contrasts are nearly linear.

    Along the image of the simple contrast, the double one gives about twice as much.
    """
    one = tested.contrast(tested.inclusion(1 - SMALL))[0]
    two = tested.contrast(tested.inclusion(1 - 2 * SMALL))[0]
    energy = float(one @ one)
    require(energy > 0, f"the image does not show a contrast of {SMALL:g} at all.")
    ratio = float(one @ two) / energy
    low, high = (2**exponent for exponent in EXPONENT)
    said = (
        f"doubling a contrast of {SMALL:g} multiplies the image by {ratio:.3g}; "
        f"{low:.2f} to {high:.2f} is allowed."
    )
    require(low <= ratio <= high, said)
    return said


def rotation_equivariance(tested: MethodUnderTest) -> str:
    """Rotation equivariance."""
    turns = [motion for motion in tested.motions if motion.turns and not motion.mirrored]
    # The first is of 90 degrees, or of 180 where that is none: all others follow from it.
    return _require_equivariance(tested, turns, "rotation", "turned")


def mirror_equivariance(tested: MethodUnderTest) -> str:
    """Mirror equivariance."""
    mirrors = [motion for motion in tested.motions if motion.mirrored]
    return _require_equivariance(tested, mirrors, "mirror", "mirrored")


def _require_equivariance(
    tested: MethodUnderTest, motions: Sequence[Motion], what: str, moved_is: str
) -> str:
    """Require the moved image for moved voltages, by the first of the `motions`.

    Differences to the reference are moved, so that its frame need not be symmetric.
    """
    if not motions:
        raise SkippedError(f"this sensor has no {what} symmetry.")
    difference = tested.contact - tested.reference
    moved = tested.images(tested.reference + motions[0].voltages(difference))
    mask, background = tested.sensor.mask, tested.sensor.background
    expected = motions[0].images(tested.images(tested.contact))
    contrast = _seen(expected[:, mask] - background)
    apart = _rms(moved[:, mask] - expected[:, mask])
    said = (
        f"the image of {moved_is} voltages and the {moved_is} image differ by "
        f"{apart / contrast:.2g} of the contrast (rms); {MOVED:g} is allowed."
    )
    require(apart <= MOVED * contrast, said)
    return said


def gain_invariance(tested: MethodUnderTest) -> str:
    """Gain invariance.

    Images do not depend on the board's units, which frames and reference share.
    """
    _seen(tested.contrast(tested.contact))
    other = tested.refit(tested.contact * GAIN, gain=GAIN)
    what = f"images of the same frames in V/A and in other units ({GAIN:g} per V/A)"
    return tested.close(tested.images(tested.contact), other, SAME_FRAME, what)


def new_reference(tested: MethodUnderTest) -> str:
    """A reference frame measured later counts.

    Sessions measure it anew; an image is that of the frame and the latest reference frame.
    """
    _seen(tested.contrast(tested.contact))
    (reference,) = tested.reference
    later = add_noise(reference, LATER_DB, generator("method check", "reference"))[None]
    now, begun = tested.with_other_reference(tested.contact, later)
    what = "images with a reference frame that came after `fit`, and images after a `fit` with it,"
    return tested.close(now, begun, SAME_FRAME, what)


def noise_growth(tested: MethodUnderTest) -> str:
    """Noise is not blown up.

    It grows in proportion to that of frames, and stays below the contact's contrast.
    """
    clean = tested.contrast(tested.contact)
    _seen(clean)
    noisy = [_noisy(tested.contact[0], snr_db) for snr_db in SNR_DB]
    seen = tested.contrast(np.concatenate(noisy)).reshape(len(SNR_DB), DRAWS, -1)
    errors = [_rms(images - clean) for images in seen]
    figures = ", ".join(
        f"{error:.2g} S/m at {snr_db:g} dB" for snr_db, error in zip(SNR_DB, errors, strict=True)
    )
    said = f"noise of the frames adds {figures} to an image (rms)"
    for less, more in itertools.pairwise(errors):
        require(less <= MONOTONE * more, f"{said}; it should grow with the noise.")
    allowed = NOISE_GROWTH * 10 ** ((SNR_DB[0] - SNR_DB[-1]) / 20)
    floor = SAME_FRAME * tested.sensor.data_range
    grown = errors[-1] / max(errors[0], floor / allowed)
    require(
        grown <= allowed, f"{said}: it grows {grown:.0f} times; {allowed:.0f} times is allowed."
    )
    most = CONTRAST * tested.sensor.background
    require(errors[-1] <= most, f"{said}; more than {most:g} hides the contact.")
    return f"{said}."


def _noisy(frame: Array, snr_db: float) -> Array:
    """Return noisy frames (DRAWS, M): each draw is the same at every level but for its strength."""
    rngs = (generator("method check", "noise", draw) for draw in range(DRAWS))
    return np.stack([add_noise(frame, snr_db, rng) for rng in rngs])


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def _seen(contrast: Array) -> float:
    """Return the rms of a contact's contrast, which must not be 0."""
    rms = _rms(contrast)
    require(rms > 0, "the image does not show the contact at all.")
    return rms


def uncertainty(tested: MethodUnderTest) -> str:
    """Uncertainty is finite, positive, the same twice, in a batch and in other units.

    A method need not state any.
    """
    stated = tested.stated("uncertainty", tested.contact)
    if stated is None:
        raise SkippedError("it states no uncertainty.")
    inside = stated[..., tested.sensor.mask]
    bad = int((~np.isfinite(inside)).sum())
    require(bad == 0, f"{bad} of {inside.size} values of the uncertainty are NaN or infinite.")
    drawn = stated.ndim == tested.images(tested.contact).ndim + 1
    limit = WILD * tested.sensor.data_range
    require(
        bool(np.abs(inside).max() <= limit),
        f"the uncertainty has values beyond {limit:g} S/m, for which runs refuse a frame.",
    )
    deviations = inside.std(axis=1, dtype=np.float64) if drawn else inside
    least, most = float(deviations.min()), float(deviations.max())
    require(least >= 0, f"a standard deviation is {least:.3g} S/m; it cannot be negative.")
    require(most > 0, "it is sure of every pixel of a contact: no image is without error.")
    again = tested.stated("uncertainty", tested.contact)
    apart = np.inf if again is None else float(np.max(np.abs(again - stated)))
    allowed = SAME_RUN * tested.sensor.data_range
    require(apart <= allowed, f"stated twice for a frame, it differs by up to {apart:.2g} S/m.")

    def ratio_to(other: NDArray[np.float32]) -> float:
        there = other[..., tested.sensor.mask]
        there = there.std(axis=1, dtype=np.float64) if drawn else there
        return _rms(there.astype(np.float64)) / _rms(deviations.astype(np.float64))

    # The contact is the first of the frames.
    batch = tested.stated("uncertainty", tested.frames[[1, 0]])
    ratio = np.nan if batch is None else ratio_to(batch[1:])
    allowed = OTHER_DRAWS if drawn else SAME_FRAME
    require(
        abs(ratio - 1) <= allowed,
        f"deviations of a frame behind another one are {ratio:.3g} times as large as alone.",
    )
    ratio = ratio_to(tested.stated_in_other_units("uncertainty", tested.contact))
    require(
        abs(ratio - 1) <= OTHER_DRAWS,
        f"deviations of the same frame in other units ({GAIN:g} per V/A) are {ratio:.3g} times as "
        "large; they are of images, in S/m.",
    )
    what = f"{stated.shape[1]} draws" if drawn else "standard deviations"
    return f"{what} with deviations up to {most:.2g} S/m at a contact."


def novelty(tested: MethodUnderTest) -> str:
    """Novelty is finite, not the same for all frames; the same twice, in a batch, in other units.

    A method need not state any.
    """
    frames = tested.frames
    stated = tested.stated("novelty", frames)
    if stated is None:
        raise SkippedError("it states no novelty.")
    bad = int((~np.isfinite(stated)).sum())
    require(bad == 0, f"{bad} of {len(stated)} scores are NaN or infinite.")
    require(
        bool(np.ptp(stated) > 0),
        f"{len(stated)} different frames all score {stated[0]:.3g}; it should depend on the frame.",
    )

    def apart(other: Sequence[NDArray[np.float32] | None]) -> float:
        found = np.concatenate([part for part in other if part is not None])
        return float(np.max(np.abs(found - stated))) / max(float(np.max(np.abs(stated))), 1e-30)

    moved = apart([tested.stated("novelty", frames)])
    require(
        moved <= SAME_RUN, f"stated twice for the same frames, it differs by up to {moved:.2g}."
    )
    singly = [tested.stated("novelty", frames[k : k + 1]) for k in range(len(frames))]
    moved = apart(singly)
    require(
        moved <= SAME_FRAME,
        f"scores of a batch and of its single frames differ by up to {moved:.2g} of the largest.",
    )
    moved = apart([tested.stated_in_other_units("novelty", frames)])
    require(
        moved <= SAME_FRAME,
        f"scores of the same frames in other units ({GAIN:g} per V/A) differ by up to {moved:.2g} "
        "of the largest.",
    )
    return f"scores of {float(stated.min()):.3g} to {float(stated.max()):.3g}."


def memory(tested: MethodUnderTest) -> str:
    """Memory does not grow."""
    tested.images(tested.contact)
    return steady_memory(tested.answer, tested.contact, "frames")


# It takes another worker, so it comes after what compares with the first one's images.
def deterministic(tested: MethodUnderTest) -> str:
    """The same twice."""
    frames = tested.frames
    first = tested.images(frames)
    tested.worker.renew()
    return tested.close(
        first, tested.again(frames), SAME_RUN, "images after two fits on the same problem"
    )


def quiet(tested: MethodUnderTest) -> None:
    """Prints nothing."""
    tested.images(tested.contact)
    require_quiet(tested.log, lambda: tested.again(tested.contact), "reconstruct")


def threads(tested: MethodUnderTest) -> str:
    """The thread count does not matter."""
    one = tested.again(tested.contact)
    two = tested.refit(tested.contact, threads=2)
    return tested.close(one, two, SAME_FRAME, "images made with one thread and with two")


# What the processes were seen to do comes after all that makes them do something.
def no_network(tested: MethodUnderTest) -> None:
    """Uses no network."""
    tested.images(tested.contact)
    require_unseen(tested.watch.noted("network"), *NO_NETWORK)


def no_writing(tested: MethodUnderTest) -> None:
    """Writes nothing elsewhere."""
    tested.images(tested.contact)
    require_unseen(tested.watch.noted("write"), *NO_WRITING)


def no_programs(tested: MethodUnderTest) -> None:
    """Starts no other program."""
    tested.images(tested.contact)
    require_unseen(tested.watch.noted("program"), *NO_PROGRAMS)


# Last, as it may cost the worker by taking too long.
def in_time(tested: MethodUnderTest) -> str:
    """Answers within the time limit."""
    factors = np.linspace(0.4, 0.9, BATCH)
    frames = np.concatenate([tested.inclusion(float(factor)) for factor in factors])
    tested.images(frames)
    return (
        f"fitted in {tested.worker.set_up_s:.2g} s, "
        f"{BATCH} frames in {tested.ask(frames).seconds:.2g} s; "
        f"{tested.limit_s:g} s each are allowed."
    )
