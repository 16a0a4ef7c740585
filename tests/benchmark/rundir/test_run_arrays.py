"""Arrays of a run directory."""

import numpy as np

from eitbench.benchmark.rundir.run_arrays import rounded_images


def test_rounded_images_keep_as_many_levels_of_a_weak_touch_as_of_a_strong_one() -> None:
    shape = np.random.default_rng(0).uniform(-1, 1, (1, 30, 30))
    contrast = np.array([0.6, 0.004, 0.0])[:, None, None] * shape
    images = (0.7 + contrast).astype(np.float32)
    images[0, 0, 0] = np.nan
    rounded, steps = rounded_images(images, 0.7)
    assert np.isnan(rounded[0, 0, 0])
    for k, largest in enumerate(np.nanmax(np.abs(images - 0.7), axis=(1, 2))[:2]):
        away = np.abs(rounded[k] - images[k])
        assert largest / 2048 <= steps[k, 0, 0] <= largest / 1024
        assert 0 < np.nanmax(away) <= steps[k, 0, 0] / 2 + 1e-7  # what float32 rounds comes on top
    np.testing.assert_array_equal(rounded[2], images[2])
    # Float16 would keep but some ten levels of the weak one.
    assert (
        np.abs(images[1].astype(np.float16) - images[1]).max()
        > 50 * np.abs(rounded[1] - images[1]).max()
    )
