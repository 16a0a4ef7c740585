"""Recordings to and from other formats, and public recorded sets as recordings."""

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.importing.arrays import Choice
from eitbench.hardware.recording.importing.labels import moved
from eitbench.hardware.recording.importing.recording import (
    ImportOptions,
    import_files,
    relabelled,
    touches,
)
from eitbench.hardware.recording.importing.reference import reference_rows
from eitbench.hardware.recording.importing.sources import found_files, is_own, own_content
from eitbench.hardware.recording.recorder import Recorder, check_new
from eitbench.scenarios.errors import InputError, counted, unknown_name
from eitbench.scenarios.recordings import RECORDED_SETS, recorded_set
from eitbench.scenarios.recordings.descriptors import PLACES, contact_places
from eitbench.scenarios.recordings.fetch import no_untouched_frame, read_recording
from eitbench.scenarios.recordings.files.csv_mat import (
    without_times,
    write_csv,
    write_mat,
)
from eitbench.scenarios.recordings.files.own import off_sensor, on_reference, undamaged
from eitbench.scenarios.recordings.files.pairs import from_differences
from eitbench.scenarios.recordings.files.recording_file import Content, label_table
from eitbench.scenarios.recordings.quality import metres_as_millimetres
from eitbench.scenarios.sensors.sensor import Sensor

_OF_HEADER = ("firmware", "emulated", "started", "differences")
_NOTHING_SAID = ImportOptions()


def export_recording(path: Path, to: Path) -> str:
    """Write the recording at `path` to the new file `to`; of one that was cut off, what is intact.

    Args:
        path: of the recording.
        to: a name that ends in .csv, .mat or .h5.

    Returns:
        How many frames were written, and what is missing, in sentences.

    Raises:
        InputError: another ending, `to` exists already, or there are no frames.
        UnreadableError, DataCorruptError: the recording cannot be read, or is damaged.
    """
    writers = {".csv": write_csv, ".mat": write_mat, ".h5": write_recording}
    if to.suffix not in writers:
        raise InputError(f"A recording is exported to .csv, .mat or .h5, not to {to.name!r}.")
    content, condition = undamaged(path)
    if to.exists():
        raise InputError(f"{to} exists already and is never overwritten: name another file.")
    if not len(content):
        raise InputError(f"{path} holds no frames: there is nothing to export.")
    with _whole(to):
        writers[to.suffix](content, to)
    written = f"{len(content)} frames are in {to}."
    if condition.complete:
        return written
    return f"{written} {path} was cut off, so that what followed them is lost."


def import_recording(
    sources: Sequence[str],
    to: Path,
    sensor: Sensor | None = None,
    options: ImportOptions = _NOTHING_SAID,
) -> list[str]:
    """Make the new recording `to` of `sources`; what was found, in sentences.

    Args:
        sources: files of other programs, folders and patterns of them; or one file that
            `export_recording` wrote, one recording that gets other labels or another reference, or
            the name of a public recorded set.
        to: a name that ends in .h5.
        sensor: that the frames were measured on, for files that do not say.
        options: what the user says about the files.

    Raises:
        InputError: a sensor where none is needed or none where one is, an unknown source, or `to`
            exists already.
        UnreadableError, DataUnavailableError, DataCorruptError: a source cannot be read, or is
            not what it should be.
    """
    check_new(to)
    content, said = _imported(sources, sensor, options)
    if (on := on_reference(content)).size:
        first, last = content.labels.loc[on[0], ["first", "last"]]
        raise InputError(
            f"Touch {on[0] + 1} is on the frames {first} to {last}, and the reference has some of "
            "these, of the untouched sensor: choose other frames with --reference."
        )
    write_recording(content, to)
    frames = counted(len(content), "frame")
    values = f"{content.sensor.n_measurements} values of sensor {content.sensor.name!r}"
    return [f"{frames} of {values} are in {to}.", *said, *_off_sensor(content, options)]


FAR = 10
"""Sizes of a sensor that no origin is away."""


def _off_sensor(content: Content, options: ImportOptions) -> list[str]:
    """A sentence on places outside the sensor, or all at nearly the same place, if they are."""
    if why := metres_as_millimetres(content):
        return [why]
    if not (away := off_sensor(content)).size:
        return []
    x, y = 1e3 * content.labels.loc[away[0], ["x_m", "y_m"]]
    x0, y0, x1, y1 = (f"{1e3 * bound:.4g}" for bound in content.sensor.outline.bounds)
    said = (
        f"Places outside the sensor: {len(away)}, the first at ({x:.4g}, {y:.4g}) mm; the sensor "
        f"reaches from ({x0}, {y0}) to ({x1}, {y1}) mm."
    )
    if options.origin_mm is not None:
        return [f"{said} Their origin is that of --origin, in mm: look whether it is right."]
    places = content.labels[["x_m", "y_m"]]
    inside = not off_sensor(replace(content, labels=content.labels.assign(**places / 1e3))).size
    left, bottom, right, top = content.sensor.outline.bounds
    if inside and places.abs().to_numpy().max() > FAR * max(right - left, top - bottom):
        said += " Read as millimetres they are inside: name the columns x_mm and y_mm."
    else:
        said += " If their origin lies elsewhere, give it with --origin."
    return [said]


