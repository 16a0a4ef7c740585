"""Recordings to other formats and back: no bit is lost, and damage is reported."""

import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from eitbench.hardware.board import Frame
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording import exchange
from eitbench.hardware.recording.exchange import export_recording, import_recording
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.errors import (
    DataCorruptError,
    DataUnavailableError,
    InputError,
)
from eitbench.scenarios.recordings import RECORDED_SETS, recorded_set
from eitbench.scenarios.recordings.fetch import read_recording, reference_frames
from eitbench.scenarios.recordings.files import csv_mat
from eitbench.scenarios.recordings.files.recording_file import Content, read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.sensor import Sensor

Frames = Callable[[int], list[Frame]]


@pytest.fixture
def recorded(tmp_path: Path, skin: Sensor, frames: Frames) -> Path:
    """A recording with everything a file can hold, odd numbers among it."""
    path = tmp_path / "a.h5"
    with Recorder(path, skin, "fake ü", firmware="1, 2\n#3", emulated=True) as recorder:
        for frame in frames(20):
            recorder.append(frame)
        odd = np.array([np.nan, np.inf, -0.0, 5e-324, 1e300, 1 / 3, *np.zeros(34)])
        recorder.append(Frame(2**53 - 1, 1e9 + 1e-6, 1 / 3, odd))
        recorder.mark_reference(0, 2)
        recorder.label(3, 5, x_m=0.01, y_m=1 / 3, state="a, 'b' \"c\"")
        recorder.label(6, 6, force_N=2.5, pressure_Pa=1e4, reference_first=4, reference_last=5)
        recorder.event("first, second\nthird", 0.1)
    return path


def assert_equal(one: Content, other: Content) -> None:
    assert (one.sensor, one.sensor.name) == (other.sensor, other.sensor.name)
    for name in ("board", "firmware", "emulated", "started", "differences"):
        assert getattr(one, name) == getattr(other, name)
    for name in ("number", "time_s", "received_s", "values", "reference"):
        first, second = getattr(one, name), getattr(other, name)
        assert first.dtype == second.dtype
        assert first.tobytes() == second.tobytes(), name
    pd.testing.assert_frame_equal(one.labels, other.labels, check_exact=True)
    pd.testing.assert_frame_equal(one.events, other.events, check_exact=True)


@pytest.mark.parametrize("ending", [".csv", ".mat"])
def test_there_and_back_not_a_bit_is_lost(recorded: Path, tmp_path: Path, ending: str) -> None:
    other = tmp_path / f"b{ending}"
    assert export_recording(recorded, other) == f"21 frames are in {other}."
    said = import_recording([str(other)], tmp_path / "c.h5")
    assert said[0].startswith("21 frames of 40 values")
    content, condition = read_file(tmp_path / "c.h5")
    assert condition.sealed
    assert_equal(read_file(recorded)[0], content)


