from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from skimage import metrics as skimage_metrics

from eitbench.benchmark import metrics
from eitbench.benchmark.metrics.image_metrics import PSNR_CEILING_DB
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import is_constant

Array = NDArray[np.float64]
# Without annotations of their own.
structural_similarity: Any = skimage_metrics.structural_similarity
peak_signal_noise_ratio: Any = skimage_metrics.peak_signal_noise_ratio


def images(n: int, height: int, width: int, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    truth = np.ones((n, height, width))
    truth[:, height // 4 : height // 2, width // 3 :] = rng.uniform(0.1, 0.9, (n, 1, 1))
    return truth, truth + 0.1 * rng.standard_normal(truth.shape)


@settings(deadline=None)
@given(
    n=st.integers(0, 25),
    height=st.integers(11, 30),
    width=st.integers(11, 30),
    data_range=st.sampled_from([0.02, 1.0, 1.5, 300.0]),
    window=st.sampled_from([7, 3, 5, 11]),
    seed=st.integers(0, 99),
)
def test_ssim_is_scikit_image_s(
    n: int, height: int, width: int, data_range: float, window: int, seed: int
) -> None:
    truth, estimate = images(n, height, width, seed)
    expected = [
        structural_similarity(t, p, data_range=data_range, win_size=window)
        for t, p in zip(truth, estimate, strict=True)
    ]
    ours = metrics.ssim(truth, estimate, data_range, window=window)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-10)


def test_ssim_on_a_mask_averages_the_windows_wholly_inside() -> None:
    truth, estimate = images(9, 24, 31)
    y, x = np.mgrid[:24, :31]
    mask = np.hypot(y - 11.5, x - 15) < 11
    expected = []
    for t, p in zip(truth, estimate, strict=True):
        _, full = structural_similarity(t, p, data_range=1.0, full=True)
        centres = [
            (i, j)
            for i in range(3, 21)
            for j in range(3, 28)
            if mask[i - 3 : i + 4, j - 3 : j + 4].all()
        ]
        expected.append(np.mean([full[i, j] for i, j in centres]))
    truth[:, ~mask] = np.nan
    estimate[:, ~mask] = np.inf
    ours = metrics.ssim(truth, estimate, 1.0, mask)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-10)


def test_pixel_metrics_follow_their_formulas_on_a_mask() -> None:
    truth, estimate = images(200, 12, 15)
    mask = np.random.default_rng(1).random((12, 15)) < 0.6
    cc, rie, psnr = [], [], []
    for t, p in zip(truth[:, mask], estimate[:, mask], strict=True):
        cc.append(np.corrcoef(t, p)[0, 1])
        rie.append(np.linalg.norm(p - t) / np.linalg.norm(t))
        psnr.append(peak_signal_noise_ratio(t, p, data_range=0.9))
    truth[:, ~mask] = np.nan
    np.testing.assert_allclose(metrics.cc(truth, estimate, mask), cc, rtol=1e-12)
    np.testing.assert_allclose(metrics.rie(truth, estimate, mask), rie, rtol=1e-12)
    np.testing.assert_allclose(metrics.psnr(truth, estimate, 0.9, mask), psnr, rtol=1e-12)


def test_a_perfect_image_has_the_best_finite_figures() -> None:
    truth, _ = images(3, 16, 16)
    np.testing.assert_allclose(metrics.ssim(truth, truth, 1.0), 1.0)
    np.testing.assert_allclose(metrics.cc(truth, truth), 1.0)
    assert (metrics.rie(truth, truth) == 0).all()
    assert (metrics.psnr(truth, truth, 1.0) == PSNR_CEILING_DB).all()
    np.testing.assert_allclose(metrics.psnr(truth, truth.astype(np.float32), 1.0), PSNR_CEILING_DB)


@pytest.mark.parametrize("level", [0.0, 0.1, 1.0, 0.3333333])
def test_a_constant_image_has_correlation_zero(level: float) -> None:
    truth, estimate = images(2, 16, 16)
    constant = np.full_like(truth, level)
    mask = np.ones((16, 16), dtype=bool)
    mask[0, 0] = False
    constant[:, 0, 0] = 7.0
    assert (metrics.cc(truth, constant, mask) == 0).all()
    assert (metrics.cc(constant, estimate, mask) == 0).all()
    assert is_constant(constant, mask).all()
    assert not is_constant(constant).any()


def test_bad_input_is_one_clear_sentence() -> None:
    truth, estimate = images(2, 16, 16)
    with pytest.raises(InputError, match=r"\(2, 16, 16\) and \(1, 16"):
        metrics.ssim(truth, estimate[:1], 1.0)
    with pytest.raises(InputError, match="data range"):
        metrics.psnr(truth, estimate, 0.0)
    with pytest.raises(InputError, match="mask"):
        metrics.cc(truth, estimate, np.zeros((16, 16), dtype=bool))
    with pytest.raises(InputError, match="7 x 7 pixels"):
        metrics.ssim(truth, estimate, 1.0, np.eye(16, dtype=bool))
    with pytest.raises(InputError, match="7 x 7 pixels"):
        metrics.ssim(truth[:, :6], estimate[:, :6], 1.0)
    for window in (1, 6):
        with pytest.raises(InputError, match=f"odd side of at least 3 pixels, got {window}"):
            metrics.ssim(truth, estimate, 1.0, window=window)
    with pytest.raises(InputError, match="RIE"):
        metrics.rie(0 * truth, estimate)
    estimate[1, 3, 3] = np.nan
    for metric in (metrics.cc, metrics.rie):
        with pytest.raises(InputError, match="image 1"):
            metric(truth, estimate)
    for of_range in (metrics.ssim, metrics.psnr):
        with pytest.raises(InputError, match="image 1"):
            of_range(truth, estimate, 1.0)
