"""Sensor files and their mistakes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.metrics.image_metrics import psnr
from eitbench.scenarios import InputError, sensor
from eitbench.scenarios.catalogue import sensors
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.sensors.outlines import Disc, Polygon
from eitbench.scenarios.sensors.sensor_file import (
    read_sensor,
    sensor_from_json,
    sensor_to_json,
    sensor_to_toml,
)
from eitbench.scenarios.suites.suite import load_suite

GOOD = """
name = "bench"
image_shape = [40, 50]
conductivity_range = [0.1, 1.0]

[outline]
rectangle_mm = [100, 80]

[electrodes]
count = 16
width_mm = 8
start_mm = 10

[pattern]
offset = 3
"""

OPPOSITION = "drive = 8\nsense = -1\nmagnitudes = true"


def write(folder: Path, text: str = GOOD) -> Path:
    path = folder / "bench.toml"
    path.write_text(text)
    return path


def test_a_sensor_file_is_a_sensor(tmp_path: Path) -> None:
    made = sensor(str(write(tmp_path)))
    assert (made.name, made.n_electrodes, made.n_measurements) == ("bench", 16, 208)
    assert made.image_shape == (40, 50)
    assert made.outline.bounds == pytest.approx((0, 0, 0.1, 0.08))
    assert made.electrodes[0].centre == pytest.approx(0.01)
    assert made.electrodes[1].centre == pytest.approx(0.01 + 0.36 / 16)
    assert made.electrodes[0].width == pytest.approx(0.008)
    assert sensor(str(write(tmp_path)), offset=1).pattern.table[0].tolist() == [0, 1, 2, 3]


def test_a_sensor_file_is_read_again_when_it_has_changed(tmp_path: Path) -> None:
    path = str(write(tmp_path))
    first = sensor(path)
    assert sensor(path) is first
    write(tmp_path, GOOD.replace("width_mm = 8", "width_mm = 8.5"))
    assert sensor(path).electrodes[0].width == pytest.approx(0.0085)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rectangle_mm = [100, 80]", "disc_radius_mm = 60"),
        ("rectangle_mm = [100, 80]", "polygon_mm = [[0, 0], [100, 0], [50, 120]]"),
        ("offset = 3", "offset = 1\ndriven = true\nmagnitudes = true"),
        ("offset = 3", "drive = 8\nsense = -1\nmagnitudes = true"),
        ("offset = 3", "drive = -5\nsense = 2\ndriven = true"),
        ("offset = 3", "table = [[0, 1, 2, 3], [1, 2, 3, 4]]"),
        ("start_mm = 10", "start_mm = 10\nclockwise = true\ncontact_impedance = 2e-3"),
        (
            "count = 16\nwidth_mm = 8\nstart_mm = 10",
            "centres_mm = [9, 99, 199]\nwidth_mm = [5, 6, 7]",
        ),
    ],
)
def test_every_kind_of_sensor_can_be_declared_and_described(
    tmp_path: Path, old: str, new: str
) -> None:
    text = GOOD.replace(old, new)
    if "centres_mm" in new:
        text = text.replace("offset = 3", "table = [[0, 1, 1, 2]]")
    made = sensor(str(write(tmp_path, text)))
    again = sensor_from_json(sensor_to_json(made))
    assert (again, again.name) == (made, made.name)


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path: Path) -> None:
    made = sensor(str(write(tmp_path)))
    (tmp_path / "bench.toml").write_text(GOOD, encoding="utf-8-sig")
    assert sensor(str(tmp_path / "bench.toml")) == made


def test_what_is_declared_is_what_is_made(tmp_path: Path) -> None:
    text = GOOD.replace("rectangle_mm = [100, 80]", "disc_radius_mm = 60")
    text = text.replace("start_mm = 10", "clockwise = true")
    made = sensor(str(write(tmp_path, text)))
    assert made.outline == Disc(0.06)
    x, y = made.outline.point(made.electrodes[4].centre)
    assert (x, y) == pytest.approx((0, -0.06), abs=1e-9)
    text = GOOD.replace("rectangle_mm = [100, 80]", "polygon_mm = [[0, 0], [90, 0], [0, 90]]")
    made = sensor(str(write(tmp_path, text.replace("offset = 3", OPPOSITION))))
    assert made.outline == Polygon(((0, 0), (0.09, 0), (0, 0.09)))
    assert made.pattern.magnitudes
    assert made.pattern.table[0].tolist() == [0, 8, 2, 1]


def test_every_packaged_sensor_is_read_as_it_is_written(tmp_path: Path) -> None:
    """Weights are found by all that a sensor is, to the last bit."""
    for name, made in sensors().items():
        assert read_sensor(write(tmp_path, sensor_to_toml(made()))) == made(), name


def test_numbers_of_numpy_are_written_as_numbers(tmp_path: Path) -> None:
    made = sensor("foam16")
    rim = np.linspace(0.1, 0.2, 16)
    given = replace(
        made,
        background=np.float64(0.5),
        data_range=np.float64(0.5),
        image_shape=(16, 16),
        electrodes=tuple(
            replace(of, contact_impedance=z) for of, z in zip(made.electrodes, rim, strict=True)
        ),
    )
    assert read_sensor(write(tmp_path, sensor_to_toml(given))) == given


def test_pixels_too_coarse_for_the_outline_are_named(tmp_path: Path) -> None:
    """A frame of 100 mm that is 4 mm thick: no middle of a pixel of 25 mm lies in it."""
    rim = "[[0, 0], [100, 0], [100, 4], [4, 4], [4, 96], [100, 96], [100, 100], [0, 100]]"
    text = GOOD.replace("rectangle_mm = [100, 80]", f"polygon_mm = {rim}")
    path = write(tmp_path, text.replace("image_shape = [40, 50]", "image_shape = [4, 4]"))
    with pytest.raises(InputError, match=r"field 'image_shape': No pixel .* finer image_shape"):
        read_sensor(path)


def test_signed_opposite_drive_and_adjacent_sensing_are_two_lines(tmp_path: Path) -> None:
    rows = [
        [i, (i + 16) % 32, j, (j + 1) % 32]
        for i in range(32)
        for j in range(32)
        if not {i, (i + 16) % 32} & {j, (j + 1) % 32}
    ]
    text = GOOD.replace("count = 16", "count = 32")
    two_lines = sensor(str(write(tmp_path, text.replace("offset = 3", "drive = 16\nsense = 1"))))
    table = sensor(str(write(tmp_path, text.replace("offset = 3", f"table = {rows}"))))
    assert (len(rows), two_lines.pattern.magnitudes) == (896, False)
    assert two_lines == table


def test_eidors_order_is_rotating(tmp_path: Path) -> None:
    text = GOOD.replace("offset = 3", "drive = 1\nsense = -1\nrotating = true")
    made = sensor(str(write(tmp_path, text))).pattern
    assert made.table.tolist() == [
        [i, (i + 1) % 16, (i + m + 1) % 16, (i + m) % 16] for i in range(16) for m in range(2, 15)
    ]
    assert np.array_equal(made.table, sensor("pyeidors-tank").pattern.table)


@pytest.mark.parametrize(
    ("old", "new", "field", "says"),
    [
        ('name = "bench"', 'name = "../x"', "name", "small letters"),
        ('name = "bench"', "", "name", "it is missing"),
        ("image_shape = [40, 50]", "image_shape = [40, 5000]", "image_shape[1]", "1024"),
        ("width_mm = 8", "width_mm = -8", "electrodes.width_mm", "greater than 0"),
        ("start_mm", "strat_mm", "electrodes.strat_mm", "the nearest is 'start_mm'"),
        ("width_mm = 8", "width_mm = 30", "electrodes", "overlap"),
        (
            "count = 16\nwidth_mm = 8\nstart_mm = 10",
            "centres_mm = [10, 60, 110, 160, 1100]\nwidth_mm = 8",
            "electrodes",
            "along the rim, which has 360.0 mm; got 1100",
        ),
        ("width_mm = 8", "width_mm = [8, 8]", "electrodes", "has 2 values for 16 electrodes"),
        ("count = 16", "", "electrodes", "either `count` or `centres_mm`"),
        ("offset = 3", "offset = 16", "pattern", "from 1 to 15, or its negative"),
        ("offset = 3", "", "pattern", "one of `offset`"),
        ("offset = 3", "drive = 3", "pattern", "`drive` with `sense`"),
        ("offset = 3", "sense = 3", "pattern", "`drive` with `sense`"),
        ("offset = 3", "offset = 3\ndrive = 8\nsense = 1", "pattern", "one of `offset`"),
        ("offset = 3", "drive = 8\nsense = -16", "pattern", "from 1 to 15, or its negative"),
        ("offset = 3", "drive = 0\nsense = 1", "pattern", "from 1 to 15, or its negative"),
        ("offset = 3", "table = [[0, 1, 2, 3]]\ndriven = true", "pattern", "`driven` and"),
        ("offset = 3", "table = [[0, 1, 2, 16]]", "pattern", "uses electrode 16"),
        ("offset = 3", "table = [[0, 1, 2]]", "pattern.table[0][3]", "missing"),
        ("[100, 80]", "[100, 0]", "outline.rectangle_mm[1]", "greater than 0"),
        ("rectangle_mm = [100, 80]", "polygon_mm = [[0, 0], [1, 1]]", "outline", "3 vertices"),
        ("[100, 80]", "[100, 80]\ndisc_radius_mm = 3", "outline", "one of `rectangle_mm`"),
    ],
)
def test_mistakes_are_named_with_the_field(
    tmp_path: Path, old: str, new: str, field: str, says: str
) -> None:
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        sensor(str(path))
    assert str(caught.value).startswith(f"Sensor file {path}, field '{field}'")
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "name", ["foam16", *sorted({s.sensor_name for s in RECORDED_SETS.values()})]
)
def test_every_known_sensor_survives_its_description(name: str) -> None:
    made = sensor(name)
    assert sensor_from_json(sensor_to_json(made)) == made


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"name": 3}', "nonsense", '{"name": "a"}'])
def test_wrong_descriptions_are_one_sentence(text: str) -> None:
    with pytest.raises(InputError, match="described wrongly"):
        sensor_from_json(text)


def test_a_suite_simulates_a_sensor_of_ones_own(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "suite.toml").write_text(
        'name = "s"\ntitle = "s"\nmethods = ["noser"]\n[[scenarios]]\nkind = "simulated"\n'
        'name = "mine"\nsensor = "bench.toml"\nfamilies = ["soft-press"]\n'
        "train = 0\nvalidation = 0\ntest = 2\n"
    )
    (scenario,) = load_suite(tmp_path / "suite.toml").scenarios
    assert scenario.nominal_sensor == sensor(str(tmp_path / "bench.toml"))
    before = scenario.data_hash("test")
    # What counts is what the file declares, not where it lies.
    moved = tmp_path / "moved"
    moved.mkdir()
    for name in ("bench.toml", "suite.toml"):
        (moved / name).write_bytes((tmp_path / name).read_bytes())
    assert load_suite(moved / "suite.toml").scenarios[0].data_hash("test") == before
    write(tmp_path, GOOD.replace("width_mm = 8", "width_mm = 9"))
    assert scenario.data_hash("test") != before
    write(tmp_path, GOOD.replace("width_mm = 8", "width_mm = 99"))
    with pytest.raises(
        InputError, match=r"Suite file .*field 'scenarios\[0\].sensor' of 'mine': Sensor file"
    ):
        load_suite(tmp_path / "suite.toml")


def test_names_of_sensors_do_not_matter_for_equality(tmp_path: Path) -> None:
    made = sensor(str(write(tmp_path)))
    assert replace(made, name="other") == made
    assert np.array_equal(made.mask, replace(made, name="other").mask)


@pytest.mark.parametrize("background", [1e-3, 1.0, 50.0])
def test_the_data_range_is_the_background_unless_it_is_given(
    tmp_path: Path, background: float
) -> None:
    """So that a touch of half the background has the same PSNR on every skin."""
    skin = sensor(str(write(tmp_path, f"background = {background}\n{GOOD}")))
    assert skin.data_range == background
    untouched = np.full((1, *skin.image_shape), background)
    touched = untouched.copy()
    touched[0, 10:20, 10:20] /= 2
    found = float(psnr(touched, untouched, skin.data_range, skin.mask)[0])
    share = 100 / np.count_nonzero(skin.mask)
    assert found == pytest.approx(-10 * np.log10(share / 4))
    assert sensor_from_json(sensor_to_json(skin)).data_range == background
    given = sensor(str(write(tmp_path, f"data_range = 0.5\n{GOOD}")))
    assert given.data_range == 0.5
