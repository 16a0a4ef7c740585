"""Own recordings: what is read of damaged ones, and what is said of them."""

import random
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError, EitbenchError
from eitbench.scenarios.recordings.files.own import own_set, undamaged
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check, suspect_electrodes
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor

Array = np.ndarray[Any, np.dtype[np.float64]]
N = 30


def untouched(n: int = N, noise: float = 1e-4) -> Array:
    """Frames (n, 208) of the untouched default sensor, with channels 1 % uneven."""
    foam = sensor("foam16")
    clean = forward_model(foam).voltages(np.ones(foam.image_shape))
    draws = np.random.default_rng(5)
    uneven = clean * (1 + 0.01 * draws.normal(size=len(clean)))
    return np.asarray(uneven + noise * draws.normal(size=(n, len(clean))) * np.std(clean))


def append_untouched(recorder: Recorder, n: int) -> None:
    for k, values in enumerate(untouched(n)):
        recorder.append(Frame(k, k, k, values))


def record(
    path: Path, values: Array, *, number: Array | None = None, time_s: Array | None = None
) -> Path:
    with Recorder(path, sensor("foam16"), "fake", firmware="1") as recorder:
        for k, frame in enumerate(values):
            recorder.append(
                Frame(
                    k if number is None else int(number[k]),
                    k / 10 if time_s is None else float(time_s[k]),
                    k / 10,
                    frame,
                )
            )
        if len(values):
            recorder.mark_reference(0, 9)
            recorder.label(10, 14, x_m=0.03, y_m=0.04, state="a")
            recorder.event("started", 0.0)
    return path


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recordings") / "sound.h5", untouched())


def altered(sound: Path, folder: Path, change: Callable[[h5py.File], None]) -> Path:
    path = folder / "altered.h5"
    path.write_bytes(sound.read_bytes())
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def test_a_sound_recording_has_no_problems(sound: Path) -> None:
    problems, (summary, reciprocity, agreement) = check(sound)
    assert problems == []
    assert summary.startswith("30 frames of 208 values from the board fake, sensor foam16, 2.9 s,")
    assert "1 touch, started" in summary
    assert "Reciprocity error of the untouched sensor: 1." in reciprocity
    assert "against the model of sensor foam16: correlation 1.00, misfit 0.9%" in agreement


