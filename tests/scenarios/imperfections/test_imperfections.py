"""Imperfections: each does what its law says, alone, and nothing that is not declared."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from eitbench.scenarios import load, sensor
from eitbench.scenarios.imperfections.imperfections import (
    TYPICAL,
    Imperfections,
    channels,
    rooms,
)
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Electrode
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite, suites

FOAM = sensor("foam16")
IDEAL = Imperfections()
SMALL: dict[str, object] = {
    "name": "ladder-test",
    "image_shape": (20, 20),
    "families": ("circle",),
    "noise": {"train": "clean", "validation": 50, "test": "clean"},
    "train": 4,
    "validation": 4,
    "test": 6,
}


def scenario(imperfections: Imperfections | None = None, **changes: object) -> SimulatedScenario:
    return SimulatedScenario.model_validate(
        {**SMALL, "imperfections": imperfections or IDEAL, **changes}
    )


@pytest.fixture(scope="module")
def untouched() -> np.ndarray:
    model = forward_model(FOAM)
    return model.voltages(model.background)


@pytest.fixture(scope="module")
def frames(untouched: np.ndarray) -> np.ndarray:
    return untouched * np.linspace(1, 1.1, 5)[:, None]


def through(board: Imperfections, frames: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    analogue = board.analogue(frames, untouched, FOAM.pattern)
    return board.received(board.digital(analogue, untouched, FOAM.pattern), untouched)


def test_an_ideal_sensor_is_nominal_to_the_last_bit(
    frames: np.ndarray, untouched: np.ndarray
) -> None:
    assert IDEAL.built(FOAM) == FOAM.electrodes
    assert np.array_equal(through(IDEAL, frames, untouched), frames)
    assert not IDEAL.drawn
    assert not IDEAL.of_voltages()


def test_severity_scales_what_the_same_unit_shows() -> None:
    def shifts(board: Imperfections) -> np.ndarray:
        pairs = zip(board.built(FOAM), FOAM.electrodes, strict=True)
        return np.array([built.centre - nominal.centre for built, nominal in pairs])

    once = shifts(Imperfections(electrode_shift_m=5e-4))
    assert 2e-4 < once.std() < 8e-4
    twice = shifts(Imperfections(electrode_shift_m=5e-4, severity=2))
    assert np.allclose(twice, 2 * once)
    # Alone and among all others, too.
    assert np.allclose(shifts(TYPICAL), once)
    assert not np.allclose(shifts(Imperfections(electrode_shift_m=5e-4, unit=1)), once)


def test_electrodes_never_overlap_however_bad_the_sensor() -> None:
    for unit in range(20):
        bad = Imperfections(
            unit=unit, electrode_shift_m=0.05, electrode_width=1.0, contact_impedance=1.0
        )
        scenario(bad).data_model("test")  # a Sensor refuses electrodes that overlap


def test_electrodes_of_unlike_widths_keep_them_within_tolerance() -> None:
    """Of a wide and a narrow electrode each has half of the free rim between them."""
    foam = sensor("foam16")
    pitch = foam.outline.perimeter / 16
    unlike = replace(
        foam,
        electrodes=tuple(
            Electrode(e.centre, pitch * (1.04 if k % 2 else 0.24), e.contact_impedance)
            for k, e in enumerate(foam.electrodes)
        ),
    )
    np.testing.assert_allclose(rooms(unlike), pitch * np.tile([0.3, 0.7], 8), rtol=1e-9)
    exact = Imperfections(electrode_shift_m=1e-9, electrode_width=1e-9).built(unlike)
    for built, nominal in zip(exact, unlike.electrodes, strict=True):
        assert built.centre == pytest.approx(nominal.centre, abs=1e-8)
        assert built.width == pytest.approx(nominal.width, rel=1e-7)
    worst = Imperfections(electrode_shift_m=1.0, electrode_width=3.0).built(unlike)
    replace(unlike, electrodes=worst)  # which refuses electrodes that overlap


def test_gain_and_offset_belong_to_channels(frames: np.ndarray, untouched: np.ndarray) -> None:
    channel, pairs = channels(FOAM.pattern)
    assert len(pairs) == 16
    factor = through(Imperfections(gain=0.01), frames, untouched) / frames
    added = through(Imperfections(offset=0.01), frames, untouched) - frames
    for found in (factor, added):
        for k in range(16):
            assert np.ptp(found[:, channel == k]) < 1e-9 * np.abs(frames).max()
    # The change that a touch makes does not depend on the offset.
    assert np.allclose(np.diff(added, axis=0), 0, atol=1e-12 * np.abs(frames).max())


def test_gains_and_offsets_of_units_spread_as_declared(untouched: np.ndarray) -> None:
    channel, pairs = channels(FOAM.pattern)
    first = [int(np.flatnonzero(channel == k)[0]) for k in range(len(pairs))]
    frame, rms = untouched[None], np.sqrt(np.mean(untouched**2))
    boards = [[Imperfections(unit=k, gain=0.01), Imperfections(unit=k, offset=0.02)]
              for k in range(60)]  # fmt: skip
    sent = [[through(board, frame, untouched)[0, first] for board in unit] for unit in boards]
    gains, offsets = np.array(sent).transpose(1, 0, 2)
    gains, offsets = gains / untouched[first] - 1, (offsets - untouched[first]) / rms
    assert gains.std() == pytest.approx(0.01, rel=0.1)
    assert offsets.std() == pytest.approx(0.02, rel=0.1)
    assert abs(gains.mean()) < 4 * 0.01 / np.sqrt(gains.size)
    assert abs(offsets.mean()) < 4 * 0.02 / np.sqrt(offsets.size)
    assert abs(np.corrcoef(gains.ravel(), offsets.ravel())[0, 1]) < 0.1


def test_channels_of_reversed_pairs_are_the_same() -> None:
    channel, pairs = channels(offset_pattern(16, 8))
    assert sorted(pairs) == [(k, k + 8) for k in range(8)]
    assert set(channel) == set(range(8))


def test_settling_leaves_a_part_of_the_value_before(
    frames: np.ndarray, untouched: np.ndarray
) -> None:
    found = through(Imperfections(settling=0.1), frames, untouched)
    assert np.allclose(found[:, 1:], 0.9 * frames[:, 1:] + 0.1 * frames[:, :-1])
    most = through(Imperfections(settling=0.5, severity=4), frames, untouched)
    assert np.allclose(most[:, 1:], frames[:, :-1])  # all that a value can be


def test_mains_hum_with_their_frequency(untouched: np.ndarray) -> None:
    rms = float(np.sqrt(np.mean(untouched**2)))
    hum = through(Imperfections(mains=0.01), untouched[None], untouched)[0] - untouched
    spectrum = np.abs(np.fft.rfft(hum)) / len(hum) * 2
    assert np.argmax(spectrum) == 5  # 50 Hz in a frame of 0.1 s
    assert spectrum[5] == pytest.approx(0.01 * rms, rel=0.01)


def test_mains_hum_is_left_in_differences_of_frames(untouched: np.ndarray) -> None:
    """Touches and references are 10 s apart, 500 periods of an exact grid."""
    rms = float(np.sqrt(np.mean(untouched**2)))
    frames = np.broadcast_to(untouched, (400, len(untouched)))
    left = []
    for unit in range(30):
        sent = through(Imperfections(unit=unit, mains=0.01), frames, untouched)
        left.append(np.sqrt(np.mean((sent[1:] - sent[0]) ** 2)) / rms)
        assert np.sqrt(np.mean((sent - untouched) ** 2)) == pytest.approx(
            0.01 * rms / np.sqrt(2), rel=0.02
        )
    # Two hums of random phases: 0.01 rms each, that of their difference.
    assert np.mean(left) == pytest.approx(0.01, rel=0.15)


def test_the_converter_rounds_to_its_bits(frames: np.ndarray, untouched: np.ndarray) -> None:
    found = through(Imperfections(bits=8), frames, untouched)
    step = 2 * 1.25 * np.abs(untouched).max() / 2**8
    assert np.abs(found - frames).max() <= step / 2 * (1 + 1e-9)
    assert len(np.unique(np.round(found / step, 6))) < 257
    assert np.allclose(found / step, np.round(found / step))


def test_faults(frames: np.ndarray, untouched: np.ndarray) -> None:
    dead = through(Imperfections(dead=(5,)), frames, untouched)
    touching = (FOAM.pattern.table == 5).any(axis=1)
    assert not dead[:, touching].any()
    assert np.array_equal(dead[:, ~touching], frames[:, ~touching])

    clipped = through(Imperfections(saturated=3), frames, untouched)
    of = channels(FOAM.pattern)[0] == 3
    assert np.abs(clipped[:, of]).max() == pytest.approx(0.6 * np.abs(untouched[of]).max())
    assert np.array_equal(clipped[:, ~of], frames[:, ~of])


def test_one_in_so_many_frames_is_lost_and_the_last_one_seen_again(untouched: np.ndarray) -> None:
    frames = np.arange(1.0, 3001.0)[:, None] * untouched
    found = through(Imperfections(lost_every=3), frames, untouched)
    number = np.round(found @ untouched / (untouched @ untouched)).astype(int)
    lost = number == np.arange(3000)  # that of the frame before
    assert np.array_equal(number[~lost], np.arange(1, 3001)[~lost])
    assert lost.mean() == pytest.approx(1 / 3, abs=0.03)
    for k in range(3):  # sessions have three touches, of families that take turns
        assert lost[k::3].mean() == pytest.approx(1 / 3, abs=0.05)
    board = Imperfections(lost_every=3)
    np.testing.assert_array_equal(board.received(frames[30:33], frames[29], 30), found[30:33])


def test_drift_is_slow_and_as_large_as_declared() -> None:
    board = Imperfections(drift=0.01)
    times = np.arange(0, 400_000, 600.0)
    even = np.log([board.drifted(FOAM, t)[40, 40] for t in times])
    assert 0.007 < even.std() < 0.013
    seconds = np.log([board.drifted(FOAM, t)[40, 40] for t in np.arange(0, 60, 10.0)])
    assert 0 < np.ptp(seconds) < 0.004
    side = np.log(board.drifted(FOAM, 5000.0))
    assert np.ptp(side) > 1e-4  # a gradient
    assert np.allclose(Imperfections(drift=0.01, severity=0).drifted(FOAM, 5000.0), 1)


def test_drift_is_even_and_a_gradient_in_each_direction_of_its_own() -> None:
    east, north = [], []
    for unit in range(40):
        field = np.log(Imperfections(unit=unit, drift=0.01).drifted(FOAM, 5000.0))
        across, along = field[40, 60] - field[40, 20], field[60, 40] - field[20, 40]
        # Linear in both: what lies across and along is what a corner has.
        assert field[60, 60] - field[20, 20] == pytest.approx(across + along, abs=1e-12)
        east.append(across)
        north.append(along)
    # Half a sensor, of which each side has half of the drift: 0.5 * 0.01 * 0.5 * 2.
    assert np.std(east) == pytest.approx(0.005, rel=0.4)
    assert np.std(north) == pytest.approx(0.005, rel=0.4)
    assert abs(np.corrcoef(east, north)[0, 1]) < 0.4


def test_the_last_touch_remains_in_part() -> None:
    touch, last = np.full((2, 2), 0.5), np.array([[0.25, 1.0], [1.0, 1.0]])
    found = Imperfections(relaxation=0.5).remaining(touch, last)
    assert np.allclose(found, [[0.25, 0.5], [0.5, 0.5]])
    assert np.array_equal(IDEAL.remaining(touch, last), touch)


def test_a_stale_reference_differs_more() -> None:
    """Over 20 units: what drift adds to a frame's difference from its reference."""
    ideal = load(scenario(test=60))

    def added(imperfections: Imperfections) -> float:
        data = load(scenario(imperfections, test=60))
        drift = (data.voltages - data.references) - (ideal.voltages - ideal.references)
        return float(np.median(np.linalg.norm(drift, axis=1)))

    fresh = Imperfections(drift=0.01)
    stale = Imperfections(drift=0.01, reference_age_s=28_800)
    assert added(stale) > 1.4 * added(fresh) > 0
    assert np.array_equal(load(scenario(stale)).voltages, load(scenario(fresh)).voltages)


