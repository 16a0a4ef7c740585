"""Files of other programs become recordings: no frame, label or choice is lost in silence."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.hardware.recording.exchange import export_recording, import_recording
from eitbench.hardware.recording.importing.arrays import Choice, find_frames, full_table
from eitbench.hardware.recording.importing.labels import FramesOf, as_labels, moved, parsed, placed
from eitbench.hardware.recording.importing.recording import ImportOptions
from eitbench.hardware.recording.importing.sources import arrays_of, found_files, read_arrays
from eitbench.hardware.recording.importing.unordered import unordered_frames
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording
from eitbench.scenarios.recordings.files.recording_file import Content, read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.patterns import offset_pattern, ring_pattern
from eitbench.scenarios.sensors.sensor import Sensor

VALUES = np.random.default_rng(1).normal(size=(6, 40)) * 1e-3
NAMES = [f"v{k}" for k in range(40)]


@pytest.fixture
def imported(tmp_path: Path, skin: Sensor) -> Callable[..., tuple[Content, str]]:
    """Import files of `tmp_path`: the content, and all that was said."""

    def run(*sources: str, sensor: Sensor = skin, **options: Any) -> tuple[Content, str]:
        out = tmp_path / f"{len(list(tmp_path.glob('*.h5')))}-out.h5"
        if "labels" in options:
            options["labels"] = str(options["labels"])
        choice = Choice(*(options.pop(name, None) for name in ("name", "order", "part")))
        said = import_recording(
            [str(tmp_path / source) for source in sources],
            out,
            sensor,
            ImportOptions(choice, **options),
        )
        return read_file(out)[0], " ".join(said)

    return run


Import = Callable[..., tuple[Content, str]]


def full_matrices(values: Any, driven: float) -> Any:
    """(n, 8, 8): what the pattern of `skin` leaves out is `driven`."""
    full = np.full((len(values), 64), driven, dtype=values.dtype)
    rows = ring_pattern(8, 3, 3, driven=True).table
    kept = [k for k, (src, sink, a, b) in enumerate(rows) if not {src, sink} & {a, b}]
    full[:, kept] = values
    return full.reshape(-1, 8, 8)


def save(path: Path, values: Any) -> None:
    """`values` (n, 40) as a file of each kind."""
    plain: dict[str, Callable[[], object]] = {
        "plain.csv": lambda: np.savetxt(path, values, delimiter=",", fmt="%.17g"),
        "mark.csv": lambda: np.savetxt(
            path, values, delimiter=",", fmt="%.17g", encoding="utf-8-sig"
        ),
        "named.csv": lambda: pd.DataFrame(values, columns=NAMES).to_csv(path, index=False),
        "numbered.csv": lambda: pd.DataFrame(values).to_csv(path, index=False),
        "indexed.csv": lambda: pd.DataFrame(values).to_csv(path),
        "pairs.csv": lambda: pd.DataFrame(
            values, columns=[f"D{k // 5} S{k % 5}" for k in range(40)]
        ).to_csv(path, index=False),
        "shuffled.csv": lambda: pd.DataFrame(values, columns=NAMES)[sorted(NAMES)].to_csv(path),
        "CAPITALS.CSV": lambda: np.savetxt(path, values, delimiter=",", fmt="%.17g"),
        "tabs.tsv": lambda: np.savetxt(path, values, delimiter="\t", fmt="%.17g"),
        "spaces.txt": lambda: np.savetxt(path, values, header="by hand", fmt="%.17g"),
        "decimal.csv": lambda: pd.DataFrame(values).to_csv(path, sep=";", decimal=","),
        "percent.txt": lambda: np.savetxt(path, values, comments="% ", header="x", fmt="%.17g"),
        "columns.csv": lambda: np.savetxt(path, values.T, delimiter=",", fmt="%.17g"),
        "matlab.mat": lambda: scipy.io.savemat(path, {"volts": values, "fs": 10.0}),
        "columns.mat": lambda: scipy.io.savemat(path, {"volts": values.T, "note": "by hand"}),
        "cube.mat": lambda: scipy.io.savemat(path, {"volts": values.reshape(2, 3, 40)}),
        "one.npy": lambda: np.save(path, values),
        "many.npz": lambda: np.savez(path, volts=values, time=np.arange(6)),
        "full.npz": lambda: np.savez(path, volts=full_matrices(values, 0.0)),
        "driven.npz": lambda: np.savez(path, volts=full_matrices(values, 9.0).reshape(-1, 64)),
        "stacked.csv": lambda: np.savetxt(path, values.reshape(-1, 5), delimiter=",", fmt="%.17g"),
        "excel.xlsx": lambda: pd.DataFrame(values, columns=NAMES).to_excel(path, index=False),
        "sheets.xlsx": lambda: sheets(path, values),
        "any.h5": lambda: hdf5(path, {"run/v": values, "run/t": np.arange(6)}),
        "v73.mat": lambda: hdf5(path, {"v": values.T}, userblock=True),
    }
    plain[path.name]()


def sheets(path: Path, values: Any) -> None:
    with pd.ExcelWriter(path) as writer:
        pd.DataFrame(values).to_excel(writer, sheet_name="Volts", index=False, header=False)
        pd.DataFrame({"t": [1, 2]}).to_excel(writer, sheet_name="Times", index=False)


def hdf5(path: Path, arrays: Mapping[str, Any], *, userblock: bool = False) -> None:
    with h5py.File(path, "w", userblock_size=512 if userblock else 0) as file:
        for name, array in arrays.items():
            file[name] = array
    if userblock:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


KINDS = [
    "plain.csv", "mark.csv", "named.csv", "numbered.csv", "indexed.csv", "pairs.csv",
    "shuffled.csv", "CAPITALS.CSV", "tabs.tsv", "spaces.txt", "decimal.csv", "percent.txt",
    "columns.csv", "matlab.mat", "columns.mat", "cube.mat", "one.npy", "many.npz", "full.npz",
    "driven.npz", "stacked.csv", "excel.xlsx", "sheets.xlsx", "any.h5", "v73.mat",
]  # fmt: skip


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


@pytest.mark.slow
def test_a_folder_of_presses_with_a_sheet(tmp_path: Path, imported: Import) -> None:
    folder = tmp_path / "presses"
    folder.mkdir()
    for k in range(1, 12):
        np.savetxt(folder / f"press{k}.csv", np.full((2, 40), float(k)), delimiter=",")
    (folder / "photo.png").write_bytes(b"")
    np.savetxt(folder / "baseline.csv", VALUES, delimiter=",", fmt="%.17g")
    places = pd.DataFrame(
        {
            "File": [f"press{k}.csv" for k in (11, 2, 1)],
            "X_mm": [10.0, 20.0, 30.0],
            "y_m": [0.01, 0.02, 0.03],
            "Depth_mm": [1.0, 2.0, np.nan],
            "force_N": 0.5,
            "State": ["a", "b", "b"],
        }
    )
    places.to_csv(folder / "places.csv", index=False, encoding="utf-8-sig")
    content, said = imported(
        "presses", labels=folder / "places.csv", reference=str(folder / "baseline.csv")
    )
    np.testing.assert_array_equal(content.values[:6], VALUES)
    # press2 stands before press10.
    assert content.values[6:, 0].tolist() == [float(k) for k in range(1, 12) for _ in range(2)]
    assert content.reference.tolist() == [0, 1, 2, 3, 4, 5]
    labels = content.labels
    assert labels["first"].tolist() == [26, 8, 6]
    assert labels["last"].tolist() == [27, 9, 7]
    np.testing.assert_allclose(labels["x_m"], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(labels["y_m"], [0.01, 0.02, 0.03])
    np.testing.assert_array_equal(labels["depth_mm"], [1.0, 2.0, np.nan])
    assert labels["state"].tolist() == ["a", "b", "b"]
    assert "Touches: 3, all with a place" in said
    assert "Not read: 1 file of other kinds." in said
    assert "force_N" in labels
    again, _ = imported("presses/press*.csv", labels=folder / "places.csv", reference="first:2")
    assert again.reference.tolist() == [0, 1]
    assert again.labels["first"].tolist() == [20, 2, 0]


@pytest.mark.slow
def test_rows_of_a_sheet_find_their_frames(tmp_path: Path, imported: Import) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    np.savetxt(tmp_path / "b.csv", VALUES[:2], delimiter=",")
    sheet = tmp_path / "sheet.csv"

    def rows(text: str, *sources: str, **options: Any) -> list[tuple[int, int]]:
        sheet.write_text(text)
        labels = imported(*sources, labels=sheet, **options)[0].labels
        return list(zip(labels["first"].tolist(), labels["last"].tolist(), strict=True))

    assert rows("frame;x_mm\n3;1,5\n5;2,5\n", "a.csv") == [(3, 3), (5, 5)]
    assert rows("first,last,state\n1,2,one\n3,5,two\n", "a.csv") == [(1, 2), (3, 5)]
    assert rows("file,frame,x_mm\nb,1,3\na,0,4\n", "a.csv", "b.csv") == [(7, 7), (0, 0)]
    assert rows("x_mm,y_mm\n1,2\n3,4\n", "a.csv", "b.csv") == [(0, 5), (6, 7)]
    assert rows("x_mm\n1\n2\n3\n", "a.csv", reference="first:3") == [(3, 3), (4, 4), (5, 5)]
    # Of a row for every frame, those that say nothing are no touches.
    assert rows("x_mm,y_mm\n,\n,\n1,2\n,\n3,4\n,\n", "a.csv") == [(2, 2), (4, 4)]
    # A row alone is for all frames of its file that show no untouched sensor.
    assert rows("x_mm,y_mm\n1,2\n", "a.csv", reference="first:2") == [(2, 5)]
    # Two contacts of one touch, in a spreadsheet with decimal commas.
    assert rows("file;frame;x_mm\na.csv;3;1,5\na.csv;3;9,5\n", "a.csv") == [(3, 3), (3, 3)]
    assert rows("frame,x_mm\n3,1\n3,9\n", "a.csv") == [(3, 3), (3, 3)]


def test_other_columns_of_a_sheet_are_told(tmp_path: Path, imported: Import) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("frame,x_mm,y_mm,Comment,year\n3,10,20,by hand,2024\n5,10,30,,2024\n")
    content, said = imported("a.csv", labels=sheet)
    assert "counted from 0). Not used: Comment, year." in said
    assert content.labels["x_m"].tolist() == [0.01, 0.01]


def test_what_a_sheet_says_nothing_of_is_told(tmp_path: Path, imported: Import) -> None:
    """Presses that would be taken for the untouched sensor, files that would be lost, metres."""
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("x_mm,y_mm\n,\n10,20\n10,30\n20,10\n20,20\n20,30\n")
    content, said = imported("a.csv", labels=sheet, reference="first:3")
    assert "Left out: 2 rows with a place, for frames of the reference." in said
    assert content.labels["first"].tolist() == [3, 4, 5]
    for name in "bcdef":
        np.savetxt(tmp_path / f"{name}.csv", VALUES[:2], delimiter=",")
    rows = [f"{name},{k},{0.01 * k + 0.02},0.0{k + 2}" for name in "abd" for k in range(2)]
    sheet.write_text("\n".join(["file,frame,x_mm,y_mm", *rows]))
    _, said = imported(*(f"{name}.csv" for name in "abcdef"), labels=sheet)
    assert "Without a touch: 3 of 6 files (c.csv, e.csv, f.csv)." in said
    assert "were metres imported as millimetres?" in said
    np.savez(tmp_path / "pairs.npz", down=VALUES, up=VALUES + 1)
    content, _ = imported("pairs.npz", released="up")
    assert len(content) == 2 * len(VALUES)
    with pytest.raises(InputError, match="--origin moves places, and the labels have none"):
        imported("a.csv", reference="first:2", origin_mm=(1.0, 2.0))


@pytest.mark.parametrize("origin", [(np.nan, 0.0), (0.0, np.inf)])
def test_an_origin_has_to_be_finite(origin: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="--origin takes two numbers in mm, got"):
        moved(pd.DataFrame({"x_m": [0.01], "y_m": [0.02]}), origin)


@pytest.mark.parametrize(
    ("column", "says"),
    [
        ({"x_mm": np.array([1.0, np.inf])}, "Column 'x_mm' of sheet.csv holds a number that is"),
        ({"state": np.array(["hard", 65 * "x"])}, "A state has at most 64 bytes, and sheet.csv"),
    ],
)
def test_labels_that_cannot_be_stored_are_refused(column: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parsed({"frame": np.array([1, 2]), **column}, Path("sheet.csv"))


@pytest.mark.parametrize(
    ("name", "says"), [("nope", "Cannot read .*nope: No such file"), ("a.dat", "a.dat is not read")]
)
def test_files_that_are_not_read_are_refused(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "a.dat").write_text("1")
    with pytest.raises(EitbenchError, match=says):
        read_arrays(tmp_path / name)


def test_rows_of_labels_that_are_left_out_are_counted(tmp_path: Path, imported: Import) -> None:
    table = pd.DataFrame(VALUES, columns=NAMES)
    table.to_csv(tmp_path / "a.csv", index=False)
    sheet = tmp_path / "sheet.csv"
    places = pd.DataFrame({"x_mm": [10, 20, np.nan, 30], "y_mm": [10, 20, np.nan, 30]})
    places.to_csv(sheet, index=False)
    left_out = "Left out: 1 row without a place or another value."
    content, said = imported("a.csv", labels=sheet, reference="first:2")
    assert "Touches: 3, all with a place" in said
    assert left_out in said
    assert content.labels["first"].tolist() == [2, 3, 5]
    # The first two rows are for the reference, and no touch is missing there.
    whole = pd.concat([places.iloc[[2, 2]], places], ignore_index=True)
    pd.concat([table, whole], axis=1).to_csv(tmp_path / "b.csv", index=False)
    assert left_out in imported("b.csv", reference="first:2")[1]
    places.fillna(40).to_csv(sheet, index=False)
    assert "Left out" not in imported("a.csv", labels=sheet, reference="first:2")[1]


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


def test_contacts_of_touches_are_counted(tmp_path: Path, imported: Import) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    (tmp_path / "sheet.csv").write_text("frame,x_mm,y_mm\n3,10,20\n3,30,20\n4,10,20\n")
    _, said = imported("a.csv", labels=str(tmp_path / "sheet.csv"), reference="first:2")
    assert "Touches: 2 with 3 contacts, all with a place" in said
    assert "2 touches with 3 contacts, started" in check(tmp_path / "0-out.h5")[1][0]


def test_places_outside_the_sensor_are_told(tmp_path: Path, imported: Import) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    sheet = tmp_path / "sheet.csv"
    for text, says in (
        ("frame,x_mm,y_mm\n3,1,1\n4,150,20\n5,10,300\n", "sensor: 2, the first at (150, 20) mm; "),
        ("frame,x_mm,y_mm\n3,10,20\n", ""),
    ):
        sheet.write_text(text)
        said = imported("a.csv", labels=sheet)[1]
        assert ("Places outside the" in said) == bool(says)
        assert says in said


def test_rows_of_a_reference_are_those_of_the_file() -> None:
    files = [FramesOf(Path("a.csv"), 2, 4), FramesOf(Path("b.csv"), 6, 3)]
    arrays = {
        "file": np.array(["a", "b"]),
        "frame": np.array([1, 2]),
        "reference_first": np.array([0, 1]),
        "reference_last": np.array([1, 1]),
        "force_N": np.array([0.5, np.nan]),
    }
    path = Path("sheet.csv")
    table, _, _ = placed(parsed(arrays, path), files, np.array([0, 1]), path)
    assert table["first"].tolist() == [3, 8]
    assert table["reference_first"].tolist() == [2, 7]
    assert table["reference_last"].tolist() == [3, 7]
    del arrays["file"]
    table, _, _ = placed(parsed(arrays, path), files, np.array([0, 1]), path)
    assert table["reference_first"].tolist() == [2, 3]
    labels = as_labels(table)
    assert labels["reference_last"].tolist() == [3, 3]
    assert labels["force_N"].isna().tolist() == [False, True]
    assert labels["state"].tolist() == ["", ""]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x_mm,y\n1,2\n", "Column 'y' .* has no unit: name it y_mm or y_m"),
        ("x_mm,y_cm\n1,2\n", "Column 'y_cm' .* is unknown: the first line .* x_mm, x_m, y_mm"),
        ("x_mm,Force (mN)\n1,2\n", r"Column 'Force \(mN\)' .* is unknown: the first line"),
        ("x_mm,filename\n1,a.csv\n", "Column 'filename' .* is unknown: the first line"),
        ("colour\n1\n", "Column 'colour' .* is unknown: the first line"),
        ("x_mm,x_m\n1,2\n", "two columns for 'x_m'"),
        ("x_mm\n1\n2\n", "2 rows of labels for 6 frames .* add a column file, frame"),
        ("file,x_mm\nc.csv,1\n", "Row 1 of .* is for the file 'c.csv', which is none of the 1"),
        ("frame,x_mm\n6,1\n", "Row 1 of .* frames 6 to 6, and there are frames 0 to 5"),
        ("first,last\n3,2\n", "Row 1 of .* frames 3 to 2: the last frame is before the first"),
        ("frame,reference_first,reference_last\n3,0,6\n", "frames 0 to 6: .* of the frames 0 to 5"),
        ("frame,reference_first,reference_last\n3,2,1\n", "Row 1 of .* reference frames 2 to 1"),
        ("frame,reference_first\n3,2\n", "Row 1 of .* reference frames 2 to none: give ref"),
        ("file,reference_first,reference_last\na,0,6\n", "Row 1 of .* of the frames 0 to 5"),
        ("frame,x_mm\n1.5,1\n", "whole numbers, counted from 0"),
        ("frame,x_mm\n1,left\n", "Column 'x_mm' of .* should hold numbers only"),
        ("1,2,3\n", "Column 'values' .* is unknown: the first line .* names its columns"),
        ("x_mm1,x_mm2\n1,2\n3,4\n", "'x_mm' .* should be one column of labels"),
        ("", "holds no lines"),
    ],
)
def test_wrong_sheets_are_one_sentence(
    tmp_path: Path, imported: Import, text: str, says: str
) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    (tmp_path / "sheet.csv").write_text(text)
    with pytest.raises(EitbenchError, match=says):
        imported("a.csv", labels=str(tmp_path / "sheet.csv"))
    assert not list(tmp_path.glob("*.h5"))


def test_labels_inside_of_files_are_kept(tmp_path: Path, imported: Import, skin: Sensor) -> None:
    """What MATLAB keeps of an exported recording if its header is left out."""
    marks = {
        "reference": [0, 1],
        "label_first": [2, 4],
        "label_last": [3, 5],
        "label_x_m": [0.01, 0.02],
        "label_y_m": [0.03, 0.04],
        "label_depth_mm": [1.0, np.nan],
    }
    scipy.io.savemat(tmp_path / "a.mat", {"values": VALUES} | marks, oned_as="column")
    np.savez(tmp_path / "a.npz", values=VALUES, **marks)  # type: ignore[arg-type]
    contents = [imported("a.mat")[0], imported("a.npz")[0]]
    table = pd.DataFrame(VALUES, columns=NAMES).assign(
        x_mm=[np.nan, np.nan, 1, 2, 3, 4], state=["", "", "p", "q", "r", "s"], time_s=range(6)
    )
    table.to_csv(tmp_path / "table.csv", index=False)
    for content in contents:
        assert content.reference.tolist() == [0, 1]
        assert content.labels["first"].tolist() == [2, 4]
        assert content.labels["y_m"].tolist() == [0.03, 0.04]
    content, said = imported("table.csv", reference="first:2")
    assert content.labels["first"].tolist() == [2, 3, 4, 5]
    assert content.labels["state"].tolist() == ["p", "q", "r", "s"]
    assert "Not used: time_s (6)." in said
    # Names of arrays alone make no labels; one place may stand for all frames of a file.
    np.savez(tmp_path / "frame.npz", frame=VALUES, first=3, x_mm=10.0, y_mm=20.0)
    content, _ = imported("frame.npz")
    assert content.labels[["first", "last"]].to_numpy().tolist() == [[0, 5]]
    assert content.labels["x_m"].tolist() == [0.01]
    # Of two files each has its own; so has a frame that is called reference.
    content, _ = imported("a.mat", "a.npz")
    assert content.labels["last"].tolist() == [3, 5, 9, 11]
    assert content.reference.tolist() == [0, 1, 6, 7]
    scipy.io.savemat(tmp_path / "b.mat", {"volts": VALUES, "reference": VALUES[0] / 2})
    content, said = imported("b.mat")
    np.testing.assert_array_equal(content.values[content.reference], VALUES[:1] / 2)
    assert "Reference: 1 frame of array 'reference'." in said


def test_an_exported_file_without_its_header_keeps_labels(
    tmp_path: Path, imported: Import, skin: Sensor
) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    (tmp_path / "sheet.csv").write_text("frame,x_mm,y_mm,state\n2,10,20,one\n3,10,30,two ü\n")
    first, _ = imported("a.npy", labels=str(tmp_path / "sheet.csv"), reference="first:2")
    export_recording(tmp_path / "0-out.h5", tmp_path / "whole.mat")
    arrays = scipy.io.loadmat(tmp_path / "whole.mat")
    kept = {n: a for n, a in arrays.items() if not n.startswith("__") and n != "header"}
    scipy.io.savemat(tmp_path / "bare.mat", kept)
    again, said = imported("bare.mat")
    np.testing.assert_array_equal(again.values, VALUES)
    assert again.reference.tolist() == [0, 1]
    pd.testing.assert_frame_equal(again.labels, first.labels)
    assert "Touches: 2, all with a place, by the files." in said


def test_a_reference_is_another_array_or_nothing(tmp_path: Path, imported: Import) -> None:
    np.savez(tmp_path / "a.npz", down=VALUES, up=VALUES / 2, reference=[1])
    content, said = imported("a.npz", name="down", reference="array:up")
    np.testing.assert_array_equal(content.values[content.reference], VALUES / 2)
    assert "Not used" not in said
    assert not len(imported("a.npz", name="down", reference="none")[0].reference)
    for wrong in ("first:0", "first:7", "first:x"):
        with pytest.raises(InputError, match="with N from 1 to 6, or none"):
            imported("a.npz", name="down", reference=wrong)
    with pytest.raises(InputError, match="has no array 'middle'; it holds down"):
        imported("a.npz", name="down", reference="array:middle")


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
    (tmp_path / "short.csv").write_text("1,2\n3,4\n")
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


def test_a_sheet_by_file_leaves_out_the_frames_of_the_reference(
    tmp_path: Path, imported: Import
) -> None:
    for k in range(2):
        scipy.io.savemat(tmp_path / f"p{k}.mat", {"frames": VALUES, "reference": [0, 1]})
    (tmp_path / "sheet.csv").write_text("file,x_mm,y_mm\np1,10,20\np0,20,20\n")
    content, _ = imported("p0.mat", "p1.mat", labels=tmp_path / "sheet.csv")
    assert content.labels[["first", "last"]].to_numpy().tolist() == [[8, 11], [2, 5]]


def test_names_of_files_and_states_that_are_numbers_are_kept(
    tmp_path: Path, imported: Import
) -> None:
    for k in (1, 2):
        np.savetxt(tmp_path / f"00{k}.csv", VALUES, delimiter=",")
    rows = "".join(f"00{k},{20240100 + k},10,20\n" for k in (1, 2))
    (tmp_path / "sheet.csv").write_text(f"file,state,x_mm,y_mm\n{rows}")
    content, _ = imported("001.csv", "002.csv", labels=tmp_path / "sheet.csv")
    assert content.labels["state"].tolist() == ["20240101", "20240102"]


def test_a_recording_is_the_reference_of_others(tmp_path: Path, imported: Import) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    imported("a.npy", reference="first:2")
    content, _ = imported("a.npy", reference=str(tmp_path / "0-out.h5"))
    np.testing.assert_array_equal(content.values, [*VALUES[:2], *VALUES])
    assert content.reference.tolist() == [0, 1]
    np.testing.assert_array_equal(unordered_frames(tmp_path / "0-out.h5", [40]), VALUES[:2])
    export_recording(tmp_path / "0-out.h5", tmp_path / "a.mat")
    np.testing.assert_array_equal(unordered_frames(tmp_path / "a.mat", [40]), VALUES[:2])
    imported("a.npy")
    with pytest.raises(InputError, match="marks no frames of the untouched sensor"):
        imported("a.npy", reference=str(tmp_path / "2-out.h5"))


def test_new_labels_keep_the_references_of_touches(tmp_path: Path, imported: Import) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    sheet, more = tmp_path / "sheet.csv", tmp_path / "more.csv"
    sheet.write_text("frame,x_mm,y_mm,reference_first,reference_last\n2,10,20,0,1\n")
    imported("a.npy", labels=sheet)
    more.write_text("frame,x_mm,y_mm,depth_mm\n2,10,20,1\n4,20,20,1\n")
    import_recording(
        [str(tmp_path / "0-out.h5")], tmp_path / "b.h5", None, ImportOptions(labels=str(more))
    )
    labels = read_file(tmp_path / "b.h5")[0].labels
    assert labels[["reference_first", "reference_last"]].to_numpy().tolist() == [[0, 1], [-1, -1]]
    moved = ImportOptions(origin_mm=(5.0, -5.0))
    import_recording([str(tmp_path / "b.h5")], tmp_path / "c.h5", None, moved)
    labels = read_file(tmp_path / "c.h5")[0].labels
    np.testing.assert_allclose(labels[["x_m", "y_m"]], [[0.015, 0.015], [0.025, 0.015]])


def test_a_recording_gets_labels_later(tmp_path: Path, imported: Import) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    imported("a.npy")
    (tmp_path / "sheet.csv").write_text("first,last,x_mm,y_mm\n2,3,10,20\n")
    options = ImportOptions(labels=str(tmp_path / "sheet.csv"), reference="first:2")
    export_recording(tmp_path / "0-out.h5", tmp_path / "a.csv")
    for k, source in enumerate(("0-out.h5", "a.csv")):
        import_recording([str(tmp_path / source)], tmp_path / f"new{k}.h5", None, options)
        content, _ = read_file(tmp_path / f"new{k}.h5")
        assert content.reference.tolist() == [0, 1]
        assert content.labels[["first", "last"]].to_numpy().tolist() == [[2, 3]]
        np.testing.assert_array_equal(content.values, VALUES)


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


def test_places_in_an_array_of_any_name_and_from_another_origin(
    tmp_path: Path, imported: Import
) -> None:
    places = np.arange(18.0).reshape(6, 3)
    np.savez(tmp_path / "robot.npz", v=VALUES, positions=places)
    content, said = imported("robot.npz", labels="array:positions:x_mm,y_mm,depth_mm")
    found = content.labels[["x_m", "y_m", "depth_mm"]].to_numpy()
    np.testing.assert_allclose(found, places / [1e3, 1e3, 1.0])
    assert "Touches: 6, all with a place, by array:positions:x_mm,y_mm,depth_mm." in said
    assert "Not used" not in said
    content, _ = imported(
        "robot.npz", labels="array:positions:x_m,y_m,depth_mm", origin_mm=(20.0, -5.0)
    )
    np.testing.assert_allclose(
        content.labels[["x_m", "y_m"]], places[:, :2] + [0.02, -0.005], rtol=1e-12
    )
    for given, sentence in (
        ("array:positions:x_mm,y_mm", "'positions' of 2 columns .* there has the shape 6 x 3"),
        ("array:places:x_mm,y_mm", "'places' of 2 columns .* there is none"),
        ("array:positions:x,y,z", "with a name for each of its columns, out of x_mm, x_m"),
        ("array:positions", "is given as array:NAME:x_mm,y_mm"),
    ):
        with pytest.raises(InputError, match=sentence):
            imported("robot.npz", labels=given)


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


def test_a_touch_without_a_row_of_labels_is_left_out_and_told(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(12)
    places.loc[3] = np.nan
    places.to_csv(tmp_path / "places.csv", index=False)
    np.savez(tmp_path / "two.npz", down=pressed, up=released)
    np.save(tmp_path / "changes.npy", pressed - released)
    sheet, kept = str(tmp_path / "places.csv"), np.delete(pressed, 3, axis=0)
    for name, options in (
        ("two.npz", ImportOptions(Choice("down"), sheet, released="up")),
        ("changes.npy", ImportOptions(labels=str(sheet), differences=True)),
    ):
        out = tmp_path / f"{name}.h5"
        said = " ".join(import_recording([str(tmp_path / name)], out, SKIN, options))
        assert "Touches: 11, all with a place" in said
        assert "Left out: 1 row without a place or another value." in said
        assert "Left out: 1 touch without a row of labels." in said
        content, _ = read_file(out)
        touched = content.values[content.labels["first"]]
        without = np.delete(released, 3, axis=0) if content.differences else 0.0
        np.testing.assert_allclose(touched, kept - without, atol=1e-12)


@pytest.mark.slow
def test_touches_come_with_released_frames_or_as_differences(tmp_path: Path) -> None:
    """Released and pressed arrays, alternating frames and differences tell the same touches."""
    released, pressed, places = pressed_skin(12, drift=0.5)
    sheet = str(tmp_path / "places.csv")
    places.to_csv(sheet, index=False)
    np.savez(tmp_path / "two.npz", down=pressed, up=released)
    np.save(tmp_path / "turns.npy", np.stack([released, pressed], axis=1).reshape(24, -1))
    np.save(tmp_path / "changes.npy", pressed - released)
    down = Choice("down")
    for name, choice, said in (
        ("two.npz", ImportOptions(down, sheet, released="up"), "released frame before it"),
        ("turns.npy", ImportOptions(labels=sheet, released="alternating"), "before it"),
        ("changes.npy", ImportOptions(labels=str(sheet), differences=True), "differences"),
    ):
        path = tmp_path / f"{name}.h5"
        found = " ".join(import_recording([str(tmp_path / name)], path, SKIN, choice))
        assert said in found
        assert "Touches: 12, all with a place" in found
        recording = read_recording(str(path))
        changes = recording.voltages - recording.reference
        scale = np.linalg.norm(changes) / np.linalg.norm(pressed - released)
        np.testing.assert_allclose(changes, scale * (pressed - released), atol=1e-9)
        np.testing.assert_array_equal(recording.samples[["x_m", "y_m"]], places)


def test_differences_have_neither_magnitudes_nor_a_reference(tmp_path: Path) -> None:
    released, pressed, _ = pressed_skin(12, drift=0.5)
    source, out = str(tmp_path / "changes.npy"), tmp_path / "a.h5"
    np.save(source, (1 + 1j) * (pressed - released))
    options = ImportOptions(Choice(part="magnitude"), differences=True)
    with pytest.raises(InputError, match="is not the difference of magnitudes"):
        import_recording([source], out, SKIN, options)
    import_recording([source], out, SKIN, ImportOptions(Choice(part="real"), differences=True))
    with pytest.raises(InputError, match="holds differences only, so that no frame"):
        import_recording([str(out)], tmp_path / "b.h5", None, ImportOptions(reference="first:3"))
    with pytest.raises(InputError, match="holds differences only, so that no frame"):
        unordered_frames(out, [SKIN.n_measurements])


def test_bad_files_of_differences_are_one_sentence(tmp_path: Path) -> None:
    """Of a robot's files, `inp.csv` with differences and `out.csv` with places, as skins have."""
    released, pressed, places = pressed_skin(6)
    changes, sheet = pressed - released, tmp_path / "places.csv"
    places.to_csv(sheet, index=False, encoding="utf-8-sig")
    source, options = tmp_path / "inp.csv", ImportOptions(labels=str(sheet), differences=True)

    def lines(values: Any) -> list[str]:
        return [",".join(map(repr, row)) for row in values.tolist()]

    whole, empty = lines(changes), ",".join(["NaN"] * changes.shape[1])
    for text, says in (
        (lines(changes[:, 1:]), r"208 values each: it holds values \(6 x 207\)"),
        ([*whole[:3], whole[3].rpartition(",")[0], *whole[4:]], "line 4 has 207 values, and those"),
        (
            [*whole[:3], empty, *whole[4:]],
            r"frame 3 \(counted from 0\) holds nan as value 0, which is no number\. Leave",
        ),
        (whole[:4], "6 rows of labels for 4 frames"),
    ):
        source.write_text("\n".join(text), encoding="utf-8-sig")
        with pytest.raises(EitbenchError, match=says):
            import_recording([str(source)], tmp_path / "no.h5", SKIN, options)
        assert not (tmp_path / "no.h5").exists()
    for mark in ("utf-8", "utf-8-sig"):  # with a byte-order mark and without, they are read
        source.write_text("\n".join(whole), encoding=mark)
        import_recording([str(source)], tmp_path / f"{mark}.h5", SKIN, options)
        assert np.array_equal(read_file(tmp_path / f"{mark}.h5")[0].values, changes)
    (1e3 * places).to_csv(sheet, index=False)
    said = " ".join(import_recording([str(source)], tmp_path / "mm.h5", SKIN, options))
    assert "Places outside the sensor: 6" in said
    assert "Read as millimetres they are inside: name the columns x_mm and y_mm." in said
    problems, _ = check(tmp_path / "mm.h5")
    assert [p for p in problems if "6 labels outside the sensor" in p]


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