def set_item(name: str, key: Any, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file[name].__setitem__(key, value)


def delete(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(name)


def attribute(name: str, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.__setitem__(name, value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (set_item("frames/values", (7, 3), 0.5), "The checksum of frame 7 is wrong"),
        (set_item("frames/values", slice(3, 5), 0.5), "of frame 3 (and 1 more) is wrong"),
        (set_item("frames/number", 29, 3), "The checksum of frame 29 is wrong"),
        (
            set_item("labels", 0, (99, 99, 0, 0, 0, 0, 0, b"", -1, -1)),
            "labels, events or header were changed",
        ),
        (attribute("board", np.bytes_("teensy")), "labels, events or header were changed"),
        (attribute("version", 9), "is no recording of layout 2"),
        (attribute("format", np.bytes_("x")), "is no recording of layout 2"),
        (attribute("sensor", np.bytes_('{"name": "x"}')), "described wrongly: outline: Field"),
        (delete("frames/time_s"), "is damaged: it has no 'frames/time_s'"),
        (delete("frames"), "is damaged: it has no 'frames/values'"),
        (set_item("pattern", 0, (0, 1, 2, 3)), "its pattern is not that of its sensor"),
        (
            lambda file: file["frames/values"].resize(10**12, axis=0),
            "'frames/values' claims to be larger than the file",
        ),
    ],
)
def test_alterations_are_told(
    sound: Path, tmp_path: Path, change: Callable[[h5py.File], None], says: str
) -> None:
    problems, _ = check(altered(sound, tmp_path, change))
    assert any(says in problem for problem in problems), problems


def with_nan() -> Array:
    values = untouched()
    values[12, 3] = np.nan
    return values


COUNT = np.arange(float(N))


@pytest.mark.parametrize(
    ("recorded", "says"),
    [
        ({"values": with_nan()}, "1 impossible frame, the first is frame 12: nan as value 3"),
        ({"time_s": np.where(COUNT > 20, COUNT - 9, COUNT)}, "time_s goes back at frame 21"),
        ({"time_s": np.full(N, np.nan)}, "time_s holds values that are not numbers"),
        (
            {"number": COUNT + 3 * (COUNT > 7)},
            "The board's running numbers show that 3 frames were lost (9.1%)",
        ),
        ({"number": np.minimum(COUNT, 8)}, "running number does not grow at frame 9"),
        ({"values": untouched(12)}, "Label 0 names frames 10 to 14, and there are frames 0 to 11"),
        ({"values": untouched(5)}, "The reference names frames that are not there"),
        ({"values": np.random.default_rng(1).normal(size=(N, 208))}, "The reciprocity error is 1"),
    ],
)
def test_what_was_recorded_wrongly_is_told(
    tmp_path: Path, recorded: dict[str, Array], says: str
) -> None:
    problems, _ = check(record(tmp_path / "a.h5", **({"values": untouched()} | recorded)))
    assert any(says in problem for problem in problems), problems


def test_a_recording_that_is_no_set_is_sound_and_says_what_it_needs(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.h5", sensor("foam16"), "fake") as recorder:
        append_untouched(recorder, 5)
    problems, facts = check(tmp_path / "a.h5")
    assert problems == []
    assert all(part in facts[1] for part in ("reference frames", "touches", "--guided"))
    assert facts[2].startswith("Reciprocity error of all frames: 1.")


def test_a_recording_without_frames_is_told(tmp_path: Path) -> None:
    Recorder(tmp_path / "a.h5", sensor("foam16"), "fake").close()
    assert check(tmp_path / "a.h5")[0] == ["It holds no frames."]


def test_labels_off_the_sensor_are_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.h5", sensor("foam16"), "fake") as recorder:
        append_untouched(recorder, 2)
        recorder.mark_reference(0, 0)
        recorder.label(1, 1, x_m=0.05, y_m=0.2)
    problems, _ = check(tmp_path / "a.h5")
    assert problems == ["1 label outside the sensor, the first at (50, 200) mm."]
    with pytest.raises(DataCorruptError, match=r"label 0 at \(50, 200\) mm is outside the sensor"):
        own_set(tmp_path / "a.h5")


def test_touches_on_frames_of_the_untouched_sensor_are_told(tmp_path: Path) -> None:
    """The usual slip: numbers of frames are counted from 0, and somebody counted from 1."""
    with Recorder(tmp_path / "a.h5", sensor("foam16"), "fake") as recorder:
        append_untouched(recorder, 4)
        recorder.mark_reference(0, 1)
        recorder.label(1, 2, x_m=0.05, y_m=0.05)
        recorder.label(3, 3, x_m=0.03, y_m=0.05)
    problems, _ = check(tmp_path / "a.h5")
    assert problems[0] == (
        "1 touch on frames of the untouched sensor, the first is label 0: frames are counted from "
        "0."
    )


def test_impossible_frames_are_told(tmp_path: Path) -> None:
    values = untouched()
    values[12, 3] = 3e38
    path = record(tmp_path / "a.h5", values=values)
    what = "3e+38 V/A as value 3, where less than 1e+10 is possible"
    assert check(path)[0] == [f"1 impossible frame, the first is frame 12: {what}."]
    with pytest.raises(DataCorruptError, match=re.escape(f"frame 12 holds {what}")):
        own_set(path)


def test_files_of_other_kinds_are_told(tmp_path: Path, sound: Path) -> None:
    text = tmp_path / "text.h5"
    text.write_text("time,v0\n")
    assert check(text)[0] == [f"{text} is not an HDF5 file, so it is no recording of eitbench's."]
    (tmp_path / "empty.h5").write_bytes(b"")
    assert "is not an HDF5 file" in check(tmp_path / "empty.h5")[0][0]
    with pytest.raises(DataUnavailableError, match=r"Cannot read the recording .*No such file"):
        check(tmp_path / "none.h5")
    with pytest.raises(DataUnavailableError, match="Is a directory"):
        check(tmp_path)
    cut = tmp_path / "cut.h5"
    cut.write_bytes(sound.read_bytes()[:-5000])
    assert check(cut)[0] == [f"{cut} is damaged: it was cut short."]


def killed(sound: Path, folder: Path) -> Path:
    """The same recording, as a killed recorder leaves it."""
    content, _ = read_file(sound)
    with Recorder(folder / "running.h5", sensor("foam16"), "fake") as recorder:
        for k, frame in enumerate(content.values):
            recorder.append(Frame(k, k / 10, k / 10, frame))
        while len(read_file(folder / "running.h5")[0]) < N:
            time.sleep(0.05)
        (folder / "killed.h5").write_bytes((folder / "running.h5").read_bytes())
    return folder / "killed.h5"


def test_labels_of_a_frame_that_was_cut_off_go_with_it(sound: Path, tmp_path: Path) -> None:
    values = read_file(sound)[0].values
    running, cut = tmp_path / "running.h5", tmp_path / "cut.h5"
    with Recorder(running, sensor("foam16"), "fake") as recorder:
        for k, frame in enumerate(values):
            recorder.append(Frame(k, k / 10, k / 10, frame))
        recorder.mark_reference(0, 3)
        for row in (N - 2, N - 1):
            recorder.label(row, row, x_m=0.05, y_m=0.05)
        while len(read_file(running)[0].labels) < 2:
            time.sleep(0.05)
        content = running.read_bytes()
    last = content.rindex(values[-1].tobytes())
    cut.write_bytes(content[:last] + b"x" + content[last + 1 :])
    kept, condition = read_file(cut)
    assert (len(kept), condition.trimmed, condition.unlabelled) == (N - 1, 1, 1)
    assert kept.labels["first"].tolist() == [N - 2]
    assert undamaged(cut)[0].reference.tolist() == [0, 1, 2, 3]
    assert "1 at its end are lost, and 1 label with them" in check(cut)[0][0]


@pytest.mark.slow
@pytest.mark.parametrize("closed", [True, False])
def test_mutated_files_are_read_or_refused(sound: Path, tmp_path: Path, closed: bool) -> None:
    """Whatever is changed: no crash or hang, and never a value that was not recorded."""
    original = (sound if closed else killed(sound, tmp_path)).read_bytes()
    path, used = tmp_path / "mutated.h5", len(original.rstrip(b"\0"))
    values = read_file(sound)[0].values
    draws = random.Random(7)
    refused = 0
    for _ in range(200):
        mutated = bytearray(original)
        # Most of the file is voltages; what steers the reader lies at its ends.
        reach = draws.choice([200, 4000, used])
        for _ in range(draws.choice([1, 1, 3, 30])):
            place = draws.randrange(reach)
            mutated[place if draws.random() < 0.7 else used - 1 - place] = draws.randrange(256)
        if draws.random() < 0.2:
            del mutated[draws.randrange(used) :]
        path.write_bytes(mutated)
        try:
            content, condition = read_file(path)
        except EitbenchError:
            refused += 1
            continue
        if not condition.damaged:
            assert np.array_equal(content.values, values[: len(content)])
            assert len(content) == N or not closed
    assert 20 < refused < 200


def spoilt(electrode: int, kind: str) -> tuple[Array, Sensor]:
    """Frames of a sensor whose `electrode` has ten times the noise, or no contact."""
    foam = sensor("foam16")
    src, sink, a, b = foam.pattern.table.T
    values = untouched(50, noise=1e-3)
    draws = np.random.default_rng(electrode)
    if kind == "noisy":
        noise = 1e-3 * np.std(values[0]) * draws.normal(size=(50, 16, 16))
        noise[:, :, electrode] *= 10  # of the potential, in every drive anew
        return values + noise[:, src, a] - noise[:, src, b], foam
    # No current flows, and its potential is another channel's crosstalk.
    values[:, (src == electrode) | (sink == electrode)] *= 1e-3
    sensed = (a == electrode) | (b == electrode)
    values[:, sensed] *= draws.uniform(-1, 0.3, size=int(sensed.sum()))
    return values, foam


@pytest.mark.parametrize("kind", ["noisy", "dead"])
@pytest.mark.parametrize("electrode", [0, 3, 10])
def test_a_bad_electrode_is_the_only_suspect(electrode: int, kind: str) -> None:
    frames, foam = spoilt(electrode, kind)
    assert suspect_electrodes(frames, foam.pattern) == (electrode,)


@pytest.mark.parametrize("offset", [1, 3])
@pytest.mark.parametrize("dead", [0, 5])
def test_beside_an_electrode_that_sends_zeros_no_other_is_suspect(offset: int, dead: int) -> None:
    """Of eight electrodes half of the values are zeros: the others are noisy beside them."""
    pattern = offset_pattern(8, offset)
    draws = np.random.default_rng(0)
    still = draws.uniform(1, 2, size=pattern.n_measurements)
    pairs = pattern.reciprocal_pairs()
    still[pairs[:, 1]] = pattern.reciprocal_signs(pairs) * still[pairs[:, 0]]
    frames = still + 1e-3 * draws.normal(size=(30, len(still)))
    frames[:, (pattern.table == dead).any(axis=1)] = 0.0
    assert suspect_electrodes(frames, pattern) == (dead,)


def test_two_bad_electrodes_are_both_named() -> None:
    noisy, foam = spoilt(4, "noisy")
    dead, _ = spoilt(9, "dead")
    of_dead = (foam.pattern.table == 9).any(axis=1)
    frames = np.where(of_dead, dead, noisy)
    assert set(suspect_electrodes(frames, foam.pattern)) == {4, 9}


def test_sound_electrodes_are_not_suspect() -> None:
    assert suspect_electrodes(untouched(50), sensor("foam16").pattern) == ()
    assert suspect_electrodes(untouched(1), sensor("foam16").pattern) == ()
    exact = np.repeat(untouched(1, noise=0), 9, axis=0)
    assert suspect_electrodes(exact, sensor("foam16").pattern) == ()


def test_suspects_are_named_by_the_check(tmp_path: Path) -> None:
    frames, _ = spoilt(6, "dead")
    problems, _ = check(record(tmp_path / "a.h5", frames))
    assert "Suspect electrodes: 6 (noisy, or without contact)." in problems
