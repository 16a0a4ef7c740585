"""Scores of stored reconstructions, read as absolute maps and as difference images.

The published NOSER and TV rows (RIE above 1, PSNR below 0 dB) are worse than the constant image 0.
A difference image whose background was left out scores like that against an absolute map. Here the
stored reconstructions are scored in both ways; the result can be consistent with the published
rows, and proves nothing.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from scipy.optimize import brentq

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.image_metrics import image_figures
from eitbench.benchmark.rundir.run_arrays import Scene
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError

Way = Callable[[Array, float], Array]
"""Makes what is scored of images (k, H, W) over a background [S/m]."""
FIGURES = ("ssim", "cc", "rie", "psnr")
_BLOCK = 500


Readings = dict[str, dict[str, float]]
"""Means by a name of `FIGURES`, by the name of what was scored."""
Images = tuple[Run, str, str]
"""Run, scenario of known conductivity and method whose images are read; all must be valid."""


def _blocks(run: Run, scenario: str, method: str) -> Iterator[tuple[Scene, Array, Array]]:
    """Scene, truth and estimates (k, H, W) [S/m] of a few samples at a time."""
    numbers = np.sort(run.cell(scenario, method)["sample"].to_numpy())
    for start in range(0, len(numbers), _BLOCK):
        block = numbers[start : start + _BLOCK].tolist()
        scene = run.scene(scenario, block)
        images = run.estimates(scenario, method, block)
        if scene.truth is None or images is None:
            raise DataCorruptError(
                f"{run.path} does not hold the images of {method!r} on {scenario!r} with their "
                "truth: run again."
            )
        yield scene, scene.truth, images.astype(np.float64)


def read_both_ways(images: Images, published_rie: float) -> tuple[Readings, float | None]:
    """Score what a method reconstructed as absolute maps and as difference images.

    The readings are the images as they are, the difference from the background, the difference with
    its sign reversed, and, if there is a factor that gives it the published RIE, the difference
    times that factor, which is returned, too.

    Raises:
        DataCorruptError: the run does not hold the images.
    """
    readings = _read(
        images,
        {
            "absolute map": lambda image, _: image,
            "difference image": lambda image, background: image - background,
            "difference, sign reversed": lambda image, background: background - image,
        },
    )
    factor = matching_factor(*_products(images), published_rie)
    if factor is not None:
        name = f"difference, {factor:.2g} times as strong"
        readings |= _read(images, {name: lambda image, background: factor * (image - background)})
    return readings, factor


def read_constants(images: Images) -> Readings:
    """Scores of constant images on the same truths, which say what the figures are worth.

    Raises:
        DataCorruptError: the run does not hold the images.
    """
    return _read(
        images,
        {
            "the constant image 0": lambda image, _: np.zeros_like(image),
            "the constant background": np.full_like,
        },
    )


def matching_factor(tt: Array, td: Array, dd: Array, rie: float) -> float | None:
    """Find c > 0 for which the mean of ||t - c d|| / ||t|| is `rie`, given products <., .> (n,).

    The mean is convex in c and 1 at c = 0, so that there is one such c where `rie` is above 1.
    None where that is not so or every d is zero.
    """
    if rie <= 1 or not (dd > 0).any():
        return None

    def excess(c: float) -> float:
        squares = np.maximum(tt - 2 * c * td + c**2 * dd, 0)
        return float(np.mean(np.sqrt(squares / tt))) - rie

    high = 1.0
    while excess(high) < 0:
        high *= 2
    return float(brentq(excess, 0.0, high))


def implied_rms(rie: float, psnr: float) -> float:
    """Root mean square of the truth over the data range, from a method's mean RIE and mean PSNR.

    For one image, PSNR = -20 log10(RIE rms(t) / L). For means it is exact where all images have
    the same RIE, and else too small, since the mean of logarithms is below the logarithm of the
    mean.
    """
    return float(10 ** (-psnr / 20) / rie)


def _read(images: Images, ways: Mapping[str, Way]) -> Readings:
    parts: dict[str, list[dict[str, Array]]] = {name: [] for name in ways}
    for scene, truth, estimate in _blocks(*images):
        for name, way in ways.items():
            read = way(estimate, scene.background)
            parts[name].append(image_figures(truth, read, scene.data_range, scene.mask))
    return {
        name: {f: float(np.concatenate([of[f] for of in all_of]).mean()) for f in FIGURES}
        for name, all_of in parts.items()
    }


def _products(images: Images) -> tuple[Array, Array, Array]:
    """<t, t>, <t, d> and <d, d> (n,) over the sensor, of truth t and difference image d."""
    parts = []
    for scene, truth, estimate in _blocks(*images):
        t, d = truth[:, scene.mask], estimate[:, scene.mask] - scene.background
        parts.append([np.einsum("ij,ij->i", a, b) for a, b in ((t, t), (t, d), (d, d))])
    tt, td, dd = np.concatenate(parts, axis=1)
    return tt, td, dd
