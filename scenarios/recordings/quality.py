"""Quality of recordings: reciprocity, noise, suspect electrodes, what is wrong with a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError, counted
from eitbench.scenarios.recordings.agreement import (
    differences_problem,
    fault_problems,
    fit_of_sensor,
    knowledge_of_places,
    reference_problem,
    touch_problems,
)
from eitbench.scenarios.recordings.descriptors import RecordedFrames, validation_every_fifth
from eitbench.scenarios.recordings.files.own import (
    damage,
    frames_of_touches,
    half_placed,
    has_own_references,
    has_reference,
    impossible_label,
    off_sensor,
    on_reference,
    outside,
    untouched_rows,
)
from eitbench.scenarios.recordings.files.recording_file import (
    Condition,
    Content,
    read_file,
    touches_of,
)
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Sensor


def reciprocity_error(frames: ArrayLike, pattern: DrivePattern) -> NDArray[np.float64]:
    """Relative reciprocity error (...) of `frames` (..., M): ||v' - s v|| / ||v||.

    v' and v are the values of reciprocal measurements, s = -1 where one of them is reversed. An
    ideal linear sensor gives 0; noise, stray currents and unlike channels do not.

    Raises:
        InputError: frames of another length, or a pattern without reciprocal measurements.
    """
    values = np.asarray(frames, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != pattern.n_measurements:
        raise InputError(f"Frames need {pattern.n_measurements} values, got shape {values.shape}.")
    pairs = pattern.reciprocal_pairs()
    if len(pairs) == 0:
        raise InputError("The pattern has no reciprocal pairs of values to compare.")
    first = values[..., pairs[:, 0]]
    difference = values[..., pairs[:, 1]] - pattern.reciprocal_signs(pairs) * first
    return np.asarray(np.linalg.norm(difference, axis=-1) / np.linalg.norm(first, axis=-1))


def quality(recording: RecordedFrames, pattern: DrivePattern) -> tuple[float, float]:
    """Reciprocity error of the reference, and noise from frame to frame within one state.

    The noise is the standard deviation value by value, relative to the reference's value; the
    median over the M values is given, as a few saturated channels would rule every mean. NaN where
    nothing is measured twice, without repeats, and where the reference is modelled.
    """
    reference, samples = recording.reference, recording.samples
    if recording.modelled_reference:
        return float("nan"), float("nan")
    reciprocity = noise = float("nan")
    if len(pattern.reciprocal_pairs()):
        reciprocity = float(reciprocity_error(reference, pattern))
    if "state" in samples:
        frames, state = recording.voltages, samples["state"].to_numpy()
        steps = np.concatenate([np.diff(frames[state == k], axis=0) for k in np.unique(state)])
        used = reference != 0
        if len(steps):
            # The difference of two frames has twice the variance of one.
            rms = np.sqrt(np.mean((steps[:, used] / np.sqrt(2)) ** 2, axis=0))
            noise = float(np.median(rms / np.abs(reference[used])))
    return reciprocity, noise


def typical_noise(frames: ArrayLike) -> NDArray[np.float64]:
    """Standard deviation (M,) of the noise of `frames` (n, M) that follow each other.

    From the median step between frames, so that a touch that begins or ends does not count as
    noise: 1.4826 times the median of |step| is the standard deviation of normal steps, which is
    sqrt(2) times that of the frames. NaN for fewer than two frames.
    """
    values = np.asarray(frames, dtype=np.float64)
    if len(values) < 2:
        return np.full(values.shape[-1], np.nan)
    steps = np.abs(np.diff(values, axis=0))
    return np.asarray(1.4826 * np.median(steps, axis=0) / np.sqrt(2))


def frame_noise(frames: ArrayLike) -> float:
    """Standard deviation of the noise of `frames` (n, M) that follow each other, rms over values.

    The mean square of a step between two frames is twice the variance of one; the median over the
    steps leaves out those in which a touch begins or ends. (Medians of single values, as in
    `typical_noise`, are right for many frames only.) NaN for fewer than two frames.
    """
    values = np.asarray(frames, dtype=np.float64)
    if len(values) < 2:
        return float("nan")
    return float(np.sqrt(np.median(np.mean(np.diff(values, axis=0) ** 2, axis=1)) / 2))


STANDS_OUT = 3.0
"""Error of an electrode, relative to the other measurements, that makes it suspect."""
_SOUND_ERROR = 0.01
_LEAST = 3


def suspect_electrodes(frames: ArrayLike, pattern: DrivePattern) -> tuple[int, ...]:
    """Electrodes whose measurements in `frames` (n, M) are noisy or not reciprocal; worst first.

    A bad electrode spoils every measurement it takes part in as one role, driving or sensing. So an
    electrode is suspect where even the good ones (the lower quartile) of the measurements it
    drives, or of those it senses, have `STANDS_OUT` times the median error of all measurements it
    takes no part in. The worst one is named, its measurements are left out, and the rest is tested
    again: else its partners, which share half of its measurements, would be blamed too. Two errors
    are looked at: the noise from frame to frame, and the relative reciprocity error
    |v' - s v| / (|v'| + |v|) of the mean frame, of which less than 1 % is never suspect. With
    opposition drive an electrode and its opposite always drive together; only sensing tells them
    apart.

    Sources: reciprocity finds faulty electrodes without a model (Hartinger et al., IEEE Trans.
    Biomed. Eng. 56 (2009) 369); leaving measurements of one electrode out and judging the rest is
    due to Asfaw and Adler, Physiol. Meas. 26 (2005) S175. The thresholds are ours.
    """
    values = np.asarray(frames, dtype=np.float64)
    noise = typical_noise(values)
    smallest = 1e-9 * float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    # Values that are 0 in all frames are of a dead electrode: beside them all others were noisy.
    heard = np.where(values.any(axis=0), np.maximum(noise, smallest), np.nan)
    found = [
        *_standing_out(heard, pattern),
        *_standing_out(_relative_reciprocity(values.mean(axis=0), pattern), pattern),
    ]
    return tuple(dict.fromkeys(found))


def _relative_reciprocity(frame: NDArray[np.float64], pattern: DrivePattern) -> NDArray[np.float64]:
    """Relative reciprocity error (M,) of every value; NaN where it is measured but once."""
    pairs = pattern.reciprocal_pairs()
    error = np.full(len(frame), np.nan)
    first, second = frame[pairs[:, 0]], frame[pairs[:, 1]]
    size = np.abs(first) + np.abs(second)
    difference = np.abs(second - pattern.reciprocal_signs(pairs) * first)
    relative = np.divide(difference, size, out=np.ones_like(size), where=size > 0)
    error[pairs[:, 0]] = error[pairs[:, 1]] = np.maximum(relative, _SOUND_ERROR / STANDS_OUT)
    return error


def _standing_out(error: NDArray[np.float64], pattern: DrivePattern) -> list[int]:
    """Electrodes that stand out in `error` (M,), the worst first; NaN is left out."""
    left = np.isfinite(error)
    found: list[int] = []
    roles = (pattern.table[:, :2], pattern.table[:, 2:])
    while left.sum() > _LEAST:
        scores: dict[int, tuple[float, float]] = {}
        for electrode in np.unique(pattern.table[left]).tolist():
            part = [(role == electrode).any(axis=1) & left for role in roles]
            others = left & ~part[0] & ~part[1]
            if others.sum() < _LEAST:
                continue
            usual = float(np.median(error[others]))
            ratios = [
                float(np.quantile(error[of], 0.25)) / usual
                for of in part
                if of.sum() >= _LEAST and usual > 0
            ]
            scores[electrode] = (max(ratios, default=0.0), sum(ratios))
        worst = max(scores, key=lambda electrode: scores[electrode], default=-1)
        if worst < 0 or scores[worst][0] < STANDS_OUT:
            break
        found.append(worst)
        left &= ~(pattern.table == worst).any(axis=1)
    return found


MAX_RECIPROCITY = 0.1
"""Relative reciprocity error of the untouched sensor above which a recording is a problem."""
_BY_REFERENCE = "--reference, --released or --differences"
_LOOKED_AT = 1000  # frames that suspect electrodes are looked for in


def check(path: Path, other: Sensor | None = None) -> tuple[list[str], list[str]]:
    """Check the recording at `path` and summarise it.

    Args:
        path: of the recording.
        other: a sensor whose model its reference is compared with, beside that of its own.

    Returns:
        Problems (none where it is sound) and facts, one sentence each.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        InputError: `other` measures another number of values.
    """
    try:
        content, condition = read_file(path)
    except DataCorruptError as error:
        return [str(error)], []
    if other is not None and other.n_measurements != content.sensor.n_measurements:
        raise InputError(
            f"{path} holds {content.sensor.n_measurements} values a frame, and sensor "
            f"{other.name!r} has {other.n_measurements}: name one of as many."
        )
    problems = [*_condition(content, condition), *_frames(content), *_marks(content)]
    facts = [_summary(content)]
    untouched = untouched_rows(content)
    needs = (
        ("reference frames", content.differences or len(untouched), _BY_REFERENCE),
        ("labelled touches", len(content.labels), "--labels"),
    )
    if missing := " and ".join(what for what, count, _ in needs if not count):
        options = " and ".join(option for _, count, option in needs[::-1] if not count)
        also = f", or import with {options}" if content.board == "imported" else ""
        facts.append(
            f"Before methods can be compared on it, it needs {missing}: record with --guided{also}."
        )
    # Impossible frames say nothing about electrodes.
    if len(content) and not impossible(content.values).size and not outside(content):
        if content.differences:
            facts.append(
                "It holds pressed minus released frames: methods get a modelled reference."
            )
        else:
            more_problems, more_facts = _electrodes(content, untouched)
            problems += more_problems
            facts += more_facts
        more_problems, more_facts = _agreement(content, untouched, other)
        problems += more_problems
        facts += more_facts
    return problems, facts


def _agreement(
    content: Content, untouched: NDArray[np.int64], other: Sensor | None
) -> tuple[list[str], list[str]]:
    """Problems and facts of the recording beside the model of its sensor, and that of `other`."""
    sensor, problems, facts, faults = content.sensor, list[str](), list[str](), list[str]()
    if len(untouched):
        frame = content.values[untouched].mean(axis=0)
        if problem := reference_problem(frame, sensor):
            problems.append(f"{problem} `eitbench recordings doctor` looks at more wirings.")
        elif frame.any():
            faults = fault_problems(frame, sensor)
        for nominal in (sensor, other):
            if nominal is not None and frame.any():
                fit = fit_of_sensor(frame, nominal)
                facts.append(f"Reference against the model of sensor {nominal.name}: {fit}.")
    if content.differences and (
        problem := differences_problem(content.values[:_LOOKED_AT], sensor)
    ):
        problems.append(problem)
    marked = has_reference(content)
    if not problems and len(content.labels) and marked and not impossible_label(content):
        labels = content.labels.sort_values("first", kind="stable")
        first_ones = labels["first"].drop_duplicates()[:_LOOKED_AT]
        labels = labels[labels["first"].isin(first_ones)].reset_index(drop=True)
        recording = frames_of_touches(replace(content, labels=labels))
        problems += touch_problems(recording, sensor)
        if fact := knowledge_of_places(recording, sensor):
            facts.append(fact)
    return [*problems, *faults], facts


def _condition(content: Content, condition: Condition) -> list[str]:
    problems = []
    if not condition.complete:
        lost = f", {condition.trimmed} at its end are lost" if condition.trimmed else ""
        if condition.unlabelled:
            lost += f", and {counted(condition.unlabelled, 'label')} with them"
        problems.append(f"It was cut off: {len(content)} whole frames are intact{lost}.")
    if problem := damage(condition):
        problems.append(f"{problem[0].upper()}{problem[1:]}.")
    return problems


def _frames(content: Content) -> list[str]:
    if len(content) == 0:
        return ["It holds no frames."]
    problems = []
    if (bad := impossible(content.values)).size:
        problems.append(
            f"{counted(len(bad), 'impossible frame')}, the first is frame {bad[0]}: "
            f"{peak(content.values[bad[0]])}."
        )
    for name, times in (("time_s", content.time_s), ("received_s", content.received_s)):
        if not np.isfinite(times).all():
            problems.append(f"{name} holds values that are not numbers.")
        elif (back := np.flatnonzero(np.diff(times) < 0)).size:
            problems.append(f"{name} goes back at frame {int(back[0]) + 1}.")
    steps = np.diff(content.number)
    dropped = int(np.sum(steps[steps > 1] - 1))
    if dropped:
        share = dropped / (dropped + len(content))
        problems.append(
            f"The board's running numbers show that {counted(dropped, 'frame')} "
            f"{'was' if dropped == 1 else 'were'} lost ({share:.1%})."
        )
    if (back := np.flatnonzero(steps <= 0)).size:
        problems.append(f"The running number does not grow at frame {int(back[0]) + 1}.")
    return problems


def _marks(content: Content) -> list[str]:
    n = len(content)
    problems = []
    first, last = content.labels["first"].to_numpy(), content.labels["last"].to_numpy()
    wrong = np.flatnonzero((first < 0) | (last >= n) | (last < first))
    if wrong.size:
        k = int(wrong[0])
        problems.append(
            f"Label {k} names frames {first[k]} to {last[k]}, and there are frames 0 to {n - 1}."
        )
    own = has_own_references(content)
    before, until = content.labels[["reference_first", "reference_last"]].to_numpy().T
    wrong = np.flatnonzero(own & ((before < 0) | (until >= n) | (until < before)))
    if wrong.size:
        k = int(wrong[0])
        problems.append(
            f"Label {k} names reference frames {before[k]} to {until[k]}, and there are frames 0 "
            f"to {n - 1}."
        )
    if (on := np.flatnonzero(own & (before <= last) & (until >= first))).size:
        k = int(on[0])
        problems.append(
            f"Label {k} names reference frames {before[k]} to {until[k]}, and its touch is on "
            f"frames {first[k]} to {last[k]}: frames are counted from 0."
        )
    if ((content.reference < 0) | (content.reference >= n)).any():
        problems.append("The reference names frames that are not there.")
    if (on := on_reference(content)).size:
        problems.append(
            f"{counted(len(on), 'touch', 'touches')} on frames of the untouched sensor, the first "
            f"is label {on[0]}: frames are counted from 0."
        )
    if problem := impossible_label(content):
        problems.append(f"{problem[0].upper()}{problem[1:]}.")
    if (half := half_placed(content)).size:
        has = "has" if len(half) == 1 else "have"
        problems.append(
            f"{counted(len(half), 'label')} {has} only one coordinate, the first is label "
            f"{half[0]}."
        )
    placed = np.isfinite(content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)).all(axis=1)
    if placed.any() and len(without := np.setdiff1d(np.flatnonzero(~placed), half)):
        has = "has" if len(without) == 1 else "have"
        problems.append(
            f"{counted(len(without), 'label')} of {len(placed)} {has} no place, the first is label "
            f"{without[0]}: places are compared only where all are known."
        )
    if (away := off_sensor(content)).size:
        x, y = 1e3 * content.labels.loc[away[0], ["x_m", "y_m"]]
        problems.append(
            f"{counted(len(away), 'label')} outside the sensor, the first at ({x:.4g}, {y:.4g}) mm."
        )
    return [*problems, *_places(content)]


_SMALL = 0.01
"""Extent of all places, over the sensor's, that is too small to be that of a touched sensor."""

