"""Two readings of stored images, beside the metrics of images made by hand."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eitbench.benchmark import metrics
from eitbench.benchmark.analysis import difference_images
from eitbench.benchmark.analysis.difference_images import (
    FIGURES,
    implied_rms,
    matching_factor,
    read_both_ways,
    read_constants,
)
from eitbench.benchmark.analysis.results import read_run
from eitbench.scenarios.data.datasets import Dataset


@pytest.fixture
def run(build: Any, paper: Dataset) -> Path:
    """NOSER with half of the contrast, TV that saw nothing."""
    truth = np.array(paper.conductivity)
    build.suite = "paper"
    build.add(paper, "noser", 0.5 * (truth - 1) + 1)
    build.add(paper, "tv", np.ones_like(truth))
    path: Path = build.write()
    return path


def means(truth: Any, images: Any, dataset: Dataset) -> list[float]:
    sensor = dataset.sensor
    figures = metrics.image_figures(truth, images, sensor.data_range, sensor.mask)
    return [float(values.mean()) for values in figures.values()]


@pytest.mark.parametrize("block", [3, 500])
def test_every_reading_is_what_its_name_says(
    block: int, run: Path, paper: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(difference_images, "_BLOCK", block)
    truth = np.array(paper.conductivity)
    contrast = (0.5 * (truth - 1) + 1).astype(np.float32).astype(float) - 1
    found, factor = read_both_ways((read_run(run), "paper", "noser"), 1.5)
    assert factor is not None
    expected = [contrast + 1, contrast, -contrast, factor * contrast]
    for figures, images in zip(found.values(), expected, strict=True):
        assert list(figures) == list(FIGURES)
        assert list(figures.values()) == pytest.approx(means(truth, images, paper))
    assert found["difference image"]["cc"] == pytest.approx(found["absolute map"]["cc"])
    assert figures["rie"] == pytest.approx(1.5)


def test_constants_on_the_same_truth(run: Path, paper: Dataset) -> None:
    zero, background = read_constants((read_run(run), "paper", "tv")).values()
    truth = np.array(paper.conductivity)
    assert zero["rie"] == 1
    level = np.sqrt(np.mean(truth**2, axis=(1, 2)))
    assert zero["psnr"] == pytest.approx(np.mean(-20 * np.log10(level)))
    assert list(background.values()) == pytest.approx(means(truth, np.ones_like(truth), paper))


@settings(max_examples=50)
@given(
    arrays(np.float64, (4, 12), elements=st.floats(0.1, 1)),
    arrays(np.float64, (4, 12), elements=st.floats(-1, 1)),
    st.floats(1.001, 5),
)
def test_the_factor_gives_the_rie_that_was_asked_for(t: Any, d: Any, rie: float) -> None:
    tt, td, dd = (np.sum(a * b, axis=1) for a, b in ((t, t), (t, d), (d, d)))
    assume((dd > 1e-6).any())
    factor = matching_factor(tt, td, dd, rie)
    assert factor is not None
    assert factor > 0
    error = np.linalg.norm(t - factor * d, axis=1) / np.linalg.norm(t, axis=1)
    assert error.mean() == pytest.approx(rie, rel=1e-6)


@pytest.mark.parametrize(("rie", "dd"), [(1.0, 1.0), (0.9, 1.0), (1.2, 0.0)])
def test_sometimes_there_is_no_factor(rie: float, dd: float) -> None:
    assert matching_factor(np.ones(3), np.zeros(3), np.full(3, dd), rie) is None


@given(arrays(np.float64, (1, 6, 6), elements=st.floats(0.1, 1)), st.floats(-1, 2))
def test_rie_and_psnr_of_an_image_tell_the_rms_of_its_truth(truth: Any, level: float) -> None:
    image = np.full_like(truth, level)
    (rie,), (psnr,) = metrics.rie(truth, image), metrics.psnr(truth, image, 2.0)
    if rie > 1e-3:
        assert implied_rms(rie, psnr) == pytest.approx(np.sqrt(np.mean(truth**2)) / 2, rel=1e-6)


def test_means_of_unlike_errors_imply_no_more_than_the_rms() -> None:
    truth = np.full((2, 4, 4), 0.8)
    image = truth + np.array([0.01, 0.5])[:, None, None]
    rie, psnr = metrics.rie(truth, image).mean(), metrics.psnr(truth, image, 1.0).mean()
    assert implied_rms(rie, psnr) < 0.8


def test_the_published_classical_rows_imply_one_truth() -> None:
    """Both are about 0.94 of the data range, which no contrast of a touch is."""
    assert implied_rms(1.21, -1.08) == pytest.approx(0.936, abs=1e-3)
    assert implied_rms(1.57, -3.35) == pytest.approx(0.937, abs=1e-3)
