"""Labels and places in files of other programs go with their frames: none is lost in silence."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
from tests.support.frame_files import NAMES, VALUES, Import
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.hardware.recording.exchange import export_recording, import_recording
from eitbench.hardware.recording.importing.arrays import Choice
from eitbench.hardware.recording.importing.labels import moved, parsed
from eitbench.hardware.recording.importing.recording import ImportOptions
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.sensor import Sensor


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
    # The first press is no frame of the untouched sensor.
    with pytest.raises(InputError, match="Touch 3 is on the frames 0 to 1, and the reference has"):
        imported("presses/press*.csv", labels=folder / "places.csv", reference="first:2")
    places[:2].to_csv(folder / "places.csv", index=False)
    again, _ = imported("presses/press*.csv", labels=folder / "places.csv", reference="first:2")
    assert again.reference.tolist() == [0, 1]
    assert again.labels["first"].tolist() == [20, 2]


@pytest.mark.parametrize(("given", "other"), [("first", "last"), ("last", "first")])
def test_a_column_of_first_frames_alone_says_nothing(
    given: str, other: str, tmp_path: Path, imported: Import
) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES[:3], delimiter=",")
    (tmp_path / "sheet.csv").write_text(f"{given},x_mm,y_mm\n2,10,10\n1,20,20\n0,30,30\n")
    with pytest.raises(InputError, match=f"has a column '{given}' and none '{other}': give both"):
        imported("a.csv", labels=tmp_path / "sheet.csv")


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


def test_a_touch_on_frames_of_the_untouched_sensor_is_refused(
    tmp_path: Path, imported: Import
) -> None:
    np.savetxt(tmp_path / "a.csv", VALUES, delimiter=",")
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("frame,x_mm,y_mm\n4,1,2\n2,3,4\n")
    with pytest.raises(InputError, match=r"Touch 2 is on the frames 2 to 2, and the reference"):
        imported("a.csv", labels=str(sheet), reference="first:3")
    sheet.write_text("first,last,x_mm,y_mm\n2,4,1,2\n")
    with pytest.raises(InputError, match=r"Touch 1 is on the frames 2 to 4, and the reference"):
        imported("a.csv", labels=str(sheet), reference="first:3")
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


def test_names_of_files_and_states_that_are_numbers_are_kept(
    tmp_path: Path, imported: Import
) -> None:
    for k in (1, 2):
        np.savetxt(tmp_path / f"00{k}.csv", VALUES, delimiter=",")
    rows = "".join(f"00{k},{20240100 + k},10,20\n" for k in (1, 2))
    (tmp_path / "sheet.csv").write_text(f"file,state,x_mm,y_mm\n{rows}")
    content, _ = imported("001.csv", "002.csv", labels=tmp_path / "sheet.csv")
    assert content.labels["state"].tolist() == ["20240101", "20240102"]


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


def test_a_recording_gets_no_reference_that_its_touches_are_on(
    tmp_path: Path, imported: Import
) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    (tmp_path / "sheet.csv").write_text("first,last,x_mm,y_mm\n3,4,10,20\n")
    imported("a.npy", labels=str(tmp_path / "sheet.csv"), reference="first:2")
    with pytest.raises(InputError, match=r"Touch 1 is on the frames 3 to 4, and the refer"):
        import_recording(
            [str(tmp_path / "0-out.h5")],
            tmp_path / "b.h5",
            None,
            ImportOptions(reference="first:4"),
        )
    assert not (tmp_path / "b.h5").exists()


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
