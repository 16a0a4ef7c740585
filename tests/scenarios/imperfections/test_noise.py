"""Noise: the stated level, from a key of its own, the published mixture."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitbench.scenarios.imperfections.noise import (
    add_noise,
    measured_frames,
    measured_reference,
    touch_snr_db,
)
from eitbench.scenarios.seeds import generator

FRAMES = np.random.default_rng(1).normal(size=(400, 208)) * np.linspace(0.1, 5, 400)[:, None]


@pytest.mark.parametrize("snr_db", [60.0, 50.0, 40.0, 30.0])
def test_noise_has_the_stated_snr_in_every_frame(snr_db: float) -> None:
    noisy, snr = measured_frames(FRAMES, snr_db, scenario="s", split="test")
    assert (snr == snr_db).all()
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
    frames, snr = measured_frames(FRAMES, "clean", scenario="s", split="test")
    assert np.array_equal(frames, FRAMES)
    assert np.isnan(snr).all()


def test_mixture_leaves_half_clean_and_spreads_the_rest_over_30_to_60_db() -> None:
    frames = np.ones((4000, 8))
    noisy, snr = measured_frames(frames, "mixture", scenario="s", split="train")
    clean = np.isnan(snr)
    assert np.array_equal((noisy == frames).all(axis=1), clean)
    assert clean.mean() == pytest.approx(0.5, abs=0.04)
    levels = snr[~clean]
    assert levels.min() >= 30
    assert levels.max() <= 60
    counts, _ = np.histogram(levels, bins=6, range=(30, 60))
    assert counts.min() > 0.75 * len(levels) / 6
    unit = (noisy - frames)[~clean] / 10 ** (-levels / 20)[:, None]
    assert unit.std() == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("noise", [40.0, "mixture"])
@settings(max_examples=20, deadline=None)
@given(count=st.integers(1, 400))
def test_frame_does_not_depend_on_the_number_of_frames(noise: float, count: int) -> None:
    every, _ = measured_frames(FRAMES[:400], noise, scenario="s", split="test")
    first, _ = measured_frames(FRAMES[:count], noise, scenario="s", split="test")
    assert np.array_equal(first, every[:count])


def test_every_axis_of_the_key_changes_the_noise() -> None:
    def noise(**key: object) -> bytes:
        axes = {"noise": 40.0, "scenario": "s", "split": "test"} | key
        frames, _ = measured_frames(np.ones((2, 8)), **axes)  # type: ignore[arg-type]
        return frames.tobytes()

    drawn = [noise(), noise(noise=40.5), noise(scenario="t"), noise(split="validation")]
    frames, _ = measured_frames(np.ones((2, 8)), 40.0, scenario="s", split="test")
    reference = measured_reference(np.ones(8), 40.0, scenario="s")
    assert len({*drawn, reference.tobytes(), frames[0].tobytes(), frames[1].tobytes()}) == 7


def test_reference_is_measured_like_any_frame() -> None:
    frame = np.linspace(1, 2, 20_000)
    noise = measured_reference(frame, 30.0, scenario="s") - frame
    assert noise.std() == pytest.approx(np.sqrt(np.mean(frame**2)) * 10**-1.5, rel=0.03)
    for quiet in ("clean", "mixture"):
        assert np.array_equal(measured_reference(frame, quiet, scenario="s"), frame)


def test_the_snr_of_the_touch_is_that_of_what_it_changes() -> None:
    """Measured on noisy frames, whose touch changes a tenth and a hundredth of the frame."""
    clean = np.full((2, 50_000), 2.0)
    touch = np.stack([np.full(50_000, 0.2), np.full(50_000, -0.02)])
    noisy, snr = measured_frames(clean, 40.0, scenario="s", split="test")
    found = touch_snr_db(touch, clean, snr)
    noise = (noisy - clean).std(axis=1)
    assert found == pytest.approx(20 * np.log10(np.abs(touch[:, 0]) / noise), abs=0.1)
    assert found == pytest.approx([20, 0], abs=1e-9)
    assert np.isnan(touch_snr_db(touch, clean, np.full(2, np.nan))).all()
    assert touch_snr_db(0 * touch, clean, snr).tolist() == [-np.inf, -np.inf]


def test_input_is_not_changed() -> None:
    frames = np.ones((3, 8))
    measured_frames(frames, 30.0, scenario="s", split="test")
    add_noise(frames[0], 30.0, generator("x"))
    assert (frames == 1).all()


def test_a_key_that_is_no_number_is_refused() -> None:
    """JSON has no such number, and nothing equals it: the draws could not be made again."""
    with pytest.raises(ValueError, match="not JSON compliant"):
        generator("noise", float("nan"))


def test_generators_are_independent_of_each_other_and_reproducible() -> None:
    axes: list[Any] = [("a", 1), ("a", 2), ("a", "1"), ("a",), ("a", 1, 1), ("b", 1)]
    draws = [generator(*a).standard_normal(500) for a in axes]
    assert np.array_equal(draws[0], generator("a", 1).standard_normal(500))
    assert np.abs(np.corrcoef(draws) - np.eye(len(axes))).max() < 0.2
