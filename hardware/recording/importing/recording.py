"""A recording of files that other programs wrote: frames, reference and labels put together."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.hardware.recording.importing import labels as sheets
from eitbench.hardware.recording.importing.arrays import Choice, FrameFile, find_frames
from eitbench.hardware.recording.importing.labels import FramesOf
from eitbench.hardware.recording.importing.reference import REFERENCE, reference_paths, stacked
from eitbench.hardware.recording.importing.sources import (
    ALL_COLUMNS,
    UNREAD,
    found_files,
    read_arrays,
)
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import DataCorruptError, InputError, counted
from eitbench.scenarios.recordings.files.csv_mat import without_times
from eitbench.scenarios.recordings.files.pairs import alternating, from_differences, from_pairs
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.sensors.sensor import Sensor

ALTERNATING = "alternating"
_NO_ROWS = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class ImportOptions:
    """What a user says about the files of an import; None: what the files say.

    Attributes:
        frames: which array holds frames, and how.
        labels: path of a sheet of labels, or `array:NAME:x_mm,y_mm` for an array of the files.
        origin_mm: where the origin of all places lies in the coordinates of the sensor.
        reference: a path, `first:N` frames, `array:NAME` of the same files, or `none`.
        released: the array of the files with a frame of the untouched sensor for each of `frames`;
            `ALTERNATING` where frames are released, pressed, released, pressed ...
        differences: the values are pressed minus released.
    """

    frames: Choice = field(default_factory=Choice)
    labels: str | None = None
    origin_mm: tuple[float, float] | None = None
    reference: str | None = None
    released: str | None = None
    differences: bool = False


def import_files(
    sources: Sequence[str], sensor: Sensor, options: ImportOptions
) -> tuple[Content, list[str]]:
    """The recording of frames of `sensor` in files, folders and patterns, and what was found.

    Raises:
        InputError: something is not there or fits twice, with what to say about it.
        UnreadableError, DataCorruptError: a file cannot be read, or is not what it should be.
    """
    sheet = _sheet(options.labels)
    beside = [*reference_paths(options.reference), *([sheet] if sheet else [])]
    paths, others = found_files(sources, beside)
    files = [_one_of(paths, path, sensor, options) for path in paths]
    hows = Counter(file.frames.how for file in files)
    said = [f"From {counted(count, 'file')}: {how}." for how, count in hows.items()]
    if others:
        said.append(f"Not read: {counted(others, 'file')} of other kinds.")
    if options.frames.part == "magnitude" and not sensor.pattern.magnitudes:
        sensor = replace(sensor, pattern=replace(sensor.pattern, magnitudes=True))
        said.append("The sensor's pattern in the recording says that values have no sign.")
    alone = options.released is not None or options.differences
    content, found = (_touches_alone if alone else _frames)(files, sensor, options)
    said += found
    if unused := _unused(files, options):
        said.append(f"Not used: {', '.join(unused)}.")
    return content, said


def _frames(
    files: list[FrameFile], sensor: Sensor, options: ImportOptions
) -> tuple[Content, list[str]]:
    """The recording of frames that follow each other, and what its marks are."""
    values, parts, rows, of_reference = stacked(files, sensor, options.frames, options.reference)
    table, of_labels = _label_table(files, parts, rows, options)
    content = without_times(values, sensor, "imported")
    labels = sheets.as_labels(table)
    return replace(content, reference=rows, labels=labels), [of_reference, of_labels]


def _touches_alone(
    files: list[FrameFile], sensor: Sensor, options: ImportOptions
) -> tuple[Content, list[str]]:
    """The recording of frames that are touches, one each, with a released frame or as differences.

    Raises:
        InputError: a common reference is given, too; a file has not as many released frames as
            pressed ones; or the labels are for another number of touches.
    """
    if options.reference is not None or (options.released and options.differences):
        raise InputError(
            "--reference, --released and --differences each say what a touch is compared with: "
            "give one of them."
        )
    if options.differences and options.frames.part == "magnitude":
        raise InputError(
            "The magnitude of a difference is not the difference of magnitudes, and has no sign: "
            "say --values real, or give whole frames."
        )
    released = []
    if options.released is not None:
        found = [_pairs(file, sensor, options.frames, options.released) for file in files]
        released, files = [before for before, _ in found], [file for _, file in found]
    pressed, parts, _, _ = stacked(files, sensor, options.frames, "none")
    table, of_labels = _label_table(files, parts, _NO_ROWS, options)
    contacts = None
    if not len(table):
        of_labels = f"Touches: {len(pressed)}, without places, since --labels names no sheet."
    else:
        labels = sheets.as_labels(table)
        if (labels["first"] != labels["last"]).any():
            raise InputError(
                "With --released and --differences each frame is one touch: a label is for one "
                "frame, not for first to last."
            )
        named, touch = np.unique(labels["first"], return_inverse=True)
        contacts = labels.assign(touch=touch)
        if left := len(pressed) - len(named):
            of_labels += f" Left out: {counted(left, 'touch', 'touches')} without a row of labels."
            pressed = pressed[named]
            released = [np.concatenate(released)[named]] if released else []
    if options.differences:
        said = "Reference: none, as the values are differences; methods get the model's frame."
        return from_differences(pressed, sensor, "imported", contacts), [said, of_labels]
    said = "Reference: for each touch the released frame before it."
    before = np.concatenate(released)
    return from_pairs(before, pressed, sensor, "imported", contacts), [said, of_labels]


def _pairs(
    file: FrameFile, sensor: Sensor, choice: Choice, released: str
) -> tuple[Array, FrameFile]:
    """Released frames (n, M) of a file, and the file with its n pressed frames alone."""
    if released == ALTERNATING:
        before, pressed = alternating(file.frames.values)
        return before, replace(file, frames=replace(file.frames, values=pressed))
    named = replace(choice, name=released)
    before = find_frames(file.arrays, sensor, file.path, named).values
    if len(before) != len(file.frames.values):
        raise InputError(
            f"Array {released!r} of {file.path} holds {len(before)} frames, and "
            f"{file.frames.name!r} {len(file.frames.values)}: every touch needs a released frame."
        )
    return before, file


def _one_of(paths: list[Path], path: Path, sensor: Sensor, options: ImportOptions) -> FrameFile:
    """The file at `path`, which may be one that only lies beside the files of frames."""
    try:
        return _read(path, sensor, options)
    except DataCorruptError as error:
        if len(paths) == 1:
            raise
        raise DataCorruptError(
            f"{error} If it holds no frames, leave it out, for example by 'press*.csv'."
        ) from error


def _read(path: Path, sensor: Sensor, options: ImportOptions) -> FrameFile:
    arrays, choice = read_arrays(path), options.frames
    taken = {REFERENCE, options.released, (options.reference or "").removeprefix("array:")}
    # `reference` and `label_...` are what our exported files call them.
    others = {
        name: array
        for name, array in arrays.items()
        if choice.name == name or not (name in taken or sheets.is_label(name))
    }
    return FrameFile(path, arrays, find_frames(others, sensor, path, choice))


def relabelled(
    content: Content, path: Path, options: ImportOptions
) -> tuple[pd.DataFrame, list[str]]:
    """The labels that a sheet gives to the recording at `path`, and what they are.

    A touch that was labelled before keeps the reference that it had, unless the sheet names one.
    """
    if (sheet := _sheet(options.labels)) is None:
        raise InputError(
            f"{path} is a recording, whose arrays have names of its own: --labels names a sheet."
        )
    part = FramesOf(path, 0, len(content))
    table, said = _of_sheet(sheet, [part], content.reference)
    labels = sheets.as_labels(sheets.moved(table, options.origin_mm))
    if "reference_first" not in table:
        had = content.labels.drop_duplicates(["first", "last"])
        kept = labels[["first", "last"]].merge(had, on=["first", "last"], how="left")
        for name in ("reference_first", "reference_last"):
            labels[name] = kept[name].fillna(-1).astype(np.int64)
    return labels, [said]


def _sheet(labels: str | None) -> Path | None:
    """The path of the sheet that `--labels` names; None where it names an array, or nothing."""
    return None if labels is None or labels.startswith("array:") else Path(labels)


def _of_sheet(path: Path, parts: list[FramesOf], reference: Index) -> tuple[pd.DataFrame, str]:
    """Labels by rows of the recording, of the sheet at `path`, and what they are."""
    paths, _ = found_files([str(path)])
    if len(paths) > 1:
        raise InputError(f"--labels {path} leads to {len(paths)} files: name one sheet.")
    labels, unused = sheets.read_sheet(read_arrays(paths[0]), paths[0])
    table, how, left_out = sheets.placed(labels, parts, reference, path)
    said = touches(table, f"{path} ({how})") + _left_out(left_out)
    if missed := sheets.without_touch(table, parts, reference):
        named = ", ".join(missed[:3]) + (" ..." if len(missed) > 3 else "")
        said += f" Without a touch: {len(missed)} of {len(parts)} files ({named})."
    return table, f"{said} Not used: {', '.join(unused)}." if unused else said


def _label_table(
    files: list[FrameFile], parts: list[FramesOf], reference: Index, options: ImportOptions
) -> tuple[pd.DataFrame, str]:
    """Labels by rows of the recording, of a sheet or else of the files, and what they are."""
    if (sheet := _sheet(options.labels)) is not None:
        table, said = _of_sheet(sheet, parts, reference)
        return sheets.moved(table, options.origin_mm), said
    tables, left_out = [], Counter[str]()
    for file, part in zip(files, parts, strict=True):
        beside = {n: a for n, a in file.arrays.items() if n != file.frames.name}
        if options.labels is not None or any(map(sheets.is_label, beside)):
            inside = (
                sheets.parsed(beside, file.path)
                if options.labels is None
                else sheets.array_labels(file.arrays, options.labels, file.path)
            )
            table, _, without = sheets.placed(inside, [part], reference, file.path)
            tables.append(table)
            left_out += without
    table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    table = sheets.moved(table, options.origin_mm)
    if not tables:
        return table, (
            "Touches: none, since the files hold no labels and --labels names no sheet of them."
        )
    by = "the files" if options.labels is None else options.labels
    return table, touches(table, by) + _left_out(left_out)


def _left_out(counts: Counter[str]) -> str:
    """A sentence on rows of labels that are not used, by the reason why, to follow another."""
    said = [f"{counted(count, 'row')} {why}" for why, count in counts.items() if count]
    return f" Left out: {', '.join(said)}." if said else ""


def touches(table: pd.DataFrame, by: str) -> str:
    """How many touches the labels `by` something are for, and how many have a place: a sentence."""
    if not len(table):
        return f"Touches: none by {by}."
    count = len(table[["first", "last"]].drop_duplicates())
    places = int(sheets.has_place(table).sum())
    all_or = "all" if places == len(table) else places
    contacts = f" with {len(table)} contacts" if len(table) > count else ""
    return f"Touches: {count}{contacts}, {all_or} with a place, by {by}."


def _unused(files: list[FrameFile], options: ImportOptions) -> list[str]:
    """Arrays and columns of the files that are neither frames nor labels nor reference."""
    found: dict[str, None] = {}
    alone = options.released is not None or options.differences
    by_array = options.labels is not None and _sheet(options.labels) is None
    of_labels = sheets.array_columns(options.labels or "")[0] if by_array else None
    for file in files:
        for name, array in file.arrays.items():
            used = name in (file.frames.name, options.released, of_labels, ALL_COLUMNS)
            used |= name == REFERENCE and not alone
            used |= f"array:{name}" == options.reference
            used |= file.frames.name == ALL_COLUMNS and array.dtype.kind != "U"
            used |= sheets.is_label(name) and options.labels is None
            if not used:
                shape = "no array" if array is UNREAD else " x ".join(map(str, array.shape))
                found[f"{name or 'a column without a name'} ({shape})"] = None
    listed = list(found)
    return [*listed[:8], *([f"{len(listed) - 8} more"] if len(listed) > 8 else [])]
