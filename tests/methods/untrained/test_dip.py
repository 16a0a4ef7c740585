"""The deep image prior: it fits the voltages, stops in time, and keeps to itself."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import PAIRS, foam, round_board, touch

from eitbench.methods import Problem, create
from eitbench.methods.problem import no_split
from eitbench.methods.untrained.dip import Dip
from eitbench.methods.untrained.network_per_frame import MovingVariance
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]


def disc() -> Sensor:
    """Magnitudes only, no two of them equal by reciprocity, and contacts of both signs."""
    return round_board(PAIRS[:4], PAIRS[4:])


def problem(s: Sensor, gain: float = 1.0, snr_db: float = np.inf) -> Problem:
    reference = forward_model(s).voltages(forward_model(s).background)
    noisy = add_noise(reference, snr_db, np.random.default_rng(99))
    return Problem(s, gain * noisy, no_split)


def image(method: Dip, p: Problem, frame: Array) -> Array:
    method.fit(p)
    found: Array = method.reconstruct(frame[None])[0]
    return found


def error(found: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean((found - truth) ** 2)))


@pytest.mark.slow
def test_an_inclusion_is_recovered_better_than_in_one_linear_step() -> None:
    s = foam((16, 16))
    truth = touch(s)
    frame = forward_model(s).voltages(truth)
    noser = create("noser", weight=1e-4)
    noser.fit(problem(s))
    linear = error(noser.reconstruct(frame[None])[0], truth)
    assert linear < 0.7 * error(np.ones(s.image_shape), truth)
    assert error(image(Dip(steps=200), problem(s), frame), truth) < 0.7 * linear


@pytest.mark.slow
def test_the_image_explains_the_frame() -> None:
    s = foam((16, 16))
    model = forward_model(s)
    p = problem(s, snr_db=50)
    frame = add_noise(model.voltages(touch(s)), 50, np.random.default_rng(1))
    difference = p.difference(frame[None])[0]
    left = model.voltages(image(Dip(steps=200), p, frame)) - p.background_voltages - difference
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(difference)


def test_a_frame_is_fitted_alike_alone_and_among_others() -> None:
    s = foam((12, 12))
    places = ((0.06, 0.04), (0.03, 0.05))
    frames = np.stack([forward_model(s).voltages(touch(s, at)) for at in places])
    method = Dip(steps=15)
    method.fit(problem(s))
    together = method.reconstruct(frames)
    np.testing.assert_array_equal(together[1:], method.reconstruct(frames[1:]))
    other = Dip(steps=15, seed=1)
    other.fit(problem(s))
    assert np.abs(other.reconstruct(frames) - together).max() > 1e-3


@pytest.mark.slow
def test_more_variation_costs_more() -> None:
    s = foam((12, 12))
    frame = add_noise(forward_model(s).voltages(touch(s)), 40, np.random.default_rng(0))

    def variation(weight: float) -> float:
        found = image(Dip(steps=150, tv=weight), problem(s), frame)
        return float(np.abs(np.diff(found, axis=0)).sum() + np.abs(np.diff(found, axis=1)).sum())

    assert variation(5.0) < 0.8 * variation(0.0)


def test_images_keep_to_the_range_and_to_the_sensor() -> None:
    s = disc()
    p = problem(s)
    frame = forward_model(s).voltages(touch(s, (0.01, 0.0), factor=0.3))
    found = image(Dip(steps=60), p, frame)
    low, high = s.conductivity_range
    assert found.min() >= low * s.background
    assert found.max() <= high * s.background
    assert (found[~s.mask] == s.background).all()
    assert error(found, touch(s, (0.01, 0.0), factor=0.3)) < error(
        np.full(s.image_shape, s.background), touch(s, (0.01, 0.0), factor=0.3)
    )


def test_the_stop_is_where_images_stand_still() -> None:
    """Images that move, stand still with some jitter, and move again."""
    rng = np.random.default_rng(0)
    stopping = MovingVariance(window=10, patience=15)
    level = [*np.linspace(0, 1, 20), *[1.0] * 20, *np.linspace(1, 3, 60)]
    images = (value + 0.001 * rng.normal(size=(3, 4)) for value in level)
    seen = 1 + next(k for k, image in enumerate(images) if stopping.stops(image))
    assert 30 <= stopping.position <= 41
    assert seen == stopping.position + 15
    np.testing.assert_allclose(stopping.image, 1.0, atol=0.01)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        (Dip(operator="fe"), "Unknown operator 'fe': did you mean 'fem'"),
        (Dip(steps=0), "at least 1 step"),
        (Dip(tv=-1.0), "a weight of at least 0"),
    ],
)
def test_what_cannot_be_is_refused(method: Dip, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        method.fit(problem(foam((12, 12))))
