"""What `check` says of a recording beside the model of its sensor: each fault, and no false one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.support.pressed_skin import SKIN, Array, pressed_skin, renumbered

from eitbench.hardware.recording.exchange import import_recording, write_recording
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings.agreement import (
    LEAST_SPREAD,
    differences_problem,
    explained,
    reference_problem,
    touch_problems,
)
from eitbench.scenarios.recordings.files.own import frames_of_touches, own_set
from eitbench.scenarios.recordings.files.pairs import from_differences, from_pairs
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.recordings.quality import check
from eitbench.scenarios.sensors.patterns import opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor

AROUND = np.arange(16)


@pytest.fixture(scope="module")
def sound() -> Content:
    return from_pairs(*pressed_skin(20)[:2], SKIN, "fake", pressed_skin(20)[2])


def checked(content: Content, folder: Path) -> list[str]:
    write_recording(content, folder / "a.h5")
    return check(folder / "a.h5")[0]


def untouched(skin: Sensor = SKIN) -> Array:
    model = forward_model(skin)
    return model.voltages(model.background)


def test_a_sound_recording_agrees(sound: Content, tmp_path: Path) -> None:
    write_recording(sound, tmp_path / "a.h5")
    problems, facts = check(tmp_path / "a.h5")
    assert problems == []
    assert "Reference against the model of sensor bench: correlation 1.00, misfit 1." in facts[-1]


@pytest.mark.parametrize(
    ("value", "says"), [(0.0, "is 0 in all values"), (3.3, "is about 3.3 in all values")]
)
def test_a_dead_reference_is_told(sound: Content, tmp_path: Path, value: float, says: str) -> None:
    values = sound.values.copy()
    values[::2] = value
    common = replace(sound, values=values, reference=np.array([0, 2]))
    assert any(says in problem for problem in checked(common, tmp_path))


def test_a_reference_that_hardly_varies_is_dead_and_one_that_varies_is_not() -> None:
    noise = np.random.default_rng(0).normal(size=208)
    noise = (noise - noise.mean()) / noise.std()
    dead, poor = (1 + k * LEAST_SPREAD * noise for k in (0.9, 1.1))
    assert "did not measure" in reference_problem(dead, SKIN)
    assert "did not measure" not in reference_problem(poor, SKIN)


def swapped(content: Content) -> Content:
    return replace(content, values=-content.values)


def test_a_reversed_drive_is_told(sound: Content, tmp_path: Path) -> None:
    (problem,) = checked(swapped(sound), tmp_path)
    assert "(misfit 100%), but well (misfit 1%) if the sign of every value is reversed" in (problem)
    assert "swap src and sink (or a and b) in its pattern" in problem


@pytest.mark.parametrize(
    ("number", "says"),
    [
        ((AROUND + 1) % 16, "electrode 0 of the board is electrode 1 of the sensor:"),
        ((5 - AROUND) % 16, "electrode 5 of the sensor, and the numbers go in the other direction"),
    ],
)
def test_electrodes_numbered_otherwise_are_told(
    tmp_path: Path, number: NDArray[np.int64], says: str
) -> None:
    released, pressed, places = pressed_skin(20, skin=renumbered(SKIN, number))
    (problem,) = checked(from_pairs(released, pressed, SKIN, "fake", places), tmp_path)
    assert says in problem
    reverse = reference_problem(-released[0], SKIN)
    assert "reversed and electrode 0" in reverse


def test_where_another_numbering_is_hardly_better_none_is_named() -> None:
    """The frame between both numberings: clearly nearer to the other one, and not so."""
    own, other = untouched(), untouched(renumbered(SKIN, (AROUND + 1) % 16))
    nearer, between = 0.2 * own + 0.8 * other, 0.45 * own + 0.55 * other
    assert "electrode 0 of the board is electrode 1" in reference_problem(nearer, SKIN)
    assert reference_problem(between, SKIN) == ""


def test_a_frame_that_fits_nothing_is_not_blamed_on_numbers() -> None:
    noise = np.random.default_rng(1).normal(size=208)
    if noise @ untouched() < 0:
        noise = -noise
    assert reference_problem(noise, SKIN) == ""
    assert "no method can use it" in reference_problem(-noise, SKIN)


def test_a_board_of_magnitudes_has_no_sign_to_be_reversed() -> None:
    skin = replace(SKIN, pattern=opposition_pattern(16))
    assert reference_problem(untouched(skin), skin) == ""


def test_places_in_metres_are_told(sound: Content, tmp_path: Path) -> None:
    problem = "All places lie within 0.044 mm of each other: were metres imported as millimetres?"
    for k, (factor, told) in enumerate(((1e-3, [problem]), (1.0, []))):
        folder = tmp_path / str(k)
        folder.mkdir()
        places = sound.labels[["x_m", "y_m"]] * factor
        assert checked(replace(sound, labels=sound.labels.assign(**places)), folder) == told
    # Presses of one place, which a robot does not quite repeat, are no alarm.
    near = 0.04 + sound.labels[["x_m", "y_m"]] * 1e-3
    assert checked(replace(sound, labels=sound.labels.assign(**near)), tmp_path) == []


def test_a_place_with_one_coordinate_is_told(sound: Content, tmp_path: Path) -> None:
    labels = sound.labels.copy()
    labels.loc[3, "y_m"] = np.nan
    problems = checked(replace(sound, labels=labels), tmp_path)
    assert problems == ["1 label has only one coordinate, the first is label 3."]
    with pytest.raises(DataCorruptError, match="label 3 has only one coordinate"):
        own_set(tmp_path / "a.h5")


def test_touches_without_a_place_among_others_and_infinite_places_are_told(
    sound: Content, tmp_path: Path
) -> None:
    labels = sound.labels.copy()
    labels.loc[3, ["x_m", "y_m"]] = np.nan
    (problem,) = checked(replace(sound, labels=labels), tmp_path)
    assert problem.startswith(f"1 label of {len(labels)} has no place, the first is label 3:")
    for name, what in (("x_m", "place"), ("depth_mm", "depth")):
        endless = sound.labels.assign(**{name: sound.labels[name].astype(float)})
        endless.loc[2, name] = np.inf
        folder = tmp_path / name
        folder.mkdir()
        problems = checked(replace(sound, labels=endless), folder)
        assert f"Label 2 has an infinite {what}." in problems
        with pytest.raises(DataCorruptError, match=f"label 2 has an infinite {what}"):
            own_set(folder / "a.h5")


def test_registration_by_places_on_a_line_is_told(sound: Content, tmp_path: Path) -> None:
    """A grid of five columns, row by row: every fifth touch is in the first one."""
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0.02, 0.08, 5), [0.02, 0.03, 0.05]))
    by_column = np.arange(15).reshape(3, 5).T.ravel()
    says = "lie almost on a line, which does not tell an image from its mirror image: touch again"
    for k, (order, told) in enumerate(((np.arange(15), True), (by_column, False))):
        folder = tmp_path / str(k)
        folder.mkdir()
        labels = sound.labels[:15].assign(x_m=x[order], y_m=y[order])
        problems = checked(replace(sound, labels=labels), folder)
        assert any(says in problem for problem in problems) == told
    alone = sound.labels[:15].assign(x_m=0.04, y_m=0.04)  # a study of forces
    assert checked(replace(sound, labels=alone), tmp_path) == []


def test_whole_frames_as_differences_are_told(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(20)
    says = "look like whole frames, not like differences: import them without --differences."
    for k, (values, told) in enumerate(
        ((pressed, True), (-pressed, True), (pressed - released, 0))
    ):
        folder = tmp_path / str(k)
        folder.mkdir()
        problems = checked(from_differences(values, SKIN, "imported", places), folder)
        assert [says in problem for problem in problems] == [True] * told
    assert differences_problem(np.zeros((3, 208)), SKIN) == ""


def test_options_that_give_a_reference_are_named(sound: Content, tmp_path: Path) -> None:
    bare = replace(sound, labels=sound.labels[:0])
    for board, says in (
        (
            "imported",
            "--guided, or import with --labels and --reference, --released or --differences.",
        ),
        ("bench", "reference frames and labelled touches: record with --guided."),
    ):
        path = tmp_path / f"{board}.h5"
        write_recording(replace(bare, board=board), path)
        assert any(says in fact for fact in check(path)[1])


def late(places: pd.DataFrame, presses: int) -> pd.DataFrame:
    return pd.DataFrame(np.roll(places.to_numpy(), presses, axis=0), columns=places.columns)


@pytest.mark.parametrize(
    ("presses", "says"),
    [(1, "one press too late"), (-1, "one press too early"), (2, "two presses too late")],
)
def test_labels_that_are_late_are_told(tmp_path: Path, presses: int, says: str) -> None:
    released, pressed, places = pressed_skin(20)
    content = from_pairs(released, pressed, SKIN, "fake", late(places, presses))
    (problem,) = checked(content, tmp_path)
    assert says in problem
    (same,) = checked_differences(pressed - released, late(places, presses))
    assert same == problem


def checked_differences(differences: Array, places: pd.DataFrame) -> list[str]:
    return touch_problems(
        frames_of_touches(from_differences(differences, SKIN, "fake", places)), SKIN
    )


def test_repeated_places_hide_no_labels_that_are_late() -> None:
    """Three of four labels are right although all are one press late."""
    released, pressed, places = pressed_skin(10)
    noise = 1e-3 * np.random.default_rng(0).normal(size=(40, 208)) * np.abs(released).max() * 0.01
    change = np.repeat(pressed - released, 4, axis=0) + noise
    labels = places.loc[np.repeat(np.arange(10), 4)].reset_index(drop=True)
    assert checked_differences(change, labels) == []
    (problem,) = checked_differences(change, late(labels, 1))
    assert "one press too late" in problem


def test_loads_that_are_late_are_told_where_no_place_is_known() -> None:
    rng = np.random.default_rng(0)
    force = rng.uniform(1, 5, 40)
    _, pressed, _ = pressed_skin(1)
    change = (force[:, None] / 5) * (pressed - untouched())
    for labelled, count in ((force, 0), (np.roll(force, 1), 1)):
        labels = pd.DataFrame({"force_N": labelled})
        assert len(checked_differences(change, labels)) == count


def test_touches_that_say_nothing_give_no_alarm() -> None:
    """Noise instead of touches: no lag and no direction is found, however many are tried."""
    places = pressed_skin(20)[2]
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(20, 208))
        assert checked_differences(noise, places) == []


@pytest.mark.parametrize("lag", [-2, -1, 0, 1, 2])
def test_the_share_explained_is_that_of_its_lag(lag: int) -> None:
    shown = np.random.default_rng(2).normal(size=(50, 2))
    known = np.roll(shown @ np.array([[1.0, 2.0], [0.5, -1.0]]) + 3, lag, axis=0)
    found = {k: explained(shown, known, k) for k in (-2, -1, 0, 1, 2)}
    assert found.pop(lag) == pytest.approx(1)
    assert max(found.values()) < 0.2


def test_a_range_that_the_touches_contradict_is_told(tmp_path: Path) -> None:
    falling, rising = "lower the conductivity", "raise the conductivity"
    for rise, bounds, says in (
        (19, (0.05, 1.0), f"19 of 20 touches {rising}"),
        (17, (0.05, 1.0), ""),  # less than nine of ten
        (19, (0.05, 1.1), ""),  # a touch can be shown
        (1, (0.99, 20.0), f"19 of 20 touches {falling}"),
        (3, (0.99, 20.0), ""),
    ):
        skin = replace(SKIN, conductivity_range=bounds)
        released, pressed, places = pressed_skin(20, rising=rise)
        folder = tmp_path / f"{rise} {bounds}"
        folder.mkdir()
        problems = checked(from_pairs(released, pressed, skin, "fake", places), folder)
        assert bool(problems) == bool(says), (rise, bounds, problems)
        assert all(says in problem for problem in problems)


def test_another_sensor_is_compared(sound: Content, tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_recording(sound, path)
    _, facts = check(path, sensor("foam16"))
    assert "against the model of sensor bench: correlation 1.00" in facts[-2]
    assert "against the model of sensor foam16: correlation 0." in facts[-1]
    with pytest.raises(InputError, match="holds 208 values a frame, and sensor 'ohmc16' has 192"):
        check(path, sensor("ohmc16"))


@pytest.mark.slow
@pytest.mark.usefixtures("recorded_data")
@pytest.mark.parametrize("name", ["ohmc16", "ohmc8", "jku-tank-diagonal"])
def test_sound_public_sets_give_no_alarm(name: str, tmp_path: Path) -> None:
    import_recording([name], tmp_path / "a.h5")
    assert check(tmp_path / "a.h5")[0] == []


@pytest.mark.usefixtures("recorded_data")
def test_the_saturated_rectangle_is_told_and_that_its_model_is_wrong(tmp_path: Path) -> None:
    """Its frames know the places, its model does not; a disc's model nearly does (78 of 90 %)."""
    import_recording(["hydrogel-rectangle"], tmp_path / "a.h5")
    problems, facts = check(tmp_path / "a.h5")
    assert len(problems) == 1
    assert problems[0].startswith("8 of 32 values of the untouched sensor are more than 10 times")
    assert "in the model explains 8%, a linear regression of the frames 28%." in facts[-1]


def test_a_dead_electrode_is_told(sound: Content, tmp_path: Path) -> None:
    dead = (SKIN.pattern.table == 9).any(axis=1)
    problems = checked(replace(sound, values=np.where(dead, 0.0, sound.values)), tmp_path)
    assert any("driven or sensed with electrode 9 is about 0" in problem for problem in problems)