_ON_A_LINE = 0.1
"""Ratio of the singular values of places, over the sensor's width and height, below which a mirror
image of them fits about as well: that of the public sets is 0.88 and more."""


def metres_as_millimetres(content: Content) -> str:
    """What makes places look like metres in columns of millimetres, a sentence; "" if nothing."""
    places = content.labels[["x_m", "y_m"]].dropna().to_numpy(dtype=np.float64)
    if len(places) < _LEAST:
        return ""
    extent = np.ptp(places, axis=0).max()
    in_metres = content.sensor.outline.contains(*(1e3 * places).T).all()
    # Of one place nothing is told.
    if not 0 < extent < _SMALL * content.sensor.outline.longer_side or not in_metres:
        return ""
    return (
        f"All places lie within {1e3 * extent:.2g} mm of each other: were metres imported as "
        "millimetres?"
    )


def _places(content: Content) -> list[str]:
    """What is wrong with the places of all touches together."""
    placed = content.labels[["x_m", "y_m"]].replace([np.inf, -np.inf], np.nan)
    places = placed.dropna().to_numpy(dtype=np.float64)
    if len(places) < _LEAST or not np.ptp(places, axis=0).any():  # of one place nothing is told
        return []
    if why := metres_as_millimetres(content):
        return [why]
    x0, y0, x1, y1 = content.sensor.outline.bounds
    touches = placed.groupby(touches_of(content.labels)[0])
    middles = touches.mean().to_numpy(dtype=np.float64)
    registering = middles[np.array(validation_every_fifth(len(middles))) == "validation"]
    if len(registering) < _LEAST or len(places) < len(content.labels):  # nothing is registered
        return []
    spread = (registering - registering.mean(axis=0)) / (x1 - x0, y1 - y0)
    longest, shortest = np.linalg.svd(spread, compute_uv=False)
    if shortest <= _ON_A_LINE * longest:
        return [
            "Every fifth touch is used to find how images map to places, and the places of these "
            "lie almost on a line, which does not tell an image from its mirror image: touch again "
            "in another order, or more places."
        ]
    return []


