"""Latency of touch detection: streams, the clock of the live view, and the figures of a touch."""

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor
from eitbench.hardware.live.imaging import ImageMaker, LatestValue, reference_of
from eitbench.hardware.live.latency import (
    UNTOUCHED,
    Press,
    draw_press,
    image_course,
    latency_of,
    measure,
    shown,
    stream,
)
from eitbench.methods import Method, register
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor, foam16

COARSE = replace(foam16(), image_shape=(20, 20))
FRAME_S = 0.1


@register("test-fails-when-touched")
class FailsWhenTouched(Method):
    """Fails on a frame of the touched sensor."""

    def fit(self, problem: Any) -> None:
        self.problem = problem

    def reconstruct(self, voltages: Any) -> Any:
        if np.abs(self.problem.difference(voltages)).max() > 0.01:
            raise ValueError("too much for it")
        return np.ones((len(voltages), 20, 20))


@pytest.fixture(scope="module")
def new() -> EmulatedSensor:
    """A unit of the sensor without noise, in an ideal material."""
    unit = EmulatedSensor(COARSE, unit=3, snr_db=np.inf)
    ideal = {"drift": 0.0, "relaxation": 0.0}
    unit.imperfections = unit.imperfections.model_copy(update=ideal)
    return unit


@pytest.fixture(scope="module")
def maker() -> ImageMaker:
    maker = ImageMaker(COARSE)
    maker.fit("noser")
    return maker


def figures(new: EmulatedSensor, maker: ImageMaker, press: Press, image_s: float) -> dict[str, Any]:
    """The figures of a firm press."""
    reference, frames = stream(copy(new), press, 6e4, FRAME_S)
    maker.reference = reference_of(COARSE, reference)
    received = [frame.received_s for frame in frames]
    at = shown(received, image_s, received[0])
    return latency_of(image_course(maker, frames, press, 0.01), press, FRAME_S, at)


@pytest.mark.parametrize(
    ("onset", "release", "frames", "gone"),
    [(0.0, 0.0, 1, 1), (0.01, 0.5, 1, 2), (0.99, 0.99, 2, 2), (0.5, 0.1, None, None)],
)
def test_latency_of_a_clear_touch_is_what_its_phase_dictates(
    new: EmulatedSensor,
    maker: ImageMaker,
    onset: float,
    release: float,
    frames: int | None,
    gone: int | None,
) -> None:
    press = Press(0.05, 0.05, 0.008, UNTOUCHED + onset, UNTOUCHED + 5 + release)
    found = figures(new, maker, press, 0.02)
    assert found["detected_frames"] in ((1, 2) if frames is None else (frames,))
    assert found["gone_frames"] in ((1, 2) if gone is None else (gone,))
    assert found["detected_ms"] == pytest.approx(100 * (found["detected_frames"] - onset) + 20)
    assert found["gone_ms"] == pytest.approx(100 * (found["gone_frames"] - release) + 20)
    assert found["false_contacts"] == found["ghost"] == found["dropped"] == found["failed"] == 0
    assert abs(found["ghost_strength"]) < 1e-3


def test_a_slow_image_costs_frames_and_time(new: EmulatedSensor, maker: ImageMaker) -> None:
    press = Press(0.05, 0.05, 0.008, UNTOUCHED + 0.01, UNTOUCHED + 10.01)
    fast, slow = (figures(new, maker, press, image_s) for image_s in (0.0, 0.35))
    assert slow["detected_frames"] == fast["detected_frames"]  # a figure of no machine
    # Frames arrive at 0.1, 0.2, ... s. Images begin at 0.1, 0.45, 0.8 and, of frame 10 or later
    # only, at 1.15 s.
    assert slow["detected_ms"] == pytest.approx(1e3 * (1.15 + 0.35 - 1.001))
    # 12 images begin while 41 frames arrive, one with the last frame.
    assert slow["dropped"] == pytest.approx(1 - 13 / 41)


@pytest.mark.parametrize("image_s", [0.0, 0.03, 0.1, 0.13, 0.25, 1.7])
@pytest.mark.parametrize("free_s", [0.0, 0.37])
def test_the_clock_drops_what_the_slot_between_the_threads_drops(
    image_s: float, free_s: float
) -> None:
    received = [0.1 * (k + 1) for k in range(30)]
    slot: LatestValue[int] = LatestValue()
    expected, now, arrived = {}, free_s, 0
    while True:
        while arrived < len(received) and received[arrived] <= now:
            slot.put(arrived)
            arrived += 1
        taken = slot.take(0)
        if taken is not None:
            now += image_s
            expected[taken] = now
        elif arrived < len(received):
            now = received[arrived]
        else:
            break
    assert shown(received, image_s, free_s) == pytest.approx(expected)


