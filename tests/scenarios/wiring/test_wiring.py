"""Simulated boards of known wiring: the doctor finds it, or says that it cannot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from docs.studies.wiring.scramble import put_right, scramble
from hypothesis import given, settings
from hypothesis import strategies as st

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model, signed_voltages
from eitbench.scenarios.sensors.outlines import Disc, rectangle
from eitbench.scenarios.sensors.patterns import (
    DrivePattern,
    offset_pattern,
    opposition_pattern,
    ring_pattern,
)
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.sensors.sensor_file import read_sensor, sensor_to_toml
from eitbench.scenarios.wiring.diagnosis import diagnose
from eitbench.scenarios.wiring.evidence import (
    Completion,
    all_values,
    known_values,
    modelled_resistances,
)
from eitbench.scenarios.wiring.hypotheses import Wiring, meaning, numbers_of, orders
from eitbench.scenarios.wiring.report import corrected, findings


def _sensor(*, uneven: bool) -> Sensor:
    outline = rectangle(0.1, 0.07) if uneven else Disc(0.05)
    electrodes = even_electrodes(outline, 8, 0.005, 1e-3, start=0.004 * uneven)
    if uneven:
        shifts = (0, 0.004, -0.003, 0.002, 0, -0.005, 0.004, 0)
        electrodes = tuple(
            replace(e, centre=e.centre + shift) for e, shift in zip(electrodes, shifts, strict=True)
        )
    return Sensor("small", outline, electrodes, offset_pattern(8, 1), image_shape=(24, 24))


UNEVEN, ROUND = _sensor(uneven=True), _sensor(uneven=False)


def _frames(sensor: Sensor, noise: float = 1e-4, n: int = 10) -> np.ndarray:
    model = forward_model(sensor)
    frame = model.voltages(model.background)
    return frame * (1 + noise * np.random.default_rng(0).normal(size=(n, len(frame))))


def test_resistances_give_the_frame_of_the_model() -> None:
    frame = _frames(UNEVEN, 0, 1)[0]
    resistances = modelled_resistances(UNEVEN)
    np.testing.assert_allclose(signed_voltages(UNEVEN.pattern.table, resistances), frame, rtol=1e-9)
    dense = all_values(resistances)[tuple(UNEVEN.pattern.table.T)]
    np.testing.assert_allclose(dense, frame, rtol=1e-9)


def test_a_frame_tells_values_that_its_pattern_determines() -> None:
    """Adjacent pairs with driven electrodes span all resistances, without any help of the model."""
    full = replace(UNEVEN, pattern=offset_pattern(8, 1, driven=True))
    truth = modelled_resistances(full) * np.linspace(1, 2, 8) * np.linspace(1, 2, 8)[:, None]
    other = modelled_resistances(ROUND)
    table = ring_pattern(8, 3, 2).table
    frame = signed_voltages(full.pattern.table, truth)
    np.testing.assert_allclose(
        Completion(full, other).values(frame, table),
        signed_voltages(table, truth),
        rtol=1e-6,
        atol=1e-9,
    )


@settings(max_examples=8, deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_a_wrong_wiring_is_put_right(seed: int) -> None:
    resistances = modelled_resistances(UNEVEN)
    truth = scramble(_frames(UNEVEN), Completion(UNEVEN, resistances), np.random.default_rng(seed))
    found = diagnose(truth.frames, UNEVEN)
    assert found.certainty == "sure", findings(found, UNEVEN)
    assert put_right(found, truth, resistances), (found.wiring, truth.wiring, truth.dead)


def test_faults_are_found_by_number_with_gain_and_sign() -> None:
    resistances = modelled_resistances(UNEVEN)
    numbers = numbers_of([Wiring(0, 3, -1, (2, 5))], 8)[0]
    frames = -7.0 * signed_voltages(numbers[UNEVEN.pattern.table], resistances)[None]
    found = diagnose(frames, UNEVEN)
    assert (found.certainty, found.reversed_sign) == ("sure", True)
    assert (found.wiring.start, found.wiring.step, found.wiring.swapped) == (3, -1, (2, 5))
    assert found.gain == pytest.approx(7, rel=1e-6)
    assert found.leak == pytest.approx(0, abs=1e-6)
    assert "interchanged" in " ".join(findings(found, UNEVEN))
    # The corrected pattern says what the board measured.
    np.testing.assert_allclose(
        7 * signed_voltages(found.pattern.table, resistances), frames[0], rtol=1e-9, atol=1e-12
    )


def test_a_dead_electrode_and_a_saturated_value_are_named() -> None:
    frames = _frames(UNEVEN)
    frames[:, (UNEVEN.pattern.table == 6).any(axis=1)] *= 1e-4
    alive = np.flatnonzero(~(UNEVEN.pattern.table == 6).any(axis=1))[3]
    frames[:, alive] = 50 * np.abs(frames).max()  # the rail of an amplifier
    found = diagnose(frames, UNEVEN)
    assert (found.dead, found.saturated) == ((6,), (alive,))


def test_values_that_a_board_cuts_are_named_and_not_in_the_gain() -> None:
    sensor = _sensor(uneven=True)
    frames = _frames(sensor)
    end = 0.7 * np.abs(frames).max()
    cut = (np.abs(frames) > end).all(axis=0)
    assert 1 < cut.sum() < len(cut) / 2
    found = diagnose(np.clip(3 * frames, -3 * end, 3 * end), sensor)
    assert found.saturated == tuple(np.flatnonzero(cut).tolist())
    assert found.gain == pytest.approx(3, rel=1e-3)
    assert any(line.startswith("Saturated: value ") for line in findings(found, sensor))
    # Nor are those at 0 of magnitudes, which are the least of all: this electrode has no contact.
    silent = (sensor.pattern.table == 3).any(axis=1)
    named = diagnose(np.where(silent, 0, np.abs(frames)), sensor)
    assert not set(named.saturated) & set(np.flatnonzero(silent).tolist())
    # Equal values are none that were cut, where nothing is noisy or they are not at an end.
    assert not diagnose(np.repeat(frames[:1], 4, axis=0), sensor).saturated
    assert not diagnose(frames, sensor).saturated


def test_the_leak_of_common_mode_voltage_is_measured() -> None:
    resistances = modelled_resistances(UNEVEN)
    balanced = resistances - resistances.mean(axis=0)
    src, sink, a, b = UNEVEN.pattern.table.T
    common = (balanced[a, src] + balanced[b, src] - balanced[a, sink] - balanced[b, sink]) / 2
    frame = signed_voltages(UNEVEN.pattern.table, resistances) + 0.02 * common
    assert diagnose(frame[None], UNEVEN).leak == pytest.approx(0.02, abs=1e-6)


def test_a_round_sensor_does_not_tell_its_first_electrode() -> None:
    found = diagnose(_frames(ROUND), ROUND)
    assert found.certainty == "sure but for start and direction"
    assert found.open_answers == 16
    # The declared numbers fit as well, and are kept.
    np.testing.assert_array_equal(found.pattern.table, ROUND.pattern.table)
    assert "Disconnect" in findings(found, ROUND)[1]


def test_a_known_frame_tells_the_first_electrode_of_an_uneven_skin() -> None:
    """No model knows the gains; the frame of the right wiring does."""
    rng = np.random.default_rng(5)
    resistances = modelled_resistances(ROUND)
    uneven = resistances * (g := rng.uniform(0.7, 1.4, 8)) * g[:, None]
    frames = signed_voltages(ROUND.pattern.table, uneven)[None]
    expected = known_values(frames, ROUND)
    truth = scramble(frames, Completion(ROUND, resistances), np.random.default_rng(8))
    found = diagnose(truth.frames, ROUND, expected)
    assert found.certainty == "sure"
    assert put_right(found, truth, resistances)


@pytest.mark.parametrize("dead", range(8))
def test_a_dead_electrode_of_a_skin_with_few_large_values_is_named(dead: int) -> None:
    """A quarter of the values is 30 times as large as the others, as of a skin with a gap."""
    skin = replace(UNEVEN, pattern=opposition_pattern(8))
    large = (skin.pattern.table[:, 2:] == 0).any(axis=1)
    frames = np.abs(signed_voltages(skin.pattern.table, modelled_resistances(skin)))[None]
    frames = frames * np.where(large, 30, 1)
    expected = known_values(frames, skin)
    numbers = Wiring(0, 3, -1).numbers(8)
    (order,) = [one for one in orders(skin.pattern) if one.title == "as declared"]
    table = numbers[order.table]
    sent = expected[tuple(table.T)][None] * 7.0
    sent[:, (table == dead).any(axis=1)] *= 1e-3
    found = diagnose(sent, skin, expected)
    assert found.certainty == "sure", findings(found, skin)
    assert (found.wiring.start, found.wiring.step, found.dead) == (3, -1, (dead,))


def test_frames_that_no_order_explains_are_refused() -> None:
    frames = np.random.default_rng(1).normal(size=(10, UNEVEN.n_measurements))
    found = diagnose(frames, UNEVEN)
    assert found.certainty == "refused"
    assert findings(found, UNEVEN)[0].startswith("Refused. No wiring explains the frames")


def test_noise_and_drift_are_measured() -> None:
    frames = _frames(UNEVEN, noise=0, n=9) * (1 + 0.01 * np.arange(9) / 8)[:, None]
    found = diagnose(frames, UNEVEN)
    assert found.drift == pytest.approx(0.0075 / 1.005, rel=1e-2)
    noisy = diagnose(_frames(UNEVEN, noise=1e-2, n=200), UNEVEN)
    assert noisy.snr_db == pytest.approx(40, abs=0.5)
    assert noisy.repeatability == pytest.approx(1e-2, rel=0.1)


@pytest.mark.parametrize("magnitudes", [True, False])
def test_equal_meaning_is_equal_voltage_and_no_more(magnitudes: bool) -> None:
    """Reciprocity and reversals, against a random symmetric matrix of resistances."""
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 6))
    resistances = half + half.T
    table = np.array([
        (*drive, *sense)
        for drive in ((0, 1), (1, 0), (2, 4), (3, 5))
        for sense in ((2, 4), (4, 2), (3, 5), (0, 1))
    ])  # fmt: skip
    values = signed_voltages(table, resistances)
    code = meaning(table, 6, magnitudes=magnitudes)
    if magnitudes:
        values = np.abs(values)
    same = np.isclose(values[:, None], values)
    np.testing.assert_array_equal(code[:, None] == code, same)


def test_orders_differ_and_begin_as_declared() -> None:
    found = orders(UNEVEN.pattern)
    assert np.array_equal(found[0].table, UNEVEN.pattern.table)
    assert len({order.table.tobytes() for order in found}) == len(found)
    lengths = {len(order.table) for order in found}
    assert lengths == {20, 40, 64, 36}  # halves, whole, with driven electrodes, its halves


def test_a_corrected_sensor_file_is_read_again(tmp_path: Path) -> None:
    found = diagnose(-_frames(UNEVEN), UNEVEN)
    sensor = corrected(found, UNEVEN)
    (tmp_path / "fixed.toml").write_text(sensor_to_toml(sensor, ["one", "two\nlines"]))
    back = read_sensor(tmp_path / "fixed.toml")
    np.testing.assert_array_equal(back.pattern.table, sensor.pattern.table)
    before, after = (forward_model(s) for s in (sensor, back))
    np.testing.assert_allclose(
        after.voltages(after.background), before.voltages(before.background), rtol=1e-6
    )


def test_a_corrected_sensor_keeps_the_pattern_that_the_board_was_told() -> None:
    """The board's electrode k is number 2 - k of the sensor, and two are interchanged."""
    wiring = Wiring(0, 2, -1, (1, 4))
    told = UNEVEN.pattern.table
    numbers = wiring.numbers(len(UNEVEN.electrodes))
    measured = replace(UNEVEN, pattern=DrivePattern(numbers[told]))
    found = diagnose(_frames(measured), UNEVEN)
    sensor = corrected(found, UNEVEN)
    np.testing.assert_array_equal(sensor.pattern.table, told)
    there, here = (forward_model(s) for s in (measured, sensor))
    np.testing.assert_allclose(
        here.voltages(here.background), there.voltages(there.background), rtol=1e-9
    )


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (np.ones((2, 7)), "have 7 values, and orders of sensor 'small' have 20, 36, 40, 64"),
        (np.zeros((2, 40)), "see whether the board drives current"),
        (np.full((2, 40), np.nan), "no number"),
        (np.ones(40), "as rows"),
    ],
)
def test_bad_frames_are_refused(frames: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        diagnose(frames, UNEVEN)


def test_a_known_frame_has_the_length_of_the_pattern() -> None:
    with pytest.raises(InputError, match="40 values"):
        Completion(UNEVEN, modelled_resistances(UNEVEN)).all_values(np.ones(3))
