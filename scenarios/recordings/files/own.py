"""Recordings of one's own as recorded sets, beside the public ones."""

import shlex
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.descriptors import (
    LOADS,
    PLACES,
    RecordedFile,
    RecordedFrames,
    RecordedSet,
    Source,
    Truth,
    is_validation,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.differences import on_modelled_reference
from eitbench.scenarios.recordings.files.recording_file import (
    Condition,
    Content,
    read_file,
    touches_of,
)
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.storage.files import sha256_of


def is_recording(name: str) -> bool:
    """True if `name` is the path of a recording (.h5), not the name of a public set."""
    return name.lower().endswith(".h5")


def own_set(path: Path) -> RecordedSet:
    """Return the recording at `path` as a recorded set.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        DataCorruptError: no recording, or a damaged one.
        InputError: it has no labels or no reference, so that no method can be evaluated on it.
    """
    try:
        known = path.resolve(strict=True)
        stat = known.stat()
    except OSError as error:
        raise UnreadableError(f"Cannot read the recording {path}: {error.strerror}.") from error
    return _own_set(known, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=32)
def _own_set(path: Path, changed_ns: int, size: int) -> RecordedSet:
    """`own_set`, read again when the file has changed."""
    content = _usable(path)
    touches = len(content.labels[["first", "last"]].drop_duplicates())
    board = "an emulated board" if content.emulated else f"the board {content.board}"
    modelled = ", differences only: the reference is modelled" if content.differences else ""
    return RecordedSet(
        name=path.stem,
        title=f"own recording with {board}, touches: {touches}{modelled}",
        sensor_name=str(path),
        sensor=partial(_same, content.sensor),
        truth=_truth(content),
        source=Source("", "", "", (RecordedFile(path.name, size, sha256_of(path)),)),
        citation="",
        reader=partial(_read, path),
        own=path,
        emulated=content.emulated,
    )


def _same(sensor: Sensor) -> Sensor:
    return sensor


def _truth(content: Content) -> Truth:
    places = content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    return "position" if np.isfinite(places).all() else "none"


def undamaged(path: Path) -> tuple[Content, Condition]:
    """Read the recording at `path` as `read_file` does, unless it was damaged.

    Frames may be missing at the end of a file that was not closed.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        DataCorruptError: no recording, or a damaged one.
    """
    content, condition = read_file(path)
    problem = damage(condition)
    if not problem and outside(content):
        problem = "a label or the reference names frames that are not there"
    if problem:
        raise DataCorruptError(f"{path} is damaged, so that it is not used: {problem}.")
    return content, condition


def _usable(path: Path) -> Content:
    """The content of the file at `path`, if methods can be evaluated on it."""
    content, _ = undamaged(path)
    untouched = has_reference(content)
    for name, marked, option in (
        ("labels", len(content.labels), "--labels SHEET"),
        ("reference frames", untouched, "--reference first:N"),
    ):
        if not marked:
            raise InputError(
                f"{path} has no {name}, so that methods cannot be compared on it: record with "
                f"--guided, or give them by `eitbench recordings import {shlex.quote(str(path))} "
                f"{option} --out NEW.h5`."
            )
    if len(wrong := impossible(content.values)):
        raise DataCorruptError(
            f"{path} is not used: frame {wrong[0]} holds {peak(content.values[wrong[0]])}."
        )
    if problem := impossible_label(content):
        raise DataCorruptError(f"{path} is not used: {problem}.")
    if (half := half_placed(content)).size:
        raise DataCorruptError(f"{path} is not used: label {half[0]} has only one coordinate.")
    if (away := off_sensor(content)).size:
        x, y = 1e3 * content.labels.loc[away[0], ["x_m", "y_m"]]
        raise DataCorruptError(
            f"{path} is not used: label {away[0]} at ({x:.4g}, {y:.4g}) mm is outside the sensor."
        )
    return content


def impossible_label(content: Content) -> str:
    """Sentence on a label that no touch can have; "" for none."""
    touch, number = touches_of(content.labels)
    if number.max(initial=0) >= len(PLACES):
        worst, most = int(touch[number.argmax()]), number.max() + 1
        return f"touch {worst} has {most} contacts, and at most {len(PLACES)} are possible"
    for name, what in (("x_m", "place"), ("y_m", "place"), ("depth_mm", "depth")):
        if (wrong := np.flatnonzero(np.isinf(content.labels[name].to_numpy(np.float64)))).size:
            return f"label {wrong[0]} has an infinite {what}"
    for name, unit in (("force_N", "N"), ("pressure_Pa", "Pa")):
        load = content.labels[name].to_numpy()
        if (wrong := np.flatnonzero((load < 0) | np.isinf(load))).size:
            k = int(wrong[0])
            return f"label {k} has {load[k]:g} {unit}, and a force or pressure is 0 or more"
    return ""


def off_sensor(content: Content) -> NDArray[np.intp]:
    """The labels that name a place outside the sensor, as their numbers."""
    places = content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    inside = content.sensor.outline.reaches(*places.T)
    return np.flatnonzero(~inside & np.isfinite(places).all(axis=1))


def on_reference(content: Content) -> NDArray[np.intp]:
    """The labels with a place on a frame of the untouched sensor, as their numbers."""
    marks, rows = content.labels[["first", "last"]].to_numpy(), content.reference
    taken = [((rows >= first) & (rows <= last)).any() for first, last in marks]
    placed = content.labels["x_m"].notna().to_numpy()
    return np.flatnonzero(placed & np.array(taken, dtype=bool))


def half_placed(content: Content) -> NDArray[np.intp]:
    """The labels with one coordinate alone, as their numbers."""
    known = ~np.isnan(content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64))
    return np.flatnonzero(known.any(axis=1) & ~known.all(axis=1))


