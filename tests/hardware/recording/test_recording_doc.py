"""docs/recording.md: its sensor, its suite and its layout are what it says."""

import re
from pathlib import Path

import h5py
import numpy as np

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import load_suite, sensor
from eitbench.scenarios.sensors.sensor import Sensor

TEXT = (Path(__file__).resolve().parents[3] / "docs/recording.md").read_text()
LAYOUT = TEXT.split("## What is written")[1].split("\n## ")[0]
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", TEXT, flags=re.DOTALL)
SENSOR, SUITE = (code for language, code in BLOCKS if language == "toml")


def recorded(path: Path, skin: Sensor) -> Path:
    with Recorder(path, skin, "fake") as recorder:
        for k in range(6):
            recorder.append(Frame(k, k, k, np.full(40, 1.0)))
        recorder.mark_reference(0, 0)
        recorder.label(1, 2, x_m=0.01, y_m=0.01)
    return path


def test_its_sensor_can_be_read_with_every_alternative(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(SENSOR)
    assert (sensor(str(path)).n_measurements, sensor(str(path)).image_shape) == (208, (48, 60))
    for line in re.findall(r"^# (\w+ = \S.*?)(?:  #.*)?$", SENSOR, flags=re.MULTILINE):
        assert line.split()[0] in (
            "disc_radius_mm", "polygon_mm", "centres_mm", "drive", "sense", "table",
        )  # fmt: skip
    path.write_text(
        SENSOR.replace("rectangle_mm", "# rectangle_mm").replace("# disc_radius", "disc_radius")
    )
    assert sensor(str(path)).outline.describe() == {"disc": 0.05}


def test_its_suite_can_be_read(tmp_path: Path, skin: Sensor) -> None:
    (tmp_path / "mine.toml").write_text(SUITE)
    recorded(tmp_path / "touch.h5", skin)
    assert [s.name for s in load_suite(tmp_path / "mine.toml").scenarios] == ["touch", "ohmc16"]


def test_its_layout_is_what_is_written(tmp_path: Path, skin: Sensor) -> None:
    rows = re.findall(r"^\| ((?:`[\w/]+`(?:, )?)+) \| ([^|]*) \|", LAYOUT, flags=re.MULTILINE)
    documented = {name for names, _ in rows for name in re.findall(r"`([\w/]+)`", names)}
    found = set[str]()
    with h5py.File(recorded(tmp_path / "a.h5", skin)) as file:
        file.visititems(
            lambda name, part: found.add(name) if isinstance(part, h5py.Dataset) else None
        )
        for name in found:
            assert "units" in file[name].attrs or name in ("complete", "sha256")
        attributes = set(file.attrs)
    assert documented == found
    assert attributes == {
        name
        for line in LAYOUT.splitlines()
        if line.startswith("| attribute")
        for name in re.findall(r"`(\w+)`", line.split("|")[1])
    }
