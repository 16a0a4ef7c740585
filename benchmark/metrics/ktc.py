"""The score of the Kuopio Tomography Challenge 2023: three classes by Otsu's rule, then an SSIM.

Source: M. Räsänen et al., Kuopio Tomography Challenge 2023, Zenodo, doi:10.5281/zenodo.8252370: the
organisers' scoring functions. Ours agree with them to rounding.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from eitbench.scenarios.arrays import Array

SIDE = 256
"""Side [pixels] of the images that the challenge scores."""
_BINS = 256
_RADIUS = 80  # standard deviation of the window [pixels]; it is cut off at twice as much
_C1, _C2 = 1e-4, 9e-4

Classes = NDArray[np.int8]


def ktc_score(truth: ArrayLike, contrast: ArrayLike) -> Array:
    """Score (n,) of images of contrast (n, H, W) [S/m], by classes `truth` (n, 256, 256).

    The images are brought to 256 x 256 pixels by linear interpolation (a method that works on other
    pixels than the challenge's has to be read somewhere between them), cut into classes by
    `segmented`, and scored by `score_of_classes`. Classes are -1 resistive, 0 background,
    +1 conductive.
    """
    return np.array(
        [
            score_of_classes(known, segmented(enlarged(image)))
            for known, image in zip(np.asarray(truth), np.asarray(contrast), strict=True)
        ]
    )


def enlarged(image: Array) -> Array:
    """An image (H, W) on 256 x 256 pixels of the same square, by linear interpolation."""
    rows, columns = ((np.arange(SIDE) + 0.5) * size / SIDE - 0.5 for size in image.shape)
    places = np.meshgrid(rows, columns, indexing="ij")
    return np.asarray(ndimage.map_coordinates(image, places, order=1, mode="nearest"))


def segmented(image: Array) -> Classes:
    """Classes (H, W) of an image by the challenge's rule: the largest class is the background.

    Otsu's method puts two thresholds into a histogram of 256 bins, so that the variance between
    three classes is largest. What is below the background is resistive, what is above conductive.
    """
    counts, edges = np.histogram(image, _BINS)
    low, high = ((edges[:-1] + edges[1:]) / 2)[_thresholds(counts)]
    part = np.where(image < low, 0, np.where(image > high, 2, 1))
    background = np.argmax(np.bincount(part.ravel(), minlength=3))
    return np.asarray(np.sign(part - background), dtype=np.int8)


def _thresholds(counts: NDArray[np.int_]) -> list[int]:
    """Bins whose middles divide a histogram `counts` (256,) into three classes.

    The last of equal maxima counts, as in the challenge's code. An image of fewer than three values
    has no three classes: then the fullest bin is divided from the rest.
    """
    number = np.arange(1, _BINS + 1)
    total = np.concatenate([[0], np.cumsum(counts)])
    moment = np.concatenate([[0], np.cumsum(number * counts)])
    mean = moment[-1] / total[-1]
    # The classes are the bins [:j], [j:i] and [i:].
    j, i = np.meshgrid(np.arange(1, _BINS), np.arange(1, _BINS))
    between = np.zeros(j.shape)
    possible = j < i
    for start, end in ((np.zeros_like(j), j), (j, i), (i, np.full_like(i, _BINS))):
        weight = total[end] - total[start]
        possible &= weight > 0
        centre = (moment[end] - moment[start]) / np.maximum(weight, 1)
        between += weight * (centre - mean) ** 2
    if not possible.any():
        fullest = int(np.argmax(counts))
        return [fullest, fullest]
    between[~possible] = -1
    row, column = np.argwhere(between == between.max())[-1]
    return [int(column), int(row)]


def score_of_classes(truth: ArrayLike, found: ArrayLike) -> float:
    """Mean of the SSIM of the conductive and of the resistive pixels, both classes (256, 256)."""
    t, f = np.asarray(truth), np.asarray(found)
    return float(np.mean([_ssim(t == of, f == of) for of in (1, -1)]))


def _ssim(truth: NDArray[np.bool_], found: NDArray[np.bool_]) -> float:
    """Mean SSIM of two masks (256, 256), in Gaussian windows that are cut off at the image's rim.

    Source: Wang et al., IEEE Trans. Image Process. 13 (2004) 600, eq. 13.
    """
    t, f = truth.astype(float), found.astype(float)
    window = _window()
    mean_t, mean_f, both = (window @ of @ window.T for of in (t, f, t * f))
    # A mask is its own square.
    variances = mean_t - mean_t**2 + mean_f - mean_f**2
    covariance = both - mean_t * mean_f
    top = (2 * mean_t * mean_f + _C1) * (2 * covariance + _C2)
    return float(np.mean(top / ((mean_t**2 + mean_f**2 + _C1) * (variances + _C2))))


@cache
def _window() -> Array:
    """(256, 256): the weights of all pixels of a line in the window around each of them."""
    distance = np.subtract.outer(np.arange(SIDE), np.arange(SIDE))
    weights = np.exp(-((distance / _RADIUS) ** 2) / 2) * (abs(distance) <= 2 * _RADIUS)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