@pytest.mark.parametrize("ending", [".h5", ".csv", ".mat"])
def test_an_export_that_is_interrupted_leaves_nothing(
    recorded: Path, tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part of a recording would look like all of it."""

    def interrupted(*_: object, **__: object) -> None:
        (tmp_path / f"b{ending}").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(exchange, "write_csv", interrupted)
    monkeypatch.setattr(exchange, "write_mat", interrupted)
    monkeypatch.setattr(Recorder, "label", interrupted)
    with pytest.raises(KeyboardInterrupt):
        export_recording(recorded, tmp_path / f"b{ending}")
    assert not (tmp_path / f"b{ending}").exists()


def test_what_was_cut_off_is_made_whole(recorded: Path, tmp_path: Path, skin: Sensor) -> None:
    with Recorder(tmp_path / "running.h5", skin, "fake") as recorder:
        for frame in [Frame(k, k, k, np.full(40, k + 1.0)) for k in range(5)]:
            recorder.append(frame)
        while len(read_file(tmp_path / "running.h5")[0]) < 5:
            time.sleep(0.02)
        (tmp_path / "cut.h5").write_bytes((tmp_path / "running.h5").read_bytes())
    assert "It was cut off: 5 whole frames are intact." in check(tmp_path / "cut.h5")[0]
    assert export_recording(tmp_path / "cut.h5", tmp_path / "whole.h5") == (
        f"5 frames are in {tmp_path / 'whole.h5'}. {tmp_path / 'cut.h5'} was cut off, so that what "
        "followed them is lost."
    )
    content, condition = read_file(tmp_path / "whole.h5")
    assert condition.sealed
    assert_equal(content, read_file(tmp_path / "running.h5")[0])


def test_what_was_damaged_is_never_made_sound(recorded: Path, tmp_path: Path) -> None:
    with h5py.File(recorded, "r+") as file:
        file["frames/values"][4, 7] += 1
    says = "is damaged, so that it is not used: the checksum of frame 4 is wrong"
    for ending in (".csv", ".mat", ".h5"):
        with pytest.raises(DataCorruptError, match=says):
            export_recording(recorded, tmp_path / f"b{ending}")
    with pytest.raises(DataCorruptError, match=says):
        Replay(recorded)
    with pytest.raises(DataCorruptError, match=says):
        reference_frames(str(recorded))
    assert list(tmp_path.iterdir()) == [recorded]


def test_matlab_finds_arrays_by_their_names(recorded: Path, tmp_path: Path) -> None:
    export_recording(recorded, tmp_path / "b.mat")
    found = scipy.io.loadmat(tmp_path / "b.mat")
    assert found["values"].shape == (21, 40)
    assert found["time_s"].shape == (21, 1)
    assert found["pattern"].shape == (40, 4)
    assert found["label_first"].ravel().tolist() == [3, 6]


def test_frames_that_no_matlab_file_holds_are_told_before(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_mat, "_LONGEST_MAT", read_file(recorded)[0].values.nbytes)
    with pytest.raises(InputError, match=r"GB of frames: files of MATLAB hold less than 2 GB"):
        export_recording(recorded, tmp_path / "a.mat")
    assert not (tmp_path / "a.mat").exists()


def test_bad_sources_are_one_sentence(recorded: Path, tmp_path: Path, skin: Sensor) -> None:
    out = tmp_path / "out.h5"
    export_recording(recorded, tmp_path / "own.csv")
    with pytest.raises(InputError, match="leave out --sensor, --frames"):
        import_recording([str(tmp_path / "own.csv")], out, skin)
    with pytest.raises(InputError, match="has a sensor and labels of its own"):
        import_recording(["ohmc16"], out, skin)
    with pytest.raises(InputError, match="recorded set 'omhc16': did you mean 'ohmc16'"):
        import_recording(["omhc16"], out)
    with pytest.raises(InputError, match="is a recording already"):
        import_recording([str(recorded)], out)
    with pytest.raises(InputError, match=r"exported to \.csv, \.mat or \.h5, not to 'x\.xls'"):
        export_recording(recorded, tmp_path / "x.xls")
    with pytest.raises(InputError, match="exists already"):
        export_recording(recorded, tmp_path / "own.csv")
    with pytest.raises(DataUnavailableError, match="Cannot read the recording"):
        export_recording(tmp_path / "no.h5", tmp_path / "x.csv")
    assert not out.exists()


def test_a_file_that_was_cut_anywhere_is_refused(recorded: Path, tmp_path: Path) -> None:
    export_recording(recorded, tmp_path / "own.csv")
    text = (tmp_path / "own.csv").read_text()
    head, *rows, end = text.rstrip().rsplit("\n", 3)
    assert end == "# frames: 21"
    cuts = {
        f"line {text.count(chr(10)) - 1} has 20 values, and its line of column names has 43": (
            "\n".join([head, rows[0], ",".join(rows[1].split(",")[:20])])
        ),
        "cut short or edited, since its last line, 32, is not '# frames: 21'": (
            "\n".join([head, *rows])[:-1]  # the last number is a digit shorter
        ),
        "is not '# frames: 20'": "\n".join([head, rows[0], end]),
        "is not '# frames: 21'": text.rstrip()[:-1],
        "since its last line, 33, is not '# frames: 21'": text.rstrip()[:-2],
    }
    for says, cut in cuts.items():
        (tmp_path / "cut.csv").write_text(cut)
        with pytest.raises(DataCorruptError, match=says):
            import_recording([str(tmp_path / "cut.csv")], tmp_path / "b.h5")
    assert not (tmp_path / "b.h5").exists()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("# eitbench recording 2", "# eitbench recording 1", "of another layout than 2"),
        ("# sensor:", "# sensr:", "its header or its columns are not complete"),
        ('"x_m": [', '"x_m": ["a", ', "its header or its columns are not complete"),
        ("# reference: [", "# reference: [[1], ", "its header or its columns are not complete"),
        ("# labels: {", "# labels: ", "its labels is damaged"),
        ("number,time_s", "nmber,time_s", "its columns are not"),
        (",v39\n", "\n", "has 43 values, and its line of column names has 42"),
        ("\n0,", "\nnan,", "a number of a frame is no whole number"),
        ("\n0,", "\n0.5,", "a number of a frame is no whole number"),
        ("polygon", "polygn", "described wrongly"),
    ],
)
def test_damaged_headers_are_told(
    recorded: Path, tmp_path: Path, old: str, new: str, says: str
) -> None:
    export_recording(recorded, tmp_path / "own.csv")
    text = (tmp_path / "own.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(DataCorruptError, match=says):
        import_recording([str(tmp_path / "bad.csv")], tmp_path / "b.h5")


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED_SETS)
def test_public_sets_become_recordings(recorded_data: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / "own.h5"
    import_recording([name], path)
    public, own = read_recording(name), read_recording(str(path))
    if public.modelled_reference:
        # The reference is the modelled frame, at a gain that each set's validation presses choose.
        changes = public.voltages - public.reference
        np.testing.assert_allclose(own.voltages - own.reference, changes, rtol=1e-6, atol=1e-8)
        gain = np.linalg.norm(own.reference) / np.linalg.norm(public.reference)
        np.testing.assert_allclose(own.reference, gain * public.reference, rtol=1e-9)
    else:
        np.testing.assert_array_equal(own.voltages, public.voltages[public.samples["touched"]])
        np.testing.assert_array_equal(own.reference, public.reference)
    assert own.modelled_reference == public.modelled_reference
    made = recorded_set(str(path))
    assert made.sensor() == recorded_set(name).sensor()
    assert made.truth == ("position" if "x_m" in public.samples else "none")
    for column in ("x_m", "y_m", "x2_m", "y2_m"):
        if column in public.samples:
            np.testing.assert_array_equal(own.samples[column], public.samples[column])