def _electrodes(content: Content, untouched: NDArray[np.int64]) -> tuple[list[str], list[str]]:
    """Problems and facts of the electrodes, by the reference frames; by all if there are none."""
    marked = untouched if len(untouched) else slice(None)
    frames = content.values[marked][:_LOOKED_AT]
    pattern = content.sensor.pattern
    problems, facts = [], []
    if len(pattern.reciprocal_pairs()) and frames.any():
        error = float(reciprocity_error(frames.mean(axis=0), pattern))
        of = "the untouched sensor" if len(untouched) else "all frames"
        facts.append(f"Reciprocity error of {of}: {error:.2%}.")
        if not error <= MAX_RECIPROCITY:
            problems.append(
                f"The reciprocity error is {error:.1%}, and a sound sensor has less than "
                f"{MAX_RECIPROCITY:.0%}: check contacts, and that the pattern is the board's."
            )
    if suspects := suspect_electrodes(frames, pattern):
        named = ", ".join(map(str, suspects))
        problems.append(f"Suspect electrodes: {named} (noisy, or without contact).")
    return problems, facts


def _summary(content: Content) -> str:
    touches = len(content.labels[["first", "last"]].drop_duplicates())
    contacts = f" with {len(content.labels)} contacts" if len(content.labels) > touches else ""
    kind = "emulated board" if content.emulated else "board"
    seconds = float(np.ptp(content.time_s)) if len(content) else 0.0
    return (
        f"{counted(len(content), 'frame')} of {content.sensor.n_measurements} values from the "
        f"{kind} {content.board}, sensor {content.sensor.name}, {seconds:.1f} s, "
        f"{counted(touches, 'touch', 'touches')}{contacts}, started {content.started}."
    )