def test_of_a_rung_of_the_ladder_only_the_test_split_is_imperfect() -> None:
    """Methods learn from and are tuned on the nominal sensor, with its own reference frames."""
    real, ideal = scenario(TYPICAL, ladder=True), scenario(ladder=True)
    for split in ("train", "validation"):
        first, second = load(real, split), load(ideal, split)
        assert np.array_equal(first.voltages, second.voltages)
        assert np.array_equal(first.references, second.references)
    assert not np.allclose(load(real).references, load(ideal).references, rtol=1e-4)
    assert np.array_equal(load(real).conductivity, load(ideal).conductivity)  # type: ignore[arg-type]


def test_every_declared_parameter_changes_the_data_hash() -> None:
    changed = {
        **TYPICAL.model_dump(),
        "unit": 3, "severity": 2.0, "dead": (1,), "saturated": 2, "lost_every": 3,
        "reference_age_s": 7.0,
    }  # fmt: skip
    assert set(changed) == set(Imperfections.model_fields)
    alone = [Imperfections.model_validate({name: value}) for name, value in changed.items()]
    hashes = [scenario(one).data_hash("test") for one in (IDEAL, *alone)]
    hashes.append(scenario(calibrated=True).data_hash("test"))
    assert len(set(hashes)) == len(hashes)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"dead": (16,)}, "electrodes 0 to 15"), ({"saturated": 16}, "channels 0 to 15")],
)
def test_faults_of_what_is_not_there_are_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        scenario(Imperfections.model_validate(wrong))


