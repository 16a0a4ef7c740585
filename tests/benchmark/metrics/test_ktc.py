"""The challenge's score against numbers of its organisers' own functions.

The numbers are those of `KTCScoring.py` of the challenge's Python codes (Zenodo 8252370, commit
186c572f of CUQI-DTU/KTC2023-CUQI1) on the images below, with its convolution done by fast Fourier
transforms. Without that change, the organisers' baseline images of targets 1 of levels 1, 4 and 7
(commit 0c98eb80 of LJK666666666/EIT_KTC2023_4) score the same to 3e-16.
"""

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from skimage.filters import threshold_multiotsu

from eitbench.benchmark.metrics.evaluation import GroundTruth, evaluate
from eitbench.benchmark.metrics.ktc import enlarged, ktc_score, score_of_classes, segmented
from eitbench.reports.tables.challenge import PUBLISHED, challenge_rows, challenge_table
from eitbench.scenarios.arrays import nearest_pixels
from eitbench.scenarios.recordings.public.kuopio import tank

ROW, COLUMN = np.mgrid[:256, :256]


def targets() -> NDArray[np.int8]:
    """A conductive disc and a resistive rectangle."""
    truth = np.zeros((256, 256), dtype=np.int8)
    truth[np.hypot(ROW - 90, COLUMN - 110) < 30] = 1
    truth[(abs(ROW - 170) < 20) & (abs(COLUMN - 140) < 35)] = -1
    return truth


def blurred() -> NDArray[np.float64]:
    """What a method may show of them: two bumps elsewhere, and a slope."""
    one = np.exp(-((ROW - 96) ** 2 + (COLUMN - 104) ** 2) / (2 * 24**2))
    other = np.exp(-((ROW - 168) ** 2 + (COLUMN - 146) ** 2) / (2 * 26**2))
    return np.asarray(one - 0.8 * other + 0.0005 * (ROW - 128))


def test_two_kinds_of_objects_score_as_the_organisers_say() -> None:
    found = segmented(blurred())
    assert [(found == of).sum() for of in (-1, 0, 1)] == [4555, 56890, 4091]
    assert score_of_classes(targets(), found) == pytest.approx(0.6723941320825177, abs=1e-9)
    assert ktc_score(targets()[None], blurred()[None]) == pytest.approx(0.6723941320825177)


def test_where_the_background_is_lowest_all_else_conducts() -> None:
    found = segmented(np.clip(blurred(), 0, None))
    truth = np.clip(targets(), 0, None)
    assert [(found == of).sum() for of in (0, 1)] == [59910, 3484 + 2142]
    assert score_of_classes(truth, found) == pytest.approx(0.7666982771792736, abs=1e-9)
    assert score_of_classes(truth, np.zeros_like(truth)) == pytest.approx(
        0.5018738765707507, abs=1e-9
    )


def test_thresholds_are_those_of_otsu() -> None:
    """Within one of the 256 bins of scikit-image's, whose classes end at the middles of bins."""
    image = blurred()
    low, high = threshold_multiotsu(image, classes=3, nbins=256)  # type: ignore[no-untyped-call]
    found, step = segmented(image), np.ptp(image) / 256
    assert image[found == -1].max() == pytest.approx(low, abs=1.5 * step)
    assert image[found == 1].min() == pytest.approx(high, abs=1.5 * step)


def test_certain_classes_stay_as_they_are() -> None:
    truth = targets()
    assert (segmented(0.9 * truth.astype(np.float64)) == truth).all()
    assert ktc_score(truth[None], 1e-3 * truth[None]) == pytest.approx(1)
    only = np.minimum(truth, 0)  # two values make no three classes
    assert (segmented(0.5 * only.astype(np.float64)) == only).all()
    assert (segmented(np.zeros((256, 256))) == 0).all()


def test_an_image_is_enlarged_on_the_same_ground() -> None:
    x = (np.arange(80) + 0.5) / 80
    plane = 2 * x[:, None] - 3 * x[None, :]
    fine = (np.arange(256) + 0.5) / 256
    expected = 2 * fine[:, None] - 3 * fine[None, :]
    inside = slice(2, -2)  # beyond the outermost middles the nearest value is kept
    assert enlarged(plane)[inside, inside] == pytest.approx(expected[inside, inside], abs=1e-12)


def test_nothing_outside_the_tank_counts() -> None:
    sensor, truth = tank(7), targets()
    coarse = nearest_pixels(truth, sensor.image_shape)
    samples = pd.DataFrame({"sample": [0]})
    known = GroundTruth("level", sensor, samples, "classes", classes=truth[None])
    image = 1 + 0.5 * coarse[None]
    (clean,) = evaluate(known, image)["ktc_score"]
    assert clean > 0.97
    (same,) = evaluate(known, np.where(sensor.mask, image, 7.0))["ktc_score"]
    assert same == clean


def test_the_board_sums_scores_over_all_targets() -> None:
    rows = [
        {"method": name, "track": "default", "run": "r", "n": 3, "ktc_score": score,
         "scenario": f"ktc2023-level{level}"}
        for name, score in (("good", 0.9), ("poor", 0.1))
        for level in range(1, 8)
    ]  # fmt: skip
    board = challenge_rows(rows)
    assert [row.method for row in board] == ["good", *PUBLISHED, "poor"]
    assert board[0].total == pytest.approx(0.9 * 21)
    assert challenge_table(board)[2][:2] == ["Post-processing U-Net", "published"]
    assert not challenge_rows(rows[:6])  # a level is missing


def test_published_sums_are_those_of_their_levels() -> None:
    """To rounding; the paper's levels of team DTU add up to 0.07 less than its sum."""
    for name, (*levels, total) in PUBLISHED.items():
        assert sum(levels) == pytest.approx(total, abs=0.075 if name == "Team DTU" else 0.04)