def test_figures_of_one_touch() -> None:
    """A contact elsewhere before, a miss in the frame of onset, a ghost in one frame of three."""
    course = pd.DataFrame({
        "contacts": [0, 1, 0, 1, 1, 1, 1, 0, 1, 0],
        "hit": [False, False, False, True, True, True, True, False, True, False],
        "strength": [0, 0, 0.1, 1, 1, 1, 0.6, 0.04, 0.05, 0.0],
        "failed": False,
    })  # fmt: skip
    press = Press(0, 0, 1, 2.5, 6.25)
    at = {k: k + 1.25 for k in range(10) if k != 3}  # [s], frames of 1 s
    found = latency_of(course, press, 1.0, at)
    assert found["detected_frames"] == 2
    assert found["detected_ms"] == pytest.approx(1e3 * (5.25 - 2.5))  # frame 3 was dropped
    assert found["gone_frames"] == 2
    assert found["gone_ms"] == pytest.approx(1e3 * (8.25 - 6.25))
    assert (found["ghost"], found["ghost_strength"]) == (1, 0.04)
    assert (found["false_contacts"], found["untouched"]) == (1, 2)
    never = latency_of(course.assign(hit=False), press, 1.0, at)
    assert never["detected_frames"] == never["detected_ms"] == np.inf
    assert np.isnan([never[name] for name in ("gone_frames", "gone_ms", "ghost")]).all()


def test_without_noise_no_contact_is_false_and_the_seed_decides_all() -> None:
    def measured(image_ms: float) -> Any:
        return measure(COARSE, ["noser"], np.inf, touches=1, seed=4, image_ms=image_ms)

    fast, slow = measured(1.0), measured(150.0)
    assert (fast.touches["false_contacts"] == 0).all()
    assert (fast.touches["untouched"] == UNTOUCHED).all()
    assert (fast.touches["dropped"] == 0).all()
    assert (slow.touches["dropped"] > 0.2).all()
    clock = ["detected_ms", "gone_ms", "dropped"]
    pd.testing.assert_frame_equal(
        fast.touches.drop(columns=clock), slow.touches.drop(columns=clock)
    )
    assert (fast.touches["detected_ms"] < slow.touches["detected_ms"]).all()
    firm = fast.touches[fast.touches["pressure_kpa"] == 60].set_index("ideal")
    # 5 % of the logarithm would be left after a very long touch.
    assert 0.005 < firm["ghost_strength"][False] < 0.05
    assert abs(firm["ghost_strength"][True]) < 1e-3


def test_an_old_reference_shows_contacts_that_are_not_there() -> None:
    """The material drifts: without it, and with a new reference, frames are untouched."""

    def false_contacts(age_s: float) -> pd.Series:
        found = measure(
            COARSE, ["noser"], 80.0, touches=1, seed=1, reference_age_s=age_s, image_ms=1.0
        )
        return found.touches.groupby("ideal")["false_contacts"].sum()

    new, old = false_contacts(0.0), false_contacts(600.0)
    assert new.tolist() == [0, 0]
    assert old[True] == 0
    assert old[False] > 0


def test_a_method_that_fails_detects_nothing() -> None:
    found = measure(COARSE, ["test-fails-when-touched"], 60.0, touches=1, image_ms=1.0).touches
    firm = found[found["pressure_kpa"] == 60]
    assert np.isinf(firm["detected_frames"]).all()
    assert (firm["failed"] > 0.2).all()


def test_places_lie_on_the_sensor_and_phases_fill_a_frame() -> None:
    presses = [draw_press(COARSE, 0.01, FRAME_S, 0, k) for k in range(200)]
    places = np.array([(p.x_m, p.y_m) for p in presses])
    assert places.min() >= 0.01 - 1e-9
    assert places.max() <= 0.09 + 1e-9
    assert places.std(axis=0) == pytest.approx(0.08 / np.sqrt(12), rel=0.15)
    for phases in ([p.onset % 1 for p in presses], [p.release % 1 for p in presses]):
        assert np.histogram(phases, 4, (0, 1))[0].min() > 30


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"snr_db": None}, "give the SNR of a frame in dB, for example `--snr 60`"),
        ({"snr_db": np.nan}, "give the SNR"),
        ({"frame_rate": 0.0}, "The frame rate has to be above 0, got 0"),
        ({"radius_m": -1.0}, "The radius of a touch has to be above 0, got -1000 mm"),
        ({"reference_age_s": -1.0}, "The age of a reference is at least 0 s, got -1"),
        ({"radius_m": 0.06}, "'foam16' has no room for a touch of radius 60 mm"),
        ({"methods": ["nosr"]}, "Unknown method 'nosr': did you mean 'noser'"),
        ({"methods": ["linear-touch"]}, "linear-touch cannot be used live"),
        ({"methods": ["dnn"]}, "'dnn' has no weights for the sensor"),
    ],
)
def test_bad_input_is_named(change: dict[str, Any], sentence: str) -> None:
    sensor: Sensor = COARSE
    arguments: dict[str, Any] = {"methods": ["noser"], "snr_db": 60.0} | change
    with pytest.raises(InputError, match=sentence):
        measure(sensor, arguments.pop("methods"), arguments.pop("snr_db"), **arguments)