def _imported(
    sources: Sequence[str], sensor: Sensor | None, options: ImportOptions
) -> tuple[Content, list[str]]:
    path = Path(sources[0])
    if len(sources) == 1 and not path.suffix and path.name == sources[0] and not path.exists():
        if sources[0] not in RECORDED_SETS:
            raise unknown_name("file, folder or recorded set", sources[0], RECORDED_SETS)
        if sensor is not None or options != _NOTHING_SAID:
            raise InputError(
                f"The recorded set {sources[0]!r} has a sensor and labels of its own: leave out "
                "all options but --out."
            )
        return _public(sources[0])
    if len(sources) == 1 and is_own(path):
        of_frames = options.frames != Choice() or options.released or options.differences
        if sensor is not None or of_frames:
            raise InputError(
                f"{path} says what was measured on which sensor: leave out --sensor, --frames, "
                "--order, --values, --released and --differences."
            )
        return _relabelled(path, options)
    if sensor is None:
        found_files(sources)  # which may not be there
        raise InputError(
            f"{sources[0]} does not say on which sensor it was measured: give --sensor."
        )
    return import_files(sources, sensor, options)


def _relabelled(path: Path, options: ImportOptions) -> tuple[Content, list[str]]:
    """A recording, or an exported one, with the labels and the reference that the user gives."""
    if path.suffix == ".h5" and options == _NOTHING_SAID:
        raise InputError(f"{path} is a recording already: use it as it is.")
    content = own_content(path)
    if options.reference is not None and content.differences:
        raise no_untouched_frame(path)
    if options.reference is not None:
        content = replace(content, reference=reference_rows(options.reference, len(content)))
    said = [f"Reference: {counted(len(content.reference), 'frame')}."]
    if options.labels is not None:
        labels, of_labels = relabelled(content, path, options)
        return replace(content, labels=labels), [*said, *of_labels]
    content = replace(content, labels=moved(content.labels, options.origin_mm))
    return content, [*said, touches(content.labels, "the file")]


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Write the new file `path` wholly, or not at all: a part of it would look like all."""
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def write_recording(content: Content, to: Path) -> None:
    """Write `content` to the new recording `to`.

    Raises:
        InputError: `to` exists already.
        RecorderError: it cannot be written.
    """
    named = {name: getattr(content, name) for name in _OF_HEADER}
    columns = (content.number.tolist(), content.time_s.tolist(), content.received_s.tolist())
    check_new(to)
    with _whole(to), Recorder(to, content.sensor, content.board, **named) as recorder:
        for frame in zip(*columns, content.values, strict=True):
            recorder.append(Frame(*frame))
        for row in content.reference.tolist():
            recorder.mark_reference(row, row)
        for label in content.labels.to_dict("records"):
            recorder.label(**{str(name): value for name, value in label.items()})
        for event in content.events.to_dict("records"):
            recorder.event(event["text"], event["time_s"])


def _public(name: str) -> tuple[Content, list[str]]:
    """A public set: its reference as the first frame, then a frame for each of its samples.

    Of differences only these. Frames of the untouched sensor have no label.
    """
    recorded = recorded_set(name)
    recording = read_recording(name)
    samples = recording.samples
    contacts = _contacts(samples)
    if recording.modelled_reference:
        change = recording.voltages - recording.reference
        origin = f"from {recorded.repository}"
        content = from_differences(change, recorded.sensor(), name, contacts, origin)
        return content, ["Reference: modelled.", touches(content.labels, "the set")]
    rows = contacts.pop("touch").to_numpy() + 1
    labels = label_table(rows, rows, {str(name): column for name, column in contacts.items()})
    frames = np.concatenate([recording.reference[None], recording.voltages])
    content = without_times(frames, recorded.sensor(), name, f"from {recorded.repository}")
    used = {"touched", "contacts", *itertools.chain(*PLACES), *contacts}
    lost = [str(column) for column in samples if column not in used]
    lost += ["true classes"] * (recording.classes is not None)
    said = ["Reference: 1 frame.", touches(labels, "the set")]
    said += [f"Not used: {', '.join(lost)}."] * bool(lost)
    return replace(content, reference=np.array([0]), labels=labels), said


def _contacts(samples: pd.DataFrame) -> pd.DataFrame:
    """A row for each contact of the touched samples of a set: columns of labels, and `touch`.

    `touch` is the number of the sample. A touch at an unknown place has one row.
    """
    places = np.full((len(samples), 1, 2), np.nan)
    if "x_m" in samples:
        places = contact_places(samples)
    there = np.isfinite(places).all(axis=2)
    there[:, 0] |= ~there.any(axis=1)
    touch, contact = np.nonzero(there & samples["touched"].to_numpy(bool)[:, None])
    x_m, y_m = places[touch, contact].T
    found = pd.DataFrame({"touch": touch, "x_m": x_m, "y_m": y_m})
    for name in ("depth_mm", "state"):
        if name in samples:
            found[name] = samples[name].to_numpy()[touch]
    return found.astype({"state": str}) if "state" in found else found
