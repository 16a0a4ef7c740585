"""The emulated sensor: its own physics, which a method must cope with."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from eitbench.hardware.emulation.emulated_sensor import RELAXATION_S, EmulatedSensor, Touch
from eitbench.methods import Problem, create
from eitbench.methods.problem import no_split
from eitbench.scenarios import sensor
from eitbench.scenarios.physics.forward import forward_model

FOAM = sensor("foam16")
PRESS = Touch(0.07, 0.03, 0.008, 30e3)


@pytest.fixture(scope="module")
def emulated() -> EmulatedSensor:
    return EmulatedSensor(FOAM)


def test_it_is_not_the_model_that_methods_use(emulated: EmulatedSensor) -> None:
    model = forward_model(FOAM)
    nominal = model.voltages(model.background)
    away = np.linalg.norm(emulated.frame(0.0, ()) - nominal) / np.linalg.norm(nominal)
    assert 0.005 < away < 0.05


def test_a_touch_appears_where_it_is_made(emulated: EmulatedSensor) -> None:
    reference = np.mean([emulated.frame(1 + k / 10, ()) for k in range(5)], axis=0)
    method = create("noser")
    method.fit(Problem(FOAM, reference, no_split))
    (image,) = method.reconstruct(emulated.frame(2.0, [PRESS])[None])
    lowest = np.unravel_index(image.argmin(), image.shape)
    x, y = (centre[lowest] for centre in FOAM.pixel_centres)
    assert np.hypot(x - PRESS.x_m, y - PRESS.y_m) < 0.005


@pytest.mark.slow
def test_the_material_creeps_and_recovers() -> None:
    """Beyond noise: of the same touch more is seen later, and after it some is left for seconds."""
    soft = EmulatedSensor(FOAM, unit=1)

    def mean(start: float, touches: list[Touch]) -> np.ndarray:
        frames = [soft.frame(start + k / 20, touches) for k in range(20)]
        return np.asarray(np.mean(frames, axis=0))

    untouched = mean(0, [])
    pressed = mean(1, [PRESS]) - untouched
    direction = pressed / np.linalg.norm(pressed)
    later = mean(21, [PRESS]) - untouched
    after = mean(22.2, []) - untouched
    recovered = mean(60, []) - untouched
    share = [float(change @ direction) / np.linalg.norm(pressed) for change in (later, after)]
    assert 1.01 < share[0] < 1.1
    assert 0.005 < share[1] < 0.1
    assert abs(float(recovered @ direction)) < float(after @ direction)


def test_units_and_noise_differ_from_frame_to_frame(emulated: EmulatedSensor) -> None:
    first, second = (emulated.frame(100.0, ()) for _ in range(2))
    noise = np.linalg.norm(first - second) / np.linalg.norm(first) / np.sqrt(2)
    assert noise == pytest.approx(1e-3, rel=0.3)  # 60 dB
    other = EmulatedSensor(FOAM, unit=2).frame(0.0, ())
    assert np.linalg.norm(other - first) > 5 * np.linalg.norm(second - first)


@pytest.fixture(scope="module")
def exact() -> EmulatedSensor:
    """A unit whose board neither rounds nor settles nor is noisy, and whose material stays."""
    unit = EmulatedSensor(replace(FOAM, image_shape=(20, 20)), unit=5, snr_db=np.inf)
    exact = {"drift": 0.0, "relaxation": 0.0, "bits": None, "settling": 0.0, "mains": 0.0}
    unit.imperfections = unit.imperfections.model_copy(update=exact)
    return unit


def test_a_touch_that_begins_within_a_frame_changes_what_is_measured_later(
    exact: EmulatedSensor,
) -> None:
    untouched, pressed = exact.frame(0.0, ()), exact.frame(1.0, [PRESS])
    assert (untouched != pressed).all()
    begun = exact.scan(2.0, 0.1, [(2.0, ()), (2.025, [PRESS])])
    np.testing.assert_array_equal(begun[:52], untouched[:52])  # a quarter of 208
    np.testing.assert_array_equal(begun[52:], pressed[52:])
    both = exact.scan(3.0, 0.1, [(3.0, ()), (3.025, [PRESS]), (3.05, ())])
    np.testing.assert_array_equal(both[104:], untouched[104:])
    np.testing.assert_array_equal(both[:104], begun[:104])


def test_what_a_touch_leaves_follows_the_law_of_relaxation(exact: EmulatedSensor) -> None:
    """It grows as 1 - exp(-t / T) under the touch and falls as exp(-t / T) after it."""
    soft = copy(exact)
    soft.imperfections = exact.imperfections.model_copy(update={"relaxation": 0.05})
    light = replace(PRESS, pressure_pa=1e3)  # so that voltages are linear in the conductivity
    untouched = exact.frame(10.0, ())
    pressed = exact.frame(11.0, [light]) - untouched
    held_s, half_life_s = 2.0, RELAXATION_S * np.log(2)
    soft.scan(20.0, 0.1, [(20.0, ()), (20.05, [light])])
    left = [
        soft.frame(20.05 + held_s + after, ()) - untouched
        for after in (0.0, half_life_s, 2 * half_life_s)
    ]
    share = [float(change @ pressed / (pressed @ pressed)) for change in left]
    law = 0.05 * (1 - np.exp(-held_s / RELAXATION_S))
    assert share == pytest.approx([law, law / 2, law / 4], rel=0.03)
