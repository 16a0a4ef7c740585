"""References in files, released frames and differences: what a touch is compared with."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from tests.support.frame_files import VALUES, Import
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.hardware.recording.exchange import (
    export_recording,
    import_recording,
    write_recording,
)
from eitbench.hardware.recording.importing.arrays import Choice
from eitbench.hardware.recording.importing.labels import FramesOf, as_labels, parsed, placed
from eitbench.hardware.recording.importing.recording import ImportOptions
from eitbench.hardware.recording.importing.unordered import unordered_frames
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.recordings.fetch import read_recording, reference_frames
from eitbench.scenarios.recordings.files.pairs import from_pairs
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.suites.scenario import RecordedScenario


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


def test_a_sheet_by_file_leaves_out_the_frames_of_the_reference(
    tmp_path: Path, imported: Import
) -> None:
    for k in range(2):
        scipy.io.savemat(tmp_path / f"p{k}.mat", {"frames": VALUES, "reference": [0, 1]})
    (tmp_path / "sheet.csv").write_text("file,x_mm,y_mm\np1,10,20\np0,20,20\n")
    content, _ = imported("p0.mat", "p1.mat", labels=tmp_path / "sheet.csv")
    assert content.labels[["first", "last"]].to_numpy().tolist() == [[8, 11], [2, 5]]


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


def test_references_of_touches_are_untouched_frames(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(4)
    path = tmp_path / "skin.h5"
    write_recording(from_pairs(released, pressed, SKIN, "bench", places), path)
    np.testing.assert_array_equal(unordered_frames(path, [208]), released)
    np.testing.assert_array_equal(reference_frames(str(path))[1], released)
    np.save(tmp_path / "a.npy", pressed)
    np.save(tmp_path / "complex.npy", 1j * pressed)
    turned = replace(SKIN, pattern=DrivePattern(SKIN.pattern.table[::-1], magnitudes=False))
    for name, choice, found in (
        ("a.npy", Choice(), [*released, *pressed]),
        ("complex.npy", Choice(part="magnitude"), np.abs([*released, *pressed])),
    ):
        options = ImportOptions(choice, reference=str(path))
        out = tmp_path / f"{name}.h5"
        import_recording([str(tmp_path / name)], out, SKIN, options)
        np.testing.assert_allclose(read_file(out)[0].values, found)
    with pytest.raises(InputError, match="of another drive pattern than those of sensor 'bench'"):
        import_recording(
            [str(tmp_path / "a.npy")], tmp_path / "b.h5", turned, ImportOptions(reference=str(path))
        )


def test_a_row_of_a_sheet_without_a_place_is_no_touch(tmp_path: Path, imported: Import) -> None:
    """Whether its frame is counted or named."""
    np.save(tmp_path / "a.npy", VALUES)
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("frame,x_mm,y_mm\n0,,\n2,10,20\n3,,\n4,20,20\n")
    content, said = imported("a.npy", labels=sheet)
    assert content.labels["first"].tolist() == [2, 4]
    assert "2 rows without a place or another value" in said


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
    # The reference of differences is modelled: it says nothing of the sensor.
    scenario = RecordedScenario(name="mine", recording=str(path), calibrated=True)
    with pytest.raises(InputError, match="which is to be calibrated, holds differences only"):
        load(scenario, "test")


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
    said = " ".join(
        import_recording(
            [str(source)], tmp_path / "far.h5", SKIN, replace(options, origin_mm=(1e3, 0.0))
        )
    )
    assert "Their origin is that of --origin, in mm: look whether it is right." in said
    assert "millimetres" not in said
    problems, _ = check(tmp_path / "mm.h5")
    assert [p for p in problems if "6 labels outside the sensor" in p]
