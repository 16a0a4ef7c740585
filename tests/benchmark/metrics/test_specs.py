"""The scores S and B from the four figures of an image."""

import numpy as np
import pytest

from eitbench.benchmark.metrics.specs import ANCHORS, anchored, bounded_score, score

PERFECT = {"ssim": 1.0, "cc": 1.0, "rie": 0.0, "psnr": 40.0}
WORST = {"ssim": 0.0, "cc": 0.0, "rie": 1.0, "psnr": 0.0}


def test_figures_lie_between_their_anchors_and_not_beyond() -> None:
    assert {name: worst for name, (worst, _) in ANCHORS.items()} == WORST
    assert {name: best for name, (_, best) in ANCHORS.items()} == PERFECT
    half = {name: (PERFECT[name] + WORST[name]) / 2 for name in PERFECT}
    np.testing.assert_allclose(anchored(half), 0.5)
    better = {"ssim": 1.0, "cc": 1.0, "rie": -0.5, "psnr": 60.0}
    worse = {"ssim": -1.0, "cc": -1.0, "rie": 3.0, "psnr": -20.0}
    np.testing.assert_array_equal(anchored(better), 1)
    np.testing.assert_array_equal(anchored(worse), 0)


def test_b_is_the_mean_of_the_four_and_s_as_published() -> None:
    many = {name: np.array([PERFECT[name], WORST[name]]) for name in PERFECT}
    np.testing.assert_allclose(bounded_score(many), [1, 0])
    assert float(bounded_score({**PERFECT, "psnr": 20.0})) == pytest.approx(0.875)
    # The published PhyDNN: 0.25 (0.9765 + 0.9880 + 33.2950) - 0.25 * 0.0290.
    found = score(ssim=0.9765, cc=0.9880, rie=0.0290, psnr=33.2950)
    assert found == pytest.approx(8.807625)
