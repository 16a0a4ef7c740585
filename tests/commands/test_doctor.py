"""The doctor of wiring as a command: page, sensor file, and sentences where it cannot tell."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor_file import read_sensor

Run = Callable[..., tuple[int, str, str]]
SENSOR = """
name = "bench"
image_shape = [20, 24]
[outline]
rectangle_mm = [80, 60]
[electrodes]
centres_mm = [5, 42, 75, 101, 134, 170, 212, 240]
width_mm = 5
[pattern]
offset = 3
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    (tmp_path / "bench.toml").write_text(SENSOR)
    return tmp_path / "bench.toml"


def test_a_reversed_board_is_put_right(tmp_path: Path, bench: Path, eitbench: Run) -> None:
    sensor = read_sensor(bench)
    model = forward_model(sensor)
    frames = -model.voltages(model.background) * np.linspace(1, 1.001, 5)[:, None]
    np.savetxt(tmp_path / "untouched.csv", frames, delimiter=",")
    out = tmp_path / "wiring"
    code, said, _ = eitbench(
        "recordings", "doctor", tmp_path / "untouched.csv", "--sensor", bench, "--out", out
    )
    assert code == 0
    assert said.startswith("Sure: misfit 0.0%")
    assert "The sign of every value is reversed" in said
    right = forward_model(read_sensor(out / "sensor.toml"))
    np.testing.assert_allclose(
        frames[0], right.voltages(right.background), rtol=1e-5, atol=1e-9 * np.abs(frames).max()
    )
    page = (out / "doctor.html").read_text()
    assert "data:image/png;base64" in page
    assert "The sign of every value is reversed" in page


def test_noise_is_refused_without_a_sensor_file(tmp_path: Path, bench: Path, eitbench: Run) -> None:
    count = read_sensor(bench).n_measurements
    frames = np.random.default_rng(0).normal(size=(4, count))
    np.savetxt(tmp_path / "noise.csv", frames, delimiter=",")
    out = tmp_path / "wiring"
    code, said, error = eitbench(
        "recordings", "doctor", tmp_path / "noise.csv", "--sensor", bench, "--out", out
    )
    assert code == 1
    assert "No wiring explains the frames" in said
    assert "No sensor file was written" in error
    assert [path.name for path in out.iterdir()] == ["doctor.html"]


@pytest.mark.parametrize(
    ("source", "options", "sentence"),
    [
        ("short.csv", ("--sensor", "bench.toml"), "holds no table of"),
        ("short.csv", (), "--sensor is missing"),
        ("cam09-05", (), "only differences were measured"),
    ],
)
def test_bad_input_is_one_sentence(
    source: str, options: tuple[str, ...], sentence: str, tmp_path: Path, bench: Path,
    eitbench: Run, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    if source == "cam09-05":
        request.getfixturevalue("recorded_data")
    monkeypatch.chdir(tmp_path)
    np.savetxt("short.csv", np.ones((3, 5)), delimiter=",")
    code, _, error = eitbench("recordings", "doctor", source, *options)
    assert code != 0
    assert sentence in error
    assert not Path("wiring").exists()


def test_a_folder_that_holds_something_is_left_as_it_is(
    tmp_path: Path, bench: Path, eitbench: Run
) -> None:
    model = forward_model(read_sensor(bench))
    np.savetxt(tmp_path / "untouched.csv", model.voltages(model.background)[None], delimiter=",")
    out = tmp_path / "mine"
    out.mkdir()
    (out / "sensor.toml").write_text("kept")
    for command in (
        ("recordings", "doctor", tmp_path / "untouched.csv", "--sensor", bench),
        ("design", bench, "--snr", "60"),
        ("latency", bench, "--snr", "60"),
    ):
        code, _, error = eitbench(*command, "--out", out)
        assert code == 2
        assert "is not an empty folder: choose another with --out" in error
    assert [path.name for path in out.iterdir()] == ["sensor.toml"]
    assert (out / "sensor.toml").read_text() == "kept"
