"""Noise: the stated level, from a key of its own, the published mixture."""

from typing import Any

import numpy as np
import pytest

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.noise import (
    add_noise,
    distance_of_touch,
    measured,
    session_snr_db,
    snr_of_touch,
)
from eitbench.scenarios.seeds import Axis, generator

FRAMES = np.random.default_rng(1).normal(size=(400, 208)) * np.linspace(0.1, 5, 400)[:, None]


def noisy_frames(frames: Array, snr_db: float, *axes: Axis) -> Array:
    return np.array([measured(frame, snr_db, *axes, k) for k, frame in enumerate(frames)])


@pytest.mark.parametrize("snr_db", [60.0, 50.0, 40.0, 30.0])
def test_noise_has_the_stated_snr_in_every_frame(snr_db: float) -> None:
    noisy = noisy_frames(FRAMES, snr_db, "s", "test")
    scale = np.sqrt(np.mean(FRAMES**2, axis=1)) * 10 ** (-snr_db / 20)
    unit = (noisy - FRAMES) / scale[:, None]
    # 83,200 independent values: standard errors of mean and deviation are 0.0035 and 0.0025.
    assert abs(unit.mean()) < 0.015
    assert unit.std() == pytest.approx(1.0, abs=0.012)
    # White: neighbours in a frame and neighbouring frames are not correlated.
    assert abs(np.mean(unit[:, 1:] * unit[:, :-1])) < 0.015
    assert abs(np.mean(unit[1:] * unit[:-1])) < 0.015
    # Gaussian: the share beyond two deviations is 4.55 %.
    assert np.mean(np.abs(unit) > 2) == pytest.approx(0.0455, abs=0.004)


def test_clean_frames_are_untouched() -> None:
    level = session_snr_db("clean", scenario="s", split="test", session=0)
    assert np.isnan(level)
    assert np.array_equal(noisy_frames(FRAMES, level, "s", "test"), FRAMES)


def test_mixture_leaves_half_clean_and_spreads_the_rest_over_30_to_60_db() -> None:
    snr = np.array(
        [session_snr_db("mixture", scenario="s", split="train", session=k) for k in range(4000)]
    )
    clean = np.isnan(snr)
    assert clean.mean() == pytest.approx(0.5, abs=0.04)
    levels = snr[~clean]
    assert levels.min() >= 30
    assert levels.max() <= 60
    counts, _ = np.histogram(levels, bins=6, range=(30, 60))
    assert counts.min() > 0.75 * len(levels) / 6


def test_every_axis_of_the_key_changes_the_noise_and_the_level_of_a_mixture() -> None:
    frame = np.ones(8)
    keys: list[tuple[Axis, ...]] = [
        ("s", "test", 40.0, 0), ("t", "test", 40.0, 0), ("s", "validation", 40.0, 0),
        ("s", "test", 40.5, 0), ("s", "test", 40.0, 1), ("s", "test", 40.0, "reference", 0),
    ]  # fmt: skip
    assert len({measured(frame, 40.0, *key).tobytes() for key in keys}) == len(keys)
    assert np.array_equal(measured(frame, 40.0, *keys[0]), measured(frame, 40.0, *keys[0]))
    drawn = [
        [session_snr_db("mixture", scenario=a, split=b, session=k) for k in range(20)]
        for a, b in (("s", "test"), ("t", "test"), ("s", "train"))
    ]
    assert len({str(levels) for levels in drawn}) == 3


def test_the_snr_of_the_touch_is_that_of_what_it_changes() -> None:
    """Measured on noisy frames, whose touch changes a tenth and a hundredth of the frame."""
    clean = np.full((2, 50_000), 2.0)
    touch = np.stack([np.full(50_000, 0.2), np.full(50_000, -0.02)])
    found = snr_of_touch(touch, clean, 40.0)
    noise = (noisy_frames(clean, 40.0, "s") - clean).std(axis=1)
    assert found == pytest.approx(20 * np.log10(np.abs(touch[:, 0]) / noise), abs=0.1)
    assert found == pytest.approx([20, 0], abs=1e-9)
    assert np.isnan(snr_of_touch(touch, clean, np.nan)).all()
    assert snr_of_touch(0 * touch, clean, 40.0).tolist() == [-np.inf, -np.inf]


def test_input_is_not_changed() -> None:
    frame = np.ones(8)
    for level in (np.nan, 30.0):
        measured(frame, level, "s")[0] = 7
    add_noise(frame, 30.0, generator("x"))
    assert (frame == 1).all()


def test_a_key_that_is_no_number_is_refused() -> None:
    """JSON has no such number, and nothing equals it: the draws could not be made again."""
    with pytest.raises(ValueError, match="not JSON compliant"):
        generator("noise", float("nan"))


def test_generators_are_independent_of_each_other_and_reproducible() -> None:
    axes: list[Any] = [("a", 1), ("a", 2), ("a", "1"), ("a",), ("a", 1, 1), ("b", 1)]
    draws = [generator(*a).standard_normal(500) for a in axes]
    assert np.array_equal(draws[0], generator("a", 1).standard_normal(500))
    assert np.abs(np.corrcoef(draws) - np.eye(len(axes))).max() < 0.2


def test_the_distance_of_a_model_is_its_error_over_what_the_touch_changes() -> None:
    seen = np.array([[1.0, -1.0, 1.0], [2.0, 2.0, -2.0]])
    np.testing.assert_allclose(distance_of_touch(0.9 * seen, seen), [20.0, 20.0])
    np.testing.assert_allclose(distance_of_touch(2.0 * seen, seen), [0.0, 0.0])
    assert distance_of_touch(seen, seen).tolist() == [np.inf, np.inf]
