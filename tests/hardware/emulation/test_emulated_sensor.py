"""The emulated sensor: its own physics, which a method must cope with."""

import numpy as np
import pytest

from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor, Touch
from eitbench.methods import Problem, create
from eitbench.scenarios import Dataset, sensor
from eitbench.scenarios.physics.forward import forward_model

FOAM = sensor("foam16")
PRESS = Touch(0.07, 0.03, 0.008, 30e3)


def _no_split(split: str, limit: int | None) -> Dataset:
    raise AssertionError((split, limit))


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
    method.fit(Problem(FOAM, reference, _no_split))
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
