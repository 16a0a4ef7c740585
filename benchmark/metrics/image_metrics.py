"""Image metrics, vectorised over images: SSIM, correlation, relative error and PSNR.

Truth `t` and estimate `p` are absolute conductivity (n, H, W) [S/m] on the same pixels; a mask
(H, W) says which pixels belong to the sensor, and what lies outside it is never looked at.
`eitbench.benchmark.metrics.specs` declares what every metric means.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import is_constant

Images = NDArray[np.floating]

WINDOW = 7
PSNR_CEILING_DB = float(-20 * np.log10(np.finfo(np.float32).eps))
"""138.5 dB: estimates are kept in float32, so a smaller error than its rounding means nothing."""

_BLOCK = 10  # images, small enough for the processor's cache


def windows_inside(mask: Mask, window: int) -> Mask:
    """The windows of SSIM that lie wholly in `mask` (H, W), by their first rows and columns."""
    if min(mask.shape) < window:
        return np.zeros((0, 0), dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(mask, (window, window))
    return np.asarray(windows.all((-2, -1)))


def ssim(
    truth: ArrayLike,
    estimate: ArrayLike,
    data_range: float,
    mask: Mask | None = None,
    *,
    window: int = WINDOW,
) -> Array:
    """Structural similarity (n,) as scikit-image defines it: uniform window, sample covariance.

    The map is averaged over the windows that lie wholly in the mask; for a full mask these are the
    windows that scikit-image averages.

    Source: Wang et al., IEEE Trans. Image Process. 13 (2004) 600, eq. 13.

    Args:
        truth: (n, H, W) [S/m].
        estimate: (n, H, W) [S/m].
        data_range: range of conductivity L [S/m]; the constants are (0.01 L)^2 and (0.03 L)^2.
        mask: (H, W) pixels of the sensor; all by default.
        window: side of the window [pixels], odd.

    Raises:
        InputError: unusable arrays, data range or window, or a mask without room for a window.
    """
    if window < 3 or window % 2 == 0:
        raise InputError(f"The window of SSIM has an odd side of at least 3 pixels, got {window}.")
    t, p, inside = _checked(truth, estimate, mask, data_range)
    n, height, width = t.shape
    windows = windows_inside(inside, window)
    if not windows.any():
        raise InputError(
            f"SSIM needs {window} x {window} pixels inside the sensor; this image of "
            f"{height} x {width} pixels has no such place: use a finer image grid."
        )
    weights = np.zeros((height, width))
    weights[: windows.shape[0], : windows.shape[1]] = windows / windows.sum()
    values = np.empty(n)
    for block in _blocks(0, n, _BLOCK):
        x, y = (np.where(inside, of[block].astype(np.float64), 0.0).ravel() for of in (t, p))
        found = _ssim_maps(x, y, width, window, data_range)
        maps = np.pad(found, (0, len(x) - len(found))).reshape(-1, weights.size)
        values[block] = maps @ weights.ravel()
    return values


def cc(truth: ArrayLike, estimate: ArrayLike, mask: Mask | None = None) -> Array:
    """Pearson correlation (n,) over the pixels of the mask; 0 where an image is constant.

    Raises:
        InputError: unusable arrays.
    """
    t, p, inside = _checked(truth, estimate, mask)
    values = np.zeros(len(t))
    for rows, a, b in _pixels(t, p, inside):
        a = a - a.mean(axis=1, keepdims=True)
        b = b - b.mean(axis=1, keepdims=True)
        norm = np.sqrt(np.einsum("ij,ij->i", a, a) * np.einsum("ij,ij->i", b, b))
        np.divide(np.einsum("ij,ij->i", a, b), norm, out=values[rows], where=norm > 0)
    # The mean of equal numbers is rounded, so a constant image is recognised by its values.
    values[is_constant(t, inside) | is_constant(p, inside)] = 0.0
    return np.clip(values, -1.0, 1.0)


def rie(truth: ArrayLike, estimate: ArrayLike, mask: Mask | None = None) -> Array:
    """Relative image error ||p - t|| / ||t|| (n,) over the pixels of the mask.

    Raises:
        InputError: unusable arrays, or a truth that is zero everywhere.
    """
    t, p, inside = _checked(truth, estimate, mask)
    values = np.empty(len(t))
    for rows, a, b in _pixels(t, p, inside):
        norm = np.linalg.norm(a, axis=1)
        if not (norm > 0).all():
            raise InputError("RIE needs a truth that is not zero everywhere: check its unit.")
        values[rows] = np.linalg.norm(b - a, axis=1) / norm
    return values


def psnr(
    truth: ArrayLike, estimate: ArrayLike, data_range: float, mask: Mask | None = None
) -> Array:
    """10 log10(data_range^2 / mean((p - t)^2)) [dB] (n,), at most `PSNR_CEILING_DB`.

    The ceiling keeps the mean over images finite when one of them is perfect.

    Raises:
        InputError: unusable arrays or data range.
    """
    t, p, inside = _checked(truth, estimate, mask, data_range)
    error = np.empty(len(t))
    for rows, a, b in _pixels(t, p, inside):
        error[rows] = np.mean(((b - a) / data_range) ** 2, axis=1)
    floor = 10 ** (-PSNR_CEILING_DB / 10)
    return -10 * np.log10(np.maximum(error, floor))


def psnr_of_mean(errors: Array | pd.Series) -> float:
    """PSNR [dB] of the mean of squared errors (n,), relative to the data range; NaN of none."""
    return float(-10 * np.log10(errors.mean())) if len(errors) else float("nan")


def image_figures(
    truth: ArrayLike,
    estimate: ArrayLike,
    data_range: float,
    mask: Mask | None = None,
) -> dict[str, Array]:
    """SSIM, CC, RIE and PSNR (n,) by name; arguments and errors as for `ssim` and `rie`."""
    return {
        "ssim": ssim(truth, estimate, data_range, mask),
        "cc": cc(truth, estimate, mask),
        "rie": rie(truth, estimate, mask),
        "psnr": psnr(truth, estimate, data_range, mask),
    }


def _checked(
    truth: ArrayLike, estimate: ArrayLike, mask: Mask | None, data_range: float = 1.0
) -> tuple[Images, Images, Mask]:
    t, p = _floating(truth), _floating(estimate)
    if t.ndim != 3 or t.shape != p.shape:
        raise InputError(
            f"Truth and estimate must both have shape (n, H, W), got {t.shape} and {p.shape}."
        )
    inside = np.ones(t.shape[1:], dtype=bool) if mask is None else np.asarray(mask)
    if inside.dtype != np.bool_ or inside.shape != t.shape[1:] or not inside.any():
        raise InputError(
            f"The mask must be boolean with shape {t.shape[1:]} and hold at least one pixel, got "
            f"{inside.dtype} with shape {inside.shape} and {np.count_nonzero(inside)} pixels."
        )
    if not (np.isfinite(data_range) and data_range > 0):
        raise InputError(f"The data range must be a positive number of S/m, got {data_range}.")
    for name, images in (("truth", t), ("estimate", p)):
        finite = np.isfinite(images) | ~inside
        if not finite.all():
            bad = int(np.argmin(finite.all(axis=(1, 2))))
            raise InputError(
                f"The {name} of image {bad} is not finite inside the sensor: leave such frames out."
            )
    return t, p, inside


def _floating(images: ArrayLike) -> Images:
    array = np.asarray(images)
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)


def _blocks(start: int, stop: int, size: int) -> Iterator[slice]:
    return (slice(k, min(k + size, stop)) for k in range(start, stop, size))


def _pixels(truth: Images, estimate: Images, inside: Mask) -> Iterator[tuple[slice, Array, Array]]:
    """Blocks of images as float64 rows of the pixels inside: (rows, truth, estimate)."""
    for rows in _blocks(0, len(truth), 8 * _BLOCK):
        t, p = (images[rows][:, inside].astype(np.float64) for images in (truth, estimate))
        yield rows, t, p


def _ssim_maps(x: Array, y: Array, width: int, window: int, data_range: float) -> Array:
    """SSIM of the window right of and above each pixel of flat images with rows of `width`.

    With window sums Sx, Sy, R of x y and E of (x - y)^2 over N pixels, the SSIM of a window is

        (2 Sx Sy + C1)            (2 N R - 2 Sx Sy + C2)
        ------------------- times ----------------------------------------------------
        (2 Sx Sy + D^2 + C1)      (2 N R - 2 Sx Sy + C2) + (N E - D^2),    D = Sx - Sy

    where C1 = N^2 (0.01 L)^2 and C2 = N (N - 1) (0.03 L)^2: four window sums do instead of five.
    Images lie end to end, so that every step runs over contiguous memory; what is found where a
    window reaches over the end of a row means nothing.
    """
    n = window * window
    c1, c2 = n**2 * (0.01 * data_range) ** 2, n * (n - 1) * (0.03 * data_range) ** 2
    sx, sy, r, e = (
        _line_sums(_line_sums(of, width, window), 1, window)
        for of in (x, y, x * y, np.square(x - y))
    )
    twice, square = 2 * (sx * sy), np.square(sx - sy)
    top = 2 * n * r - twice + c2
    bottom = n * e - square + top
    twice += c1
    return np.asarray(top * twice / (bottom * (square + twice)))


def _line_sums(values: Array, step: int, window: int) -> Array:
    """Sums of `window` values, odd, that lie `step` apart.

    Sums of 2, 4, ... values are doubled into each other, and those that the window is made of are
    added up; nothing is subtracted, so no digits cancel.
    """
    total = values[: len(values) - (window - 1) * step]
    sums, reached = values, 1
    for level in range(1, window.bit_length()):
        half = 2 ** (level - 1) * step
        sums = sums[:-half] + sums[half:]
        if window & 2**level:
            total = total + sums[reached * step :][: len(total)]
            reached += 2**level
    return total
