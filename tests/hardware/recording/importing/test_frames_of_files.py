"""Frames in files of other programs become recordings: no frame or choice is lost in silence."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from tests.support.frame_files import KINDS, VALUES, Import, full_matrices, hdf5, save
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.hardware.recording.exchange import import_recording
from eitbench.hardware.recording.importing.arrays import Choice, find_frames, full_table
from eitbench.hardware.recording.importing.recording import ImportOptions
from eitbench.hardware.recording.importing.sources import arrays_of, found_files, read_arrays
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording
from eitbench.scenarios.sensors.patterns import offset_pattern, ring_pattern
from eitbench.scenarios.sensors.sensor import Sensor


@pytest.mark.parametrize("name", KINDS)
def test_frames_of_every_kind_of_file_are_the_same(tmp_path: Path, skin: Sensor, name: str) -> None:
    if name.endswith(".xlsx"):
        pytest.importorskip("openpyxl")
    save(tmp_path / name, VALUES)
    found = find_frames(arrays_of(tmp_path / name), skin, tmp_path / name, Choice())
    np.testing.assert_allclose(found.values, VALUES, rtol=1e-15)


def test_what_is_missing_is_said(tmp_path: Path, imported: Import, skin: Sensor) -> None:
    save(tmp_path / "many.npz", VALUES)
    content, said = imported("many.npz")
    assert len(content) == 6
    assert "From 1 file: array 'volts', a frame is a row." in said
    assert "Reference: 0 frames, since neither the files nor --reference name any." in said
    assert "Touches: none, since the files hold no labels and --labels names no" in said
    assert "Not used: time (6)." in said
    save(tmp_path / "driven.npz", VALUES)
    _, said = imported("driven.npz")
    assert "of its 64 values 24 are dropped that the pattern does not measure (of at most 9" in said
    with pytest.raises(InputError, match="does not say on which sensor"):
        import_recording([str(tmp_path / "many.npz")], tmp_path / "x.h5")


@pytest.mark.parametrize(
    ("name", "says"), [("nope", "Cannot read .*nope: No such file"), ("a.dat", "a.dat is not read")]
)
def test_files_that_are_not_read_are_refused(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "a.dat").write_text("1")
    with pytest.raises(EitbenchError, match=says):
        read_arrays(tmp_path / name)


def test_what_is_no_file_of_frames_is_told(tmp_path: Path, imported: Import) -> None:
    folder = tmp_path / "presses"
    folder.mkdir()
    np.savetxt(folder / "press1.csv", VALUES, delimiter=",")
    path = folder / "press1.csv"
    for options in ({"reference": str(path)}, {"labels": path}):
        with pytest.raises(InputError, match="no file of frames is left"):
            imported("presses/press1.csv", **options)
    with pytest.raises(InputError, match="--reference is empty: name a file, first:N"):
        imported("presses/press1.csv", reference="")
    # A shell names the reference among the files, and a folder holds notes.
    np.savetxt(folder / "rest.csv", VALUES[:2], delimiter=",")
    content, _ = imported(
        "presses/press1.csv", "presses/rest.csv", reference=str(folder / "rest.csv")
    )
    assert len(content) == 8
    for text in ("hi", "hi there\nall of you\n"):
        (folder / "notes.txt").write_text(text)
        with pytest.raises(EitbenchError, match="holds no frames, leave it out, for example by"):
            imported("presses")


def test_complex_values_are_chosen(tmp_path: Path, imported: Import, skin: Sensor) -> None:
    values = VALUES * (0.6 + 0.8j)
    scipy.io.savemat(tmp_path / "a.mat", {"Z": values})
    np.savez(tmp_path / "b.npz", Z=values)
    hdf5(tmp_path / "c.hdf5", {"Z": values})
    pairs = np.zeros((40, 6), dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"], pairs["imag"] = values.T.real, values.T.imag
    hdf5(tmp_path / "d.mat", {"Z": pairs}, userblock=True)
    lines = [",".join(str(cell).strip("()") for cell in row) for row in values.tolist()]
    (tmp_path / "e.csv").write_text("\n".join(lines))
    for name in ("a.mat", "b.npz", "c.hdf5", "d.mat", "e.csv"):
        with pytest.raises(InputError, match="say --values real or --values magnitude"):
            imported(name)
        np.testing.assert_allclose(imported(name, part="real")[0].values, VALUES * 0.6)
    content, said = imported("a.mat", part="magnitude")
    np.testing.assert_allclose(content.values, np.abs(VALUES))
    # Methods have to know it.
    assert content.sensor.pattern.magnitudes
    assert not skin.pattern.magnitudes
    assert "The sensor's pattern in the recording says that values have no sign." in said


def test_what_fits_twice_is_asked(tmp_path: Path, imported: Import) -> None:
    np.savez(tmp_path / "two.npz", a=VALUES, b=VALUES)
    with pytest.raises(InputError, match=r"say with --frames which one \(a, b\)"):
        imported("two.npz")
    square = np.arange(1600.0).reshape(40, 40)
    np.save(tmp_path / "square.npy", square)
    asked = (
        "40 x 40, which fits twice .* say --order rows, or --order columns, or save it as frames"
    )
    with pytest.raises(InputError, match=asked):
        imported("square.npy")
    np.testing.assert_array_equal(imported("square.npy", order="columns")[0].values, square.T)
    matrix = full_matrices(VALUES[:1], 0.0)[0]
    np.save(tmp_path / "matrix.npy", matrix.T)
    with pytest.raises(InputError, match="fits twice"):
        imported("matrix.npy")
    np.testing.assert_array_equal(imported("matrix.npy", order="columns")[0].values, VALUES[:1])


def test_the_order_of_a_full_matrix_is_compared_with_its_zeros(
    tmp_path: Path, imported: Import
) -> None:
    wrong = np.roll(full_matrices(VALUES, 0.0), 1, axis=2)
    np.save(tmp_path / "wrong.npy", wrong.reshape(6, 64))
    with pytest.raises(InputError, match="in another order than in the pattern"):
        imported("wrong.npy")
    dead = VALUES.copy()
    dead[:, 3] = 0.0
    np.save(tmp_path / "dead.npy", full_matrices(dead, 9.0).reshape(6, 64))
    np.testing.assert_array_equal(imported("dead.npy")[0].values, dead)


def test_full_tables_follow_the_pattern() -> None:
    for n, drive, sense in ((16, 1, 1), (16, 3, 3), (16, 8, -1), (32, 16, 1), (8, 3, -2)):
        pattern, whole = (ring_pattern(n, drive, sense, driven=driven) for driven in (False, True))
        table = full_table(pattern)
        assert table is not None
        assert table[0] == n * n
        np.testing.assert_array_equal(whole.table[table[1]], pattern.table)
        mixed = np.random.default_rng(2).permutation(len(pattern.table))
        assert full_table(replace(pattern, table=pattern.table[mixed])) is None
    assert full_table(offset_pattern(16, 3, driven=True)) is None
    assert full_table(ring_pattern(16, 1, -1, rotating=True)) is None


@pytest.mark.slow
def test_bad_files_are_one_sentence(tmp_path: Path, imported: Import) -> None:
    (tmp_path / "short.csv").write_text("1,2,3\n3,4,5\n")
    (tmp_path / "ragged.csv").write_text("# by hand\n1,2\n\n3\n")
    (tmp_path / "words.csv").write_text("1,2\n3,a\n")
    (tmp_path / "series.csv").write_text("v0,v1\n3,a\n")
    (tmp_path / "twice.csv").write_text("v0,v0\n3,4\n")
    np.savetxt(tmp_path / "nan.csv", np.vstack([VALUES[:1], VALUES[:1] * np.nan]), delimiter=",")
    (tmp_path / "binary.csv").write_bytes(b"\xff\x00")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "text.mat").write_text("nonsense")
    for name in ("text.npy", "text.npz", "text.h5", "text.xlsx", "notes.pdf"):
        (tmp_path / name).write_text("nonsense")
    np.save(tmp_path / "pickle.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    scipy.io.savemat(tmp_path / "other.mat", {"v": np.ones((2, 4))})
    scipy.io.savemat(tmp_path / "struct.mat", {"data": {"v": VALUES}})
    (tmp_path / "folder").mkdir()
    for name, says in {
        "short.csv": "holds no frames of sensor 'skin', which have 40 values each: it holds values",
        "ragged.csv": "line 4 has 1 values, and those before it have 2",
        "words.csv": "line 2 holds something else than numbers",
        "series.csv": "line 2 holds something else than numbers",
        "twice.csv": "several columns 'v0'",
        "nan.csv": "frame 1 (counted from 0) holds nan",
        "binary.csv": "it is not UTF-8 text",
        "empty.csv": "holds no lines",
        "text.mat": "is not a readable MATLAB file",
        "text.npy": "cannot be imported",
        "text.npz": "cannot be imported",
        "text.h5": "Cannot read",
        "text.xlsx": "cannot be imported",
        "notes.pdf": "is not read: frames are in .csv",
        "pickle.npy": "cannot be imported",
        "other.mat": "it holds v (2 x 4)",
        "struct.mat": "save its parts|save the parts of structs",
        "missing.csv": "No such file",
        "missing.mat": "No such file",
        "missing.npz": "No such file",
        "missing.xlsx": "No such file",
        "folder": "holds no file of",
        "none*.csv": "holds no file of",
    }.items():
        with pytest.raises(EitbenchError) as caught:
            imported(name)
        assert any(said in str(caught.value) for said in says.split("|")), name
    assert not list(tmp_path.glob("*-out.h5"))


@pytest.mark.parametrize("gap", ["", "--", "1.#QNAN"])
@pytest.mark.parametrize("row", [0, 2])
def test_a_gap_in_the_numbers_makes_no_line_of_names(
    tmp_path: Path, imported: Import, gap: str, row: int
) -> None:
    """The first frame would be lost, and all labels would be one frame off."""
    rows = [[repr(float(value)) for value in values] for values in VALUES]
    rows[row][2] = gap
    (tmp_path / "a.csv").write_text("\n".join(map(",".join, rows)))
    with pytest.raises(EitbenchError):
        imported("a.csv")
    assert not list(tmp_path.glob("*.h5"))


def test_files_do_not_unpack_to_more_than_they_may(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", values=np.zeros(2**26, dtype=np.uint8))
    with pytest.raises(DataCorruptError, match="claims to be much larger than the file"):
        arrays_of(tmp_path / "bomb.npz")
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("v", shape=(2**40,), dtype="f8", chunks=(2**10,))
    with pytest.raises(DataCorruptError, match="claims to be larger than the file"):
        arrays_of(tmp_path / "bomb.h5")
    with h5py.File(tmp_path / "away.h5", "w") as file:
        file.create_dataset("v", (4,), "f8", external=[("/etc/passwd", 0, 32)])
    with pytest.raises(DataCorruptError, match="leads into another file"):
        arrays_of(tmp_path / "away.h5")


def test_two_columns_of_one_number_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("v0,v1,v01,v2\n1,2,99,3\n")
    with pytest.raises(DataCorruptError, match="columns 'v1' and 'v01', which are one number"):
        arrays_of(tmp_path / "a.csv")


def test_text_of_matlab_is_the_same_in_both_versions(tmp_path: Path) -> None:
    """Version 7.3 is HDF5: its texts are numbers there, and its empty arrays their sizes."""
    lines = np.array(["left ", "right"])
    held = {"values": VALUES, "state": "pressed", "sides": lines, "none": np.empty((0, 0))}
    scipy.io.savemat(tmp_path / "a.mat", held, do_compression=True)
    with h5py.File(tmp_path / "b.h5", "w", userblock_size=512) as file:
        file["values"] = VALUES.T
        for name, texts in (("state", ["pressed"]), ("sides", lines.tolist())):
            letters = np.array([[ord(letter) for letter in text] for text in texts], "<u2")
            file.create_dataset(name, data=letters.T).attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("none", data=np.array([0, 0], "<u8")).attrs["MATLAB_empty"] = 1
    (tmp_path / "b.h5").rename(tmp_path / "b.mat")
    old, new = (read_arrays(tmp_path / name) for name in ("a.mat", "b.mat"))
    assert set(old) == set(new)
    for name, array in old.items():
        assert array.shape == new[name].shape
        assert array.tolist() == new[name].tolist()


def test_a_missing_package_is_named(tmp_path: Path, imported: Import, monkeypatch: Any) -> None:
    monkeypatch.setattr("eitbench.scenarios.extras.find_spec", lambda _: None)
    (tmp_path / "a.xlsx").write_bytes(b"")
    with pytest.raises(InputError, match=r"pip install 'eitbench\[excel\]'"):
        imported("a.xlsx")


def test_files_are_sorted_by_numbers(tmp_path: Path) -> None:
    for name in ("press10.csv", "press2.csv", "a.txt", ".hidden.csv"):
        (tmp_path / name).write_text("1")
    found, others = found_files([str(tmp_path)], [tmp_path / "a.txt"])
    assert [path.name for path in found] == ["press2.csv", "press10.csv"]
    assert not others


def test_frames_along_the_last_of_three_axes(tmp_path: Path, imported: Import) -> None:
    """As instruments and MATLAB programs store them: drive x sense pair x frame."""
    np.save(tmp_path / "cube.npy", VALUES.reshape(6, 8, 5).transpose(1, 2, 0))
    content, said = imported("cube.npy")
    np.testing.assert_array_equal(content.values, VALUES)
    assert "array 'values', its axes are drive x sense pair x frame." in said
    np.save(tmp_path / "square.npy", full_matrices(VALUES, 0.0).transpose(1, 2, 0))
    with pytest.raises(InputError, match=r"fits twice \(its axes are .* x frame"):
        imported("square.npy")
    content, said = imported("square.npy", order="rows")
    np.testing.assert_array_equal(content.values, VALUES)
    assert "its axes are drive x sense pair x frame; of its 64 values 24 are dropped" in said
    eight = np.concatenate([VALUES, VALUES[:2]])
    np.save(tmp_path / "eight.npy", full_matrices(eight, 0.0))
    with pytest.raises(InputError, match=r"frame x drive .*; its axes are drive .* x frame\)"):
        imported("eight.npy", order="rows")


def test_what_is_no_array_is_named_as_not_used(tmp_path: Path, imported: Import) -> None:
    struct = {"a": 1.0}
    scipy.io.savemat(tmp_path / "s.mat", {"v": VALUES, "setup": struct})
    assert "Not used: setup (no array)." in imported("s.mat")[1]
    np.savez(tmp_path / "s.npz", v=VALUES, log=np.zeros(2, dtype=[("t", "f8"), ("n", "i4")]))
    assert "Not used: log (no array)." in imported("s.npz")[1]
    hdf5(tmp_path / "s.h5", {"v": VALUES, "note": "by hand"})
    assert "Not used: note (no array)." in imported("s.h5")[1]


@pytest.mark.parametrize(
    ("name", "file", "array"),
    [
        ("ohmc16", "Extracted/ohmc16.mat", "responsedowns"),
        ("hydrogel-repeats", "Extracted/Rectangle/repeats_r_s_16_50_5.mat", None),
        ("ktc2023", "TrainingData/ref.mat", None),
    ],
)
def test_public_files_give_the_frames_of_the_packaged_readers(
    recorded_data: Path, name: str, file: str, array: str | None
) -> None:
    recorded, packaged = recorded_set(name), read_recording(name)
    path = fetch_recording(recorded) / file
    frames = find_frames(arrays_of(path), recorded.sensor(), path, Choice(array)).values
    if name == "ktc2023":  # which the reader divides by the current of each injection
        ratio = (frames[0] / packaged.reference).reshape(76, 31)
        np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1], ratio.shape), rtol=1e-9)
    elif array is None:
        np.testing.assert_array_equal(frames, packaged.voltages)
    else:  # which the reader puts on one reference
        up = find_frames(arrays_of(path), recorded.sensor(), path, Choice("responseups")).values
        np.testing.assert_allclose(packaged.voltages - packaged.reference, frames - up, atol=1e-9)


def test_a_cut_matlab_file_is_one_sentence(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "whole.mat", {"volts": np.ones((6, 208))}, do_compression=True)
    content = (tmp_path / "whole.mat").read_bytes()
    (tmp_path / "cut.mat").write_bytes(content[: len(content) - 9])
    with pytest.raises(DataCorruptError, match=r"not a readable MATLAB file \(it was cut short\)"):
        import_recording([str(tmp_path / "cut.mat")], tmp_path / "no.h5", SKIN)
    assert not (tmp_path / "no.h5").exists()


def test_pairs_that_do_not_fit_are_told(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(4)
    np.savez(tmp_path / "two.npz", down=pressed, up=released[:3])
    np.save(tmp_path / "odd.npy", pressed[:3])
    sheet = str(tmp_path / "places.csv")
    places[:2].to_csv(sheet, index=False)
    for name, options, said in (
        ("two.npz", ImportOptions(Choice("down"), released="up"), "'up' of .* holds 3 frames, and"),
        ("odd.npy", ImportOptions(released="alternating"), "an even number is needed"),
        (
            "odd.npy",
            ImportOptions(differences=True, reference="first:1"),
            "each say what a touch is compared with",
        ),
        (
            "odd.npy",
            ImportOptions(labels=str(sheet), differences=True),
            "has 2 rows of labels for 3",
        ),
    ):
        with pytest.raises(InputError, match=said):
            import_recording([str(tmp_path / name)], tmp_path / "no.h5", SKIN, options)
    assert not (tmp_path / "no.h5").exists()


def test_a_decimal_comma_is_not_taken_for_two_frames(tmp_path: Path, skin: Sensor) -> None:
    """A value a line, as spreadsheets write them in half of Europe."""
    text = "\n".join(f"{value:.4f}".replace(".", ",") for value in VALUES[0])
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(EitbenchError, match="write decimal points, or semicolons"):
        read_arrays(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(text.replace(",", "."))
    found = find_frames(arrays_of(tmp_path / "b.csv"), skin, tmp_path / "b.csv", Choice())
    np.testing.assert_allclose(found.values, VALUES[:1], atol=1e-4)
