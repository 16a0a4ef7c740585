"""SSIM of 600 images at once against scikit-image called image by image, in one run.

`pytest tests/speed/test_speed_metrics.py --benchmark-only` prints both.
"""

from typing import Any

import numpy as np
import pytest
from skimage import metrics as skimage_metrics

from eitbench.benchmark.metrics.image_metrics import ssim

# Without annotations of its own.
structural_similarity: Any = skimage_metrics.structural_similarity
Images = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture(scope="module")
def pairs() -> tuple[Images, Images]:
    rng = np.random.default_rng(0)
    truth = np.ones((600, 80, 80))
    truth[:, 20:40, 30:50] = rng.uniform(0.1, 0.9, (600, 1, 1))
    return truth, truth + 0.1 * rng.standard_normal(truth.shape)


@pytest.mark.benchmark(group="ssim of 600 images")
def test_ssim_all_at_once(benchmark: Any, pairs: tuple[Images, Images]) -> None:
    benchmark(lambda: ssim(*pairs, 1.0))


@pytest.mark.benchmark(group="ssim of 600 images")
def test_ssim_image_by_image(benchmark: Any, pairs: tuple[Images, Images]) -> None:
    benchmark(
        lambda: [structural_similarity(t, p, data_range=1.0) for t, p in zip(*pairs, strict=True)]
    )
