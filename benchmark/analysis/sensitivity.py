"""How the order of methods depends on choices inside the metrics: window, data range, mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.stats import kendalltau

from eitbench.benchmark.metrics import image_metrics as metrics

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eitbench.benchmark.analysis.results import Run, Scene

SAMPLES = 100
"""Of a scenario, spread evenly over it: enough to order methods, and read in a second."""

RIM = 0.1
"""Share of the image's side that the narrower mask leaves out along the sensor's edge."""


@dataclass(frozen=True)
class MetricVariant:
    """One way to compute SSIM, CC, RIE and PSNR.

    Attributes:
        says: how it differs from the benchmark's own.
        window: side of SSIM's window [pixels].
        range_factor: the data range over the sensor's.
        rim: share of the image's side that is left out along the edge.
    """

    says: str
    window: int = metrics.WINDOW
    range_factor: float = 1.0
    rim: float = 0.0


METRIC_VARIANTS = (
    MetricVariant("as in this benchmark"),
    MetricVariant("SSIM window 5 x 5", window=5),
    MetricVariant("SSIM window 11 x 11", window=11),
    MetricVariant("data range halved", range_factor=0.5),
    MetricVariant("data range doubled", range_factor=2.0),
    MetricVariant(f"rim of {RIM:.0%} left out", rim=RIM),
)


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What one choice does to the order of methods.

    Attributes:
        says: the choice.
        score, ssim: mean of each method, by name.
        score_tau, ssim_tau: Kendall's tau between its order of methods by S, by SSIM, and that of
            the benchmark's own choice; NaN for fewer than two methods.
    """

    says: str
    score: dict[str, float]
    ssim: dict[str, float]
    score_tau: float
    ssim_tau: float


def sensitivity(methods: Mapping[str, tuple[Run, str]], scenario: str) -> list[Sensitivity]:
    """Mean figures for each of `METRIC_VARIANTS`; nothing without a true conductivity.

    Args:
        methods: the run and the name of each method, by what it is to be called; the runs are of
            the same data.
        scenario: its name.

    Raises:
        DataCorruptError: the images of a run cannot be read.
    """
    cells = {label: run.cell(scenario, name) for label, (run, name) in methods.items()}
    held = [set(cell["sample"]) for cell in cells.values()]
    known = (
        np.sort(np.array(list(set.intersection(*held)), dtype=np.int64)) if held else np.empty(0)
    )
    if not len(known):
        return []
    chosen = known[np.unique(np.linspace(0, len(known) - 1, SAMPLES).astype(int))].tolist()
    scene = next(iter(methods.values()))[0].scene(scenario, chosen)
    if scene.truth is None or scene.has_classes:
        return []
    images = {}
    for label, (run, name) in methods.items():
        stored = run.estimates(scenario, name, chosen)
        if stored is not None:
            stored[~np.isfinite(stored[:, scene.mask]).all(axis=1)] = scene.background
            images[label] = stored
    means = [_means(choice, scene, images) for choice in METRIC_VARIANTS]
    return [
        Sensitivity(
            choice.says, *found, *(_tau(a, b) for a, b in zip(found, means[0], strict=True))
        )
        for choice, found in zip(METRIC_VARIANTS, means, strict=True)
    ]


def _means(
    choice: MetricVariant, scene: Scene, images: Mapping[str, NDArray[np.float32]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Mean S and SSIM of each method."""
    mask = scene.mask
    if choice.rim:
        margin = round(choice.rim * max(mask.shape))
        mask = binary_erosion(mask, np.ones((3, 3), dtype=bool), iterations=margin, border_value=0)
    data_range = choice.range_factor * scene.data_range
    truth = scene.truth
    assert truth is not None
    score, ssim = {}, {}
    for method, estimate in images.items():
        similarity = metrics.ssim(truth, estimate, data_range, mask, window=choice.window)
        ssim[method] = float(similarity.mean())
        score[method] = float(
            metrics.score(
                similarity,
                metrics.cc(truth, estimate, mask),
                metrics.rie(truth, estimate, mask),
                metrics.psnr(truth, estimate, data_range, mask),
            ).mean()
        )
    return score, ssim


def _tau(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    if len(one) < 2:
        return float("nan")
    return float(kendalltau(list(one.values()), [other[name] for name in one]).statistic)
