"""Sensitivity of the order of methods to choices in the metrics: window, data range, mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.stats import kendalltau

from eitbench.benchmark.metrics.image_metrics import WINDOW, cc, psnr, rie, ssim, windows_inside
from eitbench.benchmark.metrics.specs import score

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eitbench.benchmark.analysis.results import Run
    from eitbench.benchmark.rundir.run_arrays import Scene

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
    window: int = WINDOW
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
    """The order of methods under one variant of the metrics.

    Attributes:
        says: the variant.
        score, ssim: mean of each method, by name.
        score_tau, ssim_tau: Kendall's tau between its order of methods by S, by SSIM, and that of
            the benchmark's own metrics; NaN for fewer than two methods.
    """

    says: str
    score: dict[str, float]
    ssim: dict[str, float]
    score_tau: float
    ssim_tau: float


def sensitivity(
    methods: Mapping[str, tuple[Run, str]], scenario: str, samples: int = SAMPLES
) -> list[Sensitivity]:
    """Mean figures for each of `METRIC_VARIANTS`; nothing without a true conductivity.

    `methods` holds the run and the name of each method, by what it is to be called; the runs are of
    the same data. The figures are of so many `samples`, spread over all. Variants for which an
    image is too small are left out.

    Raises:
        DataCorruptError: the images of a run cannot be read.
    """
    if not all(run.whole for run, _ in methods.values()):
        return []
    held = [set(run.cell(scenario, name)["sample"]) for run, name in methods.values()]
    known = np.array(sorted(set.intersection(*held)) if held else [], dtype=np.int64)
    if not len(known):
        return []
    chosen = known[np.unique(np.linspace(0, len(known) - 1, samples).astype(int))].tolist()
    scene = next(iter(methods.values()))[0].scene(scenario, chosen)
    if scene.truth is None or scene.has_classes:
        return []
    images = {}
    for label, (run, name) in methods.items():
        stored = run.estimates(scenario, name, chosen)
        if stored is not None:
            stored[~np.isfinite(stored[:, scene.mask]).all(axis=1)] = scene.background
            images[label] = stored
    alike: Alike = {}
    variants = [
        variant
        for variant in METRIC_VARIANTS
        if windows_inside(_inner(variant, scene.mask), variant.window).any()
    ]
    means = [_means(variant, scene, images, alike) for variant in variants]
    return [
        Sensitivity(
            variant.says, *found, *(_tau(a, b) for a, b in zip(found, means[0], strict=True))
        )
        for variant, found in zip(variants, means, strict=True)
    ]


def _inner(variant: MetricVariant, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The pixels of `mask` (H, W) that are not in the rim that a variant leaves out."""
    margin = round(variant.rim * max(mask.shape))
    if not margin:  # SciPy's 0 means: until nothing changes
        return mask
    square = np.ones((3, 3), dtype=bool)
    return np.asarray(binary_erosion(mask, square, iterations=margin, border_value=0))


Alike = dict[tuple[str, float], dict[str, NDArray[np.float64]]]
"""CC and RIE by method and rim: they depend on neither the window nor the data range."""


def _means(
    variant: MetricVariant,
    scene: Scene,
    images: Mapping[str, NDArray[np.float32]],
    alike: Alike,
) -> tuple[dict[str, float], dict[str, float]]:
    """Return mean S and mean SSIM of each method, by its name; what is new goes into `alike`."""
    mask = _inner(variant, scene.mask)
    data_range = variant.range_factor * scene.data_range
    truth = scene.truth
    assert truth is not None
    scores, similarities = {}, {}
    for method, estimate in images.items():
        if (method, variant.rim) not in alike:
            both = {"cc": cc(truth, estimate, mask), "rie": rie(truth, estimate, mask)}
            alike[method, variant.rim] = both
        similar = ssim(truth, estimate, data_range, mask, window=variant.window)
        ratio = psnr(truth, estimate, data_range, mask)
        scores[method] = float(score(ssim=similar, psnr=ratio, **alike[method, variant.rim]).mean())
        similarities[method] = float(similar.mean())
    return scores, similarities


def _tau(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    if len(one) < 2:
        return float("nan")
    return float(kendalltau(list(one.values()), [other[name] for name in one]).statistic)
