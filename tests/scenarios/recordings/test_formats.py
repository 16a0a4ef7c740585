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
        read_txt,
        np.full((10, 16), (0.25 - 0.5j) / 0.01),
    ),
    "c_50uA_1.csv": (csv_text, read_csv, np.full((2, 208), [[1.5 / 50e-6], [3.5 / 50e-6]])),
}


@pytest.mark.parametrize("name", READERS)
def test_files_are_read_per_ampere(name: str, tmp_path: Path) -> None:
    text, reader, expected = READERS[name]
    (tmp_path / name).write_text(text())
    np.testing.assert_allclose(reader(tmp_path / name), expected)


def write_ohmc8(folder: Path, *, fill: float = 1.0) -> None:
    """A file of the form of `ohmc8`."""
    (folder / "Extracted").mkdir(parents=True)
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
    assert recorded.files
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
    with pytest.raises(InputError, match="no reciprocal pairs"):
        reciprocity_error([1.0], DrivePattern(np.array([[0, 1, 2, 3]])))


def test_quality_measures_noise() -> None:
    rng = np.random.default_rng(1)
    reference = np.full(208, 10.0)
    state = np.repeat([0, 1], 400)
    voltages = reference + state[:, None] * 2.0 + rng.normal(0, 0.1, (800, 208))
    samples = pd.DataFrame({"touched": state == 1, "state": state})
    _, noise = quality(RecordedFrames(voltages, reference, samples), offset_pattern(16, 3))
    assert noise == pytest.approx(0.01, rel=0.02)