def test_the_suite_declares_the_typical_board_and_each_of_its_imperfections_alone() -> None:
    declared = {s.name: s for s in load_suite("sim2real").scenarios}
    emulated = declared["sim2real-emulated"]
    assert isinstance(emulated, SimulatedScenario)
    assert emulated.imperfections == TYPICAL
    magnitudes = TYPICAL.model_dump(exclude_defaults=True)
    alone = [
        s.imperfections.model_dump(exclude_defaults=True)
        for s in declared.values()
        if isinstance(s, SimulatedScenario) and s.ladder and not s.calibrated
    ]
    for name, value in magnitudes.items():
        assert {name: value} in alone
    text = tomllib.loads(suites()["sim2real"].read_text())
    for one in text["scenarios"]:
        if not one.get("calibrated"):
            assert any(
                {**other, "name": one["name"]} == {**one, "calibrated": True}
                for other in text["scenarios"]
            ), one["name"]


def test_electrodes_of_units_spread_as_declared() -> None:
    nominal = sensor("foam16")
    units = [
        Imperfections(unit=unit, electrode_width=0.05, contact_impedance=0.3).built(nominal)
        for unit in range(60)
    ]
    widths = np.log([[e.width for e in unit] for unit in units])
    widths -= np.log([e.width for e in nominal.electrodes])
    contacts = np.log([[e.contact_impedance for e in unit] for unit in units])
    contacts -= np.log([e.contact_impedance for e in nominal.electrodes])
    assert widths.std() == pytest.approx(0.05, rel=0.1)
    assert contacts.std() == pytest.approx(0.3, rel=0.1)
    assert abs(np.corrcoef(widths.ravel(), contacts.ravel())[0, 1]) < 0.1
