"""Values that a dead electrode or saturation spoils: of simulated boards and of public sets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.imperfections.faults import (
    dead_electrodes,
    never_alone,
    saturated_values,
    spoiled,
)
from eitbench.scenarios.imperfections.imperfections import TYPICAL
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.sensors.patterns import DrivePattern

SENSOR = replace(sensor("foam16"), image_shape=(24, 24))
MODEL = forward_model(SENSOR)
FRAME = MODEL.voltages(MODEL.background)


@pytest.mark.parametrize("dead", [(), (5,), (0, 9), (0, 1, 2, 3)])
def test_a_dead_electrode_spoils_what_it_drives_or_senses(dead: tuple[int, ...]) -> None:
    """On a board with offsets, gains, hum and rounding, which read a little where nothing is."""
    board = TYPICAL.model_copy(update={"dead": dead, "unit": 3})
    frame = board.digital(board.analogue(FRAME[None], FRAME, SENSOR.pattern), FRAME, SENSOR.pattern)
    assert tuple(np.flatnonzero(dead_electrodes(frame[0], FRAME, SENSOR.pattern))) == dead
    touched = np.isin(SENSOR.pattern.table, dead).any(axis=1)
    np.testing.assert_array_equal(spoiled(frame[0], FRAME, SENSOR.pattern), touched)
    # In any units, and of many frames at once.
    many = spoiled(300 * np.vstack([frame, FRAME]), FRAME, SENSOR.pattern)
    np.testing.assert_array_equal(many, [touched, np.zeros_like(touched)])


@pytest.mark.parametrize("lost", [7, 8, 9])
def test_a_connector_that_is_off_is_told_from_saturation(lost: int) -> None:
    """More than half of the electrodes send exact zeros."""
    dead = np.arange(16) < lost
    frame = np.where(np.isin(SENSOR.pattern.table, np.arange(lost)).any(axis=1), 0.0, FRAME)
    found = dead_electrodes(frame, FRAME, SENSOR.pattern)
    np.testing.assert_array_equal(found | never_alone(found, SENSOR.pattern), dead)
    assert not saturated_values(frame, FRAME, SENSOR.pattern).any()


@pytest.mark.parametrize("dead", [(3,), (6,), (3, 6), (3, 6, 8)])
def test_a_partner_of_a_dead_electrode_is_not_dead(dead: tuple[int, ...]) -> None:
    """What electrodes 3 and 6 have in common is large, as where they are near to each other."""
    table = SENSOR.pattern.table
    shared = (table == 3).any(axis=1) & (table == 6).any(axis=1)
    known = np.where(shared, 100 * FRAME, FRAME)
    rng = np.random.default_rng(0)
    frame = known * (1 + 0.3 * rng.normal(size=known.shape))
    frame[np.isin(table, dead).any(axis=1)] *= 1e-3
    found = dead_electrodes(np.stack([known, frame]), known, SENSOR.pattern)
    assert not found[0].any()
    assert tuple(np.flatnonzero(found[1])) == dead


def test_nothing_is_said_of_an_electrode_that_measures_only_with_a_dead_one() -> None:
    """Of the last sense pair, as in KTC 2023, where driving electrodes are even."""
    pattern = DrivePattern(np.array([[0, 2, 3, 4], [0, 2, 4, 5], [2, 4, 0, 1], [2, 0, 1, 3]]))
    known = np.ones(4)
    dead = dead_electrodes(np.where((pattern.table == 4).any(axis=1), 0, known), known, pattern)
    assert np.flatnonzero(dead).tolist() == [4]
    assert np.flatnonzero(never_alone(dead, pattern)).tolist() == [5]
    assert not never_alone(np.zeros(6, dtype=bool), pattern).any()


def test_a_value_far_larger_than_the_others_is_saturated() -> None:
    frame = FRAME.copy()
    largest, smallest = np.argmax(np.abs(FRAME)), np.argmin(np.abs(FRAME))
    frame[largest] *= 15
    frame[smallest] *= 15  # still small
    np.testing.assert_array_equal(
        np.flatnonzero(saturated_values(frame, FRAME, SENSOR.pattern)), [largest]
    )


@pytest.mark.parametrize(
    ("name", "count"), [("ohmc16", 0), ("ohmc8", 0), ("hydrogel-rectangle", 8)]
)
def test_values_of_public_sets(recorded_data: Path, name: str, count: int) -> None:
    """Of the rectangle those are saturated that read 240,000 and more where others read 10,000."""
    skin, frame = sensor(name), read_recording(name).reference
    model = forward_model(skin)
    found = spoiled(frame, model.voltages(model.background), skin.pattern)
    np.testing.assert_array_equal(found, frame > 2e5 if count else np.zeros(len(frame), bool))
    assert found.sum() == count
