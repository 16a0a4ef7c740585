"""Readers of recordings refuse what is not the upstream format; no real data needed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings import RECORDED_SETS, recorded_set
from eitbench.scenarios.recordings.descriptors import RecordedFrames, validation_every_fifth
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.recordings.public.jku_tank import DRIVES, read_txt
from eitbench.scenarios.recordings.public.kuopio import injections, resampled
from eitbench.scenarios.recordings.public.pyeidors_tank import read_csv, targets
from eitbench.scenarios.recordings.public.sciospec_tank import read_eit
from eitbench.scenarios.recordings.quality import quality, reciprocity_error
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern


def eit_text() -> str:
    header = ["18", "2", "setup", "now", "1e4", "1e4", "1", "1", "0.005", *["1"] * 9]
    lines = list(header)
    for i in range(16):
        lines += [f"{i + 1} {(i + 3) % 16 + 1}", "\t".join(["0.25", "-0.5"] * 32)]
    return "\n".join(lines) + "\n"


def jku_text() -> str:
    values = np.tile(np.array([0.25, -0.5], ">f4"), 16).tobytes()
    lines = [
        (bytes([1, src + 1, sink + 1, 0, 0, 0, 0, 0, 0]) + values).hex(" ").upper()
        for src, sink in DRIVES["opposite"]
    ]
    return "\n".join(["Current: 0.010000, Start Frequency: 1000.0", *lines]) + "\n"


def csv_text() -> str:
    return "\n".join(["1.5,2.5,3.5,4.5"] * 208) + "\n"


READERS: dict[str, tuple[Callable[[], str], Callable[[Path], Any], NDArray[Any]]] = {
    "a.eit": (eit_text, read_eit, np.full((16, 16), (0.25 - 0.5j) / 0.005)),
    "b.txt": (
        jku_text,
        lambda path: read_txt(path, DRIVES["opposite"]),
        np.full((10, 16), (0.25 - 0.5j) / 0.01),
    ),
    "c_50uA_1.csv": (csv_text, read_csv, np.full((2, 208), [[1.5 / 50e-6], [3.5 / 50e-6]])),
}


@pytest.mark.parametrize("name", READERS)
def test_files_are_read_per_ampere(name: str, tmp_path: Path) -> None:
    text, reader, expected = READERS[name]
    (tmp_path / name).write_text(text())
    np.testing.assert_allclose(reader(tmp_path / name), expected)


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.97])
def test_truncated_text_is_refused_by_name(name: str, share: float, tmp_path: Path) -> None:
    text, reader, _ = READERS[name]
    whole = text()
    path = tmp_path / name
    path.write_text(whole[: int(share * len(whole))])
    with pytest.raises(DataCorruptError, match=name):
        reader(path)


@pytest.mark.parametrize("name", READERS)
def test_bytes_that_are_no_text_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"\xff\xfe\x00\x80" * 100)
    with pytest.raises(DataCorruptError, match=name):
        READERS[name][1](path)


def test_another_drive_pattern_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.eit"
    path.write_text(eit_text().replace("\n1 4\n", "\n1 5\n"))
    with pytest.raises(DataCorruptError, match="pattern"):
        read_eit(path)
    path.write_text(jku_text())
    with pytest.raises(DataCorruptError, match="pattern"):
        read_txt(path, DRIVES["adjacent"])


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.95])
def test_truncated_mat_is_refused_by_name(share: float, tmp_path: Path) -> None:
    path = tmp_path / "data.mat"
    rng = np.random.default_rng(0)
    savemat(path, {"response": rng.normal(size=(60, 50))}, do_compression=True)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DataCorruptError, match=r"data\.mat"):
        read_arrays(path, response=(60, 50))


@pytest.mark.parametrize("content", [np.zeros((3, 2)), np.array(["text"]), np.array([[1j]])])
def test_unexpected_arrays_are_refused(content: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "data.mat"
    savemat(path, {"response": content})
    with pytest.raises(DataCorruptError, match="response"):
        read_arrays(path, response=(2, 3))
    with pytest.raises(DataCorruptError, match="positions"):
        read_arrays(path, positions=(2, 3))


def write_ohmc8(folder: Path, *, fill: float = 1.0, swap: bool = False) -> None:
    """Files of the form of `ohmc8`; `swap` exchanges two rows of the pattern table."""
    lookup = RECORDED_SETS["ohmc8"].sensor().pattern.table * 4
    if swap:
        lookup = lookup[[1, 0, *range(2, 32)]]
    (folder / "Extracted").mkdir(parents=True)
    savemat(folder / "lookup32.mat", {"lookup": lookup.astype(np.uint8)})
    up = np.tile(np.arange(500.0)[:, None], 32)
    down = up + fill
    positions = np.tile([0.01, -0.02, 0.015], (500, 1))
    content = {"positions": positions, "responsedowns": down, "responseups": up}
    savemat(folder / "Extracted/ohmc8.mat", content)


def test_presses_are_rebased_on_the_validation_median(tmp_path: Path) -> None:
    write_ohmc8(tmp_path)
    recording = RECORDED_SETS["ohmc8"].read(tmp_path)
    np.testing.assert_allclose(recording.reference, np.median(np.arange(0, 500, 5)))
    np.testing.assert_allclose(recording.voltages - recording.reference, 1)
    assert recording.samples[["x_m", "y_m", "depth_mm"]].iloc[0].tolist() == [0.01, -0.02, 15.0]


def test_a_table_other_than_the_sensors_pattern_is_refused(tmp_path: Path) -> None:
    write_ohmc8(tmp_path, swap=True)
    with pytest.raises(DataCorruptError, match=r"lookup32\.mat"):
        RECORDED_SETS["ohmc8"].read(tmp_path)


def test_frames_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    write_ohmc8(tmp_path, fill=float("nan"))
    with pytest.raises(DataCorruptError, match="finite"):
        RECORDED_SETS["ohmc8"].read(tmp_path)


def test_unknown_set_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'ohmc16'"):
        recorded_set("omhc16")


@pytest.mark.parametrize("name", RECORDED_SETS)
def test_descriptors_are_complete_without_data(name: str) -> None:
    recorded = RECORDED_SETS[name]
    assert recorded.sensor().name == recorded.sensor_name
    assert len(recorded.source.commit) == 40
    assert recorded.source.licence
    assert recorded.citation
    assert all(len(file.sha256) == 64 and file.bytes > 0 for file in recorded.files)


def test_split_rule() -> None:
    assert validation_every_fifth(7) == ["validation", *["test"] * 4, "validation", "test"]


def test_kuopio_injections() -> None:
    pairs = injections()
    assert len(pairs) == 76
    assert pairs[15:17] == [(30, 0), (2, 0)]


def test_truth_images_are_turned_to_our_rows() -> None:
    image = np.zeros((256, 256))
    image[:128, :64] = 1  # upper left as displayed
    sensor = RECORDED_SETS["ktc2023"].sensor()
    rows, columns = np.nonzero(resampled(image, sensor))
    assert rows.min() == 40
    assert columns.max() == 19


def test_targets_from_the_folder_name() -> None:
    path = "data/electrode01_metal_electrode05_plastic/2026.csv"
    assert targets(path) == "1 metal, 5 plastic"


def test_reciprocity_error_knows_the_sign() -> None:
    pattern = DrivePattern(np.array([[0, 1, 2, 3], [2, 3, 1, 0]]))
    assert reciprocity_error([1.0, -1.0], pattern) == pytest.approx(0)
    assert reciprocity_error([1.0, 1.0], pattern) == pytest.approx(2)
    np.testing.assert_allclose(reciprocity_error([[2.0, -1.0], [2.0, -2.0]], pattern), [0.5, 0])


def test_reciprocity_error_refuses_what_it_cannot_judge() -> None:
    with pytest.raises(InputError, match="208"):
        reciprocity_error(np.zeros(7), offset_pattern(16, 3))
    with pytest.raises(InputError, match="twice"):
        reciprocity_error([1.0], DrivePattern(np.array([[0, 1, 2, 3]])))


def test_quality_measures_noise_and_signal() -> None:
    rng = np.random.default_rng(1)
    pattern = offset_pattern(16, 3)
    reference = np.full(208, 10.0)
    state = np.repeat([0, 1], 400)
    voltages = reference + state[:, None] * 2.0 + rng.normal(0, 0.1, (800, 208))
    samples = pd.DataFrame({"touched": state == 1, "state": state})
    figures = quality(RecordedFrames(voltages, reference, samples), pattern)
    assert figures.noise == pytest.approx(0.01, rel=0.02)
    assert figures.spread == pytest.approx(0.01, rel=0.02)
    assert figures.signal == pytest.approx(0.2, rel=0.02)
