"""Calibration finds what is wrong with a sensor, and corrects frames of touches it never saw."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.scenarios import InputError, load, sensor
from eitbench.scenarios.imperfections.calibration import (
    CONTACT_DEVIATION,
    GAIN_DEVIATION,
    SHIFT_DEVIATION,
    Calibration,
    calibrate,
)
from eitbench.scenarios.imperfections.imperfections import (
    Imperfections,
    channels,
    farthest_shifts,
)
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.suites.scenario import SimulatedScenario

FOAM = replace(sensor("foam16"), image_shape=(24, 24))  # a coarser grid is quicker
BOARD = Imperfections(electrode_shift_m=5e-4, contact_impedance=0.5, gain=0.01)


def reference(board: Imperfections, units: float = 1.0) -> np.ndarray:
    """A frame (1, M) of an uneven sensor at 60 dB, from a finer mesh."""
    model = forward_model(replace(FOAM, electrodes=board.built(FOAM)).refined(2))
    clean = model.voltages(model.background)
    analogue = board.analogue(clean[None], clean, FOAM.pattern)
    sent = board.digital(analogue, clean, FOAM.pattern)
    return units * np.array([add_noise(frame, 60, np.random.default_rng(0)) for frame in sent])


def shifts() -> np.ndarray:
    pairs = zip(BOARD.built(FOAM), FOAM.electrodes, strict=True)
    return np.array([built.centre - nominal.centre for built, nominal in pairs])


@pytest.fixture(scope="module")
def found() -> Calibration:
    return calibrate(FOAM, reference(BOARD, units=250.0))


def test_gains_shifts_and_contacts_are_found(found: Calibration) -> None:
    both = zip(BOARD.built(FOAM), FOAM.electrodes, strict=True)
    contacts = np.array([b.contact_impedance / n.contact_impedance for b, n in both])
    ones = np.ones((1, FOAM.n_measurements))
    factors = BOARD.analogue(ones, ones[0], FOAM.pattern)[0]
    channel, pairs = channels(FOAM.pattern)
    gains = np.array([factors[channel == k].mean() for k in range(len(pairs))])
    gains /= gains.mean()  # a common factor is told apart from nothing

    assert np.std(found.gains / found.gains.mean() - gains) < 0.15 * np.std(gains)
    assert np.std(found.shifts - shifts()) < 0.6 * np.std(shifts())
    assert np.corrcoef(np.log(found.contacts), np.log(contacts))[0, 1] > 0.8
    assert found.credible
    assert found.misfit_after < 0.1 * found.misfit_before
    assert found.factor == pytest.approx(250, rel=0.01)


def test_the_description_is_in_the_units_that_it_names(found: Calibration) -> None:
    described = found.describe()
    electrodes, measured = described["electrodes"], described["channels"]
    assert isinstance(electrodes, list)
    assert isinstance(measured, list)
    assert [row["shift_mm"] for row in electrodes] == pytest.approx((1e3 * found.shifts).tolist())
    assert [row["contact_impedance"] for row in electrodes] == found.contacts.tolist()
    assert [row["gain"] for row in measured] == found.gains.tolist()
    assert described["misfit_before"] == found.misfit_before


def test_stated_deviations_are_those_of_the_errors() -> None:
    """Over units drawn from the priors: errors of gains, shifts and contacts."""
    deviations: dict[str, list[np.ndarray]] = {"gain": [], "shift": [], "contact": []}
    channel, pairs = channels(FOAM.pattern)
    for unit in range(12):
        board = Imperfections(
            unit=unit, electrode_shift_m=SHIFT_DEVIATION * FOAM.outline.perimeter / 16,
            contact_impedance=CONTACT_DEVIATION, gain=GAIN_DEVIATION,
        )  # fmt: skip
        found = calibrate(FOAM, reference(board))
        described = found.describe()
        electrodes, measured = described["electrodes"], described["channels"]
        assert isinstance(electrodes, list)
        assert isinstance(measured, list)
        built = board.built(FOAM)
        both = list(zip(built, FOAM.electrodes, strict=True))
        shift = found.shifts - [b.centre - n.centre for b, n in both]
        contact = np.log(found.contacts) - np.log(
            [b.contact_impedance / n.contact_impedance for b, n in both]
        )
        ones = np.ones((1, FOAM.n_measurements))
        factors = board.analogue(ones, ones[0], FOAM.pattern)[0]
        gains = np.array([factors[channel == k].mean() for k in range(len(pairs))])
        gain = found.gains - gains  # most of it in common, as no frame tells it from the current
        deviations["gain"].append(gain / [row["gain_sd"] for row in measured])
        deviations["shift"].append(1e3 * shift / [row["shift_mm_sd"] for row in electrodes])
        stated = np.log([row["contact_impedance_sd_factor"] for row in electrodes])
        deviations["contact"].append(contact / stated)
    for name, errors in deviations.items():
        assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.6, name


@pytest.mark.parametrize("units", [1.0, 250.0])
def test_a_misfit_is_relative_to_the_rms_of_the_frame(units: float) -> None:
    """White noise of 40 dB: the median of its size is 0.6745 of its deviation."""
    model = forward_model(FOAM)
    nominal = model.voltages(model.background)
    noisy = units * add_noise(nominal, 40, np.random.default_rng(1))
    assert calibrate(FOAM, [noisy]).misfit_before == pytest.approx(0.6745 * 10**-2, rel=0.15)


def test_the_frame_it_was_made_from_becomes_the_nominal_one(found: Calibration) -> None:
    model = forward_model(FOAM)
    assert np.allclose(found.nominal, found.factor * model.voltages(model.background))
    assert np.allclose(found.corrected(found.reference[None])[0], found.nominal)


def _scenario(board: Imperfections, *, calibrated: bool) -> SimulatedScenario:
    return SimulatedScenario(
        name="calibration-test",
        image_shape=(24, 24),
        families=("circle", "l-shape"),
        train=0,
        validation=0,
        test=6,
        imperfections=board,
        calibrated=calibrated,
    )


def _changes(board: Imperfections, *, calibrated: bool) -> np.ndarray:
    data = load(_scenario(board, calibrated=calibrated))
    return np.asarray(data.voltages - data.references)


@pytest.mark.slow
def test_every_session_is_corrected_by_its_own_frame_in_any_number_of_processes() -> None:
    measured = load(_scenario(BOARD, calibrated=False))
    alone, together = (load(_scenario(BOARD, calibrated=True), jobs=jobs) for jobs in (1, 2))
    np.testing.assert_array_equal(alone.voltages, together.voltages)
    np.testing.assert_array_equal(alone.references, together.references)
    for rows in (slice(0, 3), slice(3, 6)):
        found = calibrate(measured.sensor, measured.references[rows][:1])
        np.testing.assert_allclose(alone.voltages[rows], found.corrected(measured.voltages[rows]))
        np.testing.assert_allclose(alone.references[rows], [found.nominal] * 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "left"),
    [("electrode_shift_m", 5e-4, 0.6), ("gain", 0.01, 0.3), ("contact_impedance", 0.5, 0.85)],
)
def test_touches_are_seen_as_by_the_nominal_sensor(name: str, value: float, left: float) -> None:
    """Of the error in what a touch changes, calibration leaves no more than a share."""
    board = Imperfections.model_validate({name: value})
    truth = _changes(Imperfections(), calibrated=False)
    before = np.linalg.norm(_changes(board, calibrated=False) - truth)
    after = np.linalg.norm(_changes(board, calibrated=True) - truth)
    assert after < left * before


def test_a_nominal_sensor_is_left_as_it_is() -> None:
    model = forward_model(FOAM)
    frames = np.array([add_noise(model.voltages(model.background), 60, np.random.default_rng(1))])
    found = calibrate(FOAM, frames)
    assert not found.credible
    assert np.array_equal(found.nominal, frames[0])
    assert np.array_equal(found.corrected(2 * frames), 2 * frames)


def test_wide_electrodes_far_from_their_places_are_calibrated() -> None:
    """A step tries no place where electrodes overlap."""
    width = 0.9 * FOAM.outline.perimeter / 16
    wide = replace(FOAM, electrodes=tuple(replace(e, width=width) for e in FOAM.electrodes))
    board = Imperfections(electrode_shift_m=2e-3)
    unit = forward_model(replace(wide, electrodes=board.built(wide)))
    found = calibrate(wide, unit.voltages(unit.background)[None])
    assert np.abs(found.shifts).max() <= farthest_shifts(wide).max() * (1 + 1e-12)
    assert found.misfit_after < found.misfit_before


@pytest.mark.slow
def test_faults_do_not_spoil_the_rest() -> None:
    for fault in ({"dead": (5,)}, {"saturated": 3}):
        faulty = calibrate(FOAM, reference(BOARD.model_copy(update=fault)))
        assert np.std(faulty.shifts - shifts()) < 0.7 * np.std(shifts()), fault


@pytest.mark.parametrize("count", [1, 8])
def test_values_far_too_large_are_left_out(count: int) -> None:
    """Those at the end of their range are no reason to trust all others less."""
    frame = reference(BOARD)
    frame[0, np.argsort(-np.abs(frame[0]))[:count]] *= 300
    faulty = calibrate(FOAM, frame)
    assert faulty.credible
    assert faulty.misfit_after < 0.1 * faulty.misfit_before


@pytest.mark.parametrize("dead", [0, 2])
def test_one_dead_electrode_of_eight_leaves_a_factor_and_a_frame(dead: int) -> None:
    """It takes part in half of all measurements or more."""
    pattern = offset_pattern(8, 3)
    eight = Sensor(
        "eight", FOAM.outline, even_electrodes(FOAM.outline, 8, 0.01, 1e-3), pattern,
        background=0.4, image_shape=(16, 16),
    )  # fmt: skip
    board = Imperfections(electrode_shift_m=1e-3, gain=0.03, dead=(dead,))
    model = forward_model(replace(eight, electrodes=board.built(eight)))
    clean = model.voltages(model.background)
    found = calibrate(eight, 250 * board.analogue(clean[None], clean, pattern))
    assert found.factor == pytest.approx(250, rel=0.03)
    assert found.credible
    ideal = forward_model(eight)
    np.testing.assert_allclose(found.nominal, 250 * ideal.voltages(ideal.background), rtol=0.03)


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (np.ones((1, 5)), "need shape"),
        (np.ones(208), "need shape"),
        (np.full((1, 208), np.nan), "not a finite number"),
        (np.zeros((1, 208)), "does not resemble"),
    ],
)
def test_bad_frames_are_refused(frames: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        calibrate(FOAM, frames)


def test_frames_of_another_length_are_not_corrected(found: Calibration) -> None:
    with pytest.raises(InputError, match="need shape"):
        found.corrected(np.ones((2, 7)))


def test_a_real_tank_that_differs_otherwise_is_left_alone(recorded_data: object) -> None:
    from eitbench.scenarios.recordings.fetch import read_recording

    recording = read_recording("sciospec-tank")
    coarser = replace(sensor("sciospec-tank"), image_shape=(24, 24))
    tank = calibrate(coarser, recording.reference[None])
    assert tank.misfit_after <= tank.misfit_before
    assert not tank.credible


@pytest.mark.parametrize("ladder", [False, True])
def test_methods_are_tuned_on_calibrated_frames_too(ladder: bool) -> None:
    """Validation touches are of imperfect units, but for those of the ladder."""
    raw, corrected = (
        load(
            _scenario(BOARD, calibrated=calibrated).model_copy(
                update={"ladder": ladder, "validation": 3}
            ),
            "validation",
        )
        for calibrated in (False, True)
    )
    assert np.array_equal(raw.voltages, corrected.voltages) == ladder