def damage(condition: Condition) -> str:
    """Description of a change after the recording was written; "" for none."""
    if condition.damaged:
        count = len(condition.damaged)
        more = f" (and {count - 1} more)" if count > 1 else ""
        return f"the checksum of frame {condition.damaged[0]}{more} is wrong"
    if condition.complete and not condition.sealed:
        return "its labels, events or header were changed after it was closed"
    return ""


def outside(content: Content) -> bool:
    """True if a label or the reference names frames that are not there."""
    first, last = content.labels["first"].to_numpy(), content.labels["last"].to_numpy()
    own = content.labels.loc[has_own_references(content), ["reference_first", "reference_last"]]
    before, until = own.to_numpy().T
    rows = np.concatenate([first, last, before, until, content.reference])
    reversed_rows = (last < first).any() or (until < before).any()
    return bool((rows < 0).any() or (rows >= len(content)).any() or reversed_rows)


def has_reference(content: Content) -> bool:
    """True if it is known of each touch what it changes."""
    common = content.differences or len(content.reference) > 0
    return common or bool(has_own_references(content).all())


def has_own_references(content: Content) -> NDArray[np.bool_]:
    """(k,): the labels that name a reference of their own."""
    return (content.labels[["reference_first", "reference_last"]] != -1).any(axis=1).to_numpy()


def untouched_rows(content: Content) -> NDArray[np.int64]:
    """Rows of the frames that show the untouched sensor, in the order of time, each once.

    Those of single touches where no others are marked.
    """
    if len(content.reference):
        return np.unique(content.reference)
    own = content.labels[has_own_references(content)]
    spans = zip(own["reference_first"], own["reference_last"], strict=True)
    rows = [np.arange(first, last + 1) for first, last in spans]
    return np.unique(np.concatenate([content.reference, *rows]))


def _read(path: Path, folder: Path, sensor: Sensor) -> RecordedFrames:
    del folder, sensor  # the file knows its own
    return frames_of_touches(_usable(path))


def frames_of_touches(content: Content) -> RecordedFrames:
    """A frame for each touch, on the common reference; see `RecordedFrames.voltages`.

    The reference is the mean of the frames that show the untouched sensor; where there are none but
    those of the touches, the median of these over the validation touches. Of differences it is
    modelled, see `on_modelled_reference`.
    """
    labels, values = content.labels, content.values
    touch, number = touches_of(labels)
    marks = labels[number == 0]
    samples = _samples(labels, touch, number)
    pressed = _means(values, marks["first"], marks["last"])
    validation = is_validation(samples)
    if content.differences:
        return on_modelled_reference(pressed, content.sensor, samples)
    own = (marks["reference_first"] != -1).to_numpy()
    released = _means(values, *(marks.loc[own, f"reference_{end}"] for end in ("first", "last")))
    if len(content.reference):
        reference = values[content.reference].mean(axis=0)
    else:
        reference = np.median(released[validation], axis=0)
    pressed[own] += reference - released
    return RecordedFrames(pressed, reference, samples)


def _means(values: Array, first: pd.Series, last: pd.Series) -> Array:
    """Means (n, M) of the rows `first` to `last` (n,) of `values`."""
    rows = zip(first, last, strict=True)
    means = [values[start : stop + 1].mean(axis=0) for start, stop in rows]
    return np.array(means).reshape(-1, values.shape[1])


def _samples(
    labels: pd.DataFrame, touch: NDArray[np.integer], number: NDArray[np.integer]
) -> pd.DataFrame:
    """Samples of n touches, from k labels: forces add up, depth and pressure are shared.

    Loads that no touch has are left out, and a state that only some touches have.
    """
    n, most = (int(part.max(initial=-1)) + 1 for part in (touch, number))
    by_touch = labels.groupby(touch)
    samples = pd.DataFrame({"split": validation_every_fifth(n), "touched": True})
    for k in range(most):
        for axis, name in zip(PLACES[0], PLACES[k], strict=True):
            place = np.full(n, np.nan)
            place[touch[number == k]] = labels.loc[number == k, axis]
            samples[name] = place
    for name in ("depth_mm", "pressure_Pa"):
        alike = by_touch[name].nunique(dropna=False) == 1
        samples[name.replace("Pa", "pa")] = by_touch[name].first().where(alike)
    samples["force_N"] = (
        by_touch["force_N"].sum().where(by_touch["force_N"].count() == by_touch.size())
    )
    samples["state"] = labels.loc[number == 0, "state"].to_numpy()
    samples["contacts"] = by_touch.size()
    unknown = [name for name in LOADS if samples[name].isna().all()]
    unknown += ["state"] * bool((samples["state"] == "").any())
    unknown += ["contacts"] * (most == 1)
    return samples.drop(columns=unknown)
