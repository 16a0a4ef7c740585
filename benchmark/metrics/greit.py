"""GREIT's figures of merit of images of a single small target.

As defined by Adler et al., Physiol. Meas. 30 (2009) S35, section 3, and computed by EIDORS'
`eval_GREIT_fig_merit` and `calc_noise_figure`, whose values the tests repeat.
"""

from dataclasses import dataclass

import numpy as np

from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.phantoms.contacts import AMPLITUDE_FRACTION


@dataclass(frozen=True, eq=False)
class GreitFigures:
    """Figures of merit of n images; NaN where an image is nowhere positive.

    Attributes:
        amplitude: (n,) sum of the image over the sensor [S/m].
        position_error: (n,) distance of the target from the centre minus that of its image [m];
            positive where the image lies nearer to the centre.
        resolution: (n,) root of the share of the sensor that the image of the target covers.
        shape_deformation: (n,) share of that area outside the circle of equal area around its
            centre.
        ringing: (n,) negative sum outside that area over the sum inside.
    """

    amplitude: Array
    position_error: Array
    resolution: Array
    shape_deformation: Array
    ringing: Array


def greit_figures(
    images: Array, target: Array, x: Array, y: Array, mask: Mask, pixel_area: float
) -> GreitFigures:
    """Return the figures of merit of single targets.

    The image of a target is its quarter-amplitude set: the pixels of at least a quarter of the
    largest value.

    Args:
        images: (n, H, W) change of the conductivity [S/m], of the sign that makes targets positive.
        target: (n, 2) true x and y of the targets from the sensor's centre [m].
        x: (H, W) of the pixels from the sensor's centre [m]; so is `y`.
        mask: (H, W) pixels of the sensor.
        pixel_area: [m^2].
    """
    inside = np.where(mask, images, 0.0)
    peak = inside.max(axis=(1, 2))
    seen = mask & (inside >= AMPLITUDE_FRACTION * peak[:, None, None]) & (peak > 0)[:, None, None]
    pixels = seen.sum(axis=(1, 2)).astype(np.float64)
    pixels[pixels == 0] = np.nan
    centre_x, centre_y = ((seen * axis).sum(axis=(1, 2)) / pixels for axis in (x, y))
    squared = (x - centre_x[:, None, None]) ** 2 + (y - centre_y[:, None, None]) ** 2
    circle = squared < (pixel_area * pixels / np.pi)[:, None, None]
    negative = (inside * ((inside < 0) & ~seen)).sum(axis=(1, 2))
    return GreitFigures(
        amplitude=np.where(peak > 0, inside.sum(axis=(1, 2)), np.nan),
        position_error=np.hypot(*np.transpose(target)) - np.hypot(centre_x, centre_y),
        resolution=np.sqrt(pixels / mask.sum()),
        shape_deformation=(seen & ~circle).sum(axis=(1, 2)) / pixels,
        ringing=-negative / np.where(peak > 0, (inside * seen).sum(axis=(1, 2)), np.nan),
    )


def mean_magnitude(values: Array) -> Array:
    """Mean of |values| (n, P) over the measurements or pixels P: (n,)."""
    return np.asarray(np.abs(values).mean(axis=1))


def spread(values: Array) -> Array:
    """Standard deviation of `values` (n, P) over the measurements or pixels P: (n,)."""
    return np.asarray(np.std(values, axis=1, ddof=1))


def noise_figure(change: Array, noise: Array, image: Array, image_noise: Array) -> float:
    """Return the signal-to-noise ratio of the data over that of the image; 1 amplifies no noise.

    All are averaged over repetitions.

    Args:
        change: `mean_magnitude` (n,) of the change of the voltages by the target [V/A].
        noise: `spread` (k,) of changes of voltages without a target [V/A].
        image: `mean_magnitude` (m,) of images of the target [S/m].
        image_noise: `spread` (l,) of images without a target [S/m].
    """
    return float(change.mean() / noise.mean() / (image.mean() / image_noise.mean()))
