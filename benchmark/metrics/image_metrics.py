"""Image metrics, vectorised over images: SSIM, correlation, relative error and PSNR.

Truth `t` and estimate `p` are absolute conductivity (n, H, W) [S/m] on the same pixels; a mask
(H, W) says which pixels belong to the sensor, and what lies outside it is never looked at.
`eitbench.benchmark.metrics.specs` declares what every metric means.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import is_constant

WINDOW = 7
PSNR_CEILING_DB = float(-20 * np.log10(np.finfo(np.float32).eps))
"""138.5 dB: estimates are kept in float32, so a smaller error than its rounding means nothing."""

# Blocks of images small enough for the processor's cache; more threads than this gain nothing,
# because they wait for each other between two short array operations.
_BLOCK = 10
_MAX_THREADS = 4


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
        window: side of the window [pixels], odd; the benchmark's own by default.

    Raises:
        InputError: unusable arrays or data range, or a mask without room for a window.
    """
    t, p, inside = _checked(truth, estimate, mask)
    _check_range(data_range)
    n, height, width = t.shape
    weights = np.zeros((height, width))
    if min(height, width) >= window:
        windows = np.lib.stride_tricks.sliding_window_view(inside, (window, window)).all((-2, -1))
        weights[: windows.shape[0], : windows.shape[1]] = windows / max(windows.sum(), 1)
    if not weights.any():
        raise InputError(
            f"SSIM needs {window} x {window} pixels inside the sensor; this image of "
            f"{height} x {width} pixels has no such place: use a finer image grid."
        )
    values = np.empty(n)
    threads = min(_MAX_THREADS, os.cpu_count() or 1, -(-n // _BLOCK))
    shares = [slice(n * k // threads, n * (k + 1) // threads) for k in range(threads)]

    def fill(share: slice) -> None:
        with np.errstate(invalid="ignore"):
            _mean_ssim(t, p, share, inside, weights, data_range, window, values)

    if threads > 1:
        # NumPy works on the blocks outside the interpreter lock.
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(fill, shares))
    elif n:
        fill(slice(0, n))
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
    t, p, inside = _checked(truth, estimate, mask)
    _check_range(data_range)
    error = np.empty(len(t))
    for rows, a, b in _pixels(t, p, inside):
        error[rows] = np.mean(((b - a) / data_range) ** 2, axis=1)
    floor = 10 ** (-PSNR_CEILING_DB / 10)
    return -10 * np.log10(np.maximum(error, floor))


def image_figures(
    truth: ArrayLike,
    estimate: ArrayLike,
    data_range: float,
    mask: Mask | None = None,
    *,
    window: int = WINDOW,
) -> dict[str, Array]:
    """SSIM, CC, RIE and PSNR (n,) by name; arguments and errors as for `ssim` and `rie`."""
    return {
        "ssim": ssim(truth, estimate, data_range, mask, window=window),
        "cc": cc(truth, estimate, mask),
        "rie": rie(truth, estimate, mask),
        "psnr": psnr(truth, estimate, data_range, mask),
    }


def _checked(
    truth: ArrayLike, estimate: ArrayLike, mask: Mask | None
) -> tuple[NDArray[np.floating], NDArray[np.floating], Mask]:
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
    return t, p, inside


def _floating(images: ArrayLike) -> NDArray[np.floating]:
    array = np.asarray(images)
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)


def _check_range(data_range: float) -> None:
    if not (np.isfinite(data_range) and data_range > 0):
        raise InputError(f"The data range must be a positive number of S/m, got {data_range}.")


def _finite(images: NDArray[np.floating], inside: Mask, name: str, first: int) -> None:
    finite = np.isfinite(images)
    if not finite.all() and not finite[:, inside].all():
        bad = first + int(np.flatnonzero(~finite[:, inside].all(axis=1))[0])
        raise InputError(
            f"The {name} of image {bad} is not finite inside the sensor: leave such frames out."
        )


def _pixels(
    truth: NDArray[np.floating], estimate: NDArray[np.floating], inside: Mask
) -> Iterator[tuple[slice, Array, Array]]:
    """Blocks of images as float64 rows of the pixels inside: (rows, truth, estimate)."""
    for start in range(0, len(truth), 8 * _BLOCK):
        rows = slice(start, start + 8 * _BLOCK)
        _finite(truth[rows], inside, "truth", start)
        _finite(estimate[rows], inside, "estimate", start)
        yield (
            rows,
            truth[rows][:, inside].astype(np.float64),
            estimate[rows][:, inside].astype(np.float64),
        )


def _mean_ssim(
    truth: NDArray[np.floating], estimate: NDArray[np.floating], share: slice, inside: Mask,
    weights: Array, data_range: float, window: int, out: Array,
) -> None:  # fmt: skip
    """Weighted means of the SSIM maps of a share of the images, into their places in `out`.

    With window sums Sx, Sy, R of x y and E of (x - y)^2 over N pixels, the SSIM of a window is

        (2 Sx Sy + C1)            (2 N R - 2 Sx Sy + C2)
        ------------------- times ----------------------------------------------------
        (2 Sx Sy + D^2 + C1)      (2 N R - 2 Sx Sy + C2) + (N E - D^2),    D = Sx - Sy

    where C1 = N^2 (0.01 L)^2 and C2 = N (N - 1) (0.03 L)^2: four window sums do instead of five.
    Images are laid end to end, so that every step runs over contiguous memory. Windows that reach
    over the end of a row have weight 0.
    """
    _, height, width = truth.shape
    pixels, full = height * width, bool(inside.all())
    count = window * window
    c1 = count**2 * (0.01 * data_range) ** 2
    c2 = count * (count - 1) * (0.03 * data_range) ** 2
    scratch = np.empty((3, _BLOCK * pixels))
    maps = np.zeros((5, _BLOCK * pixels))
    for start in range(share.start, share.stop, _BLOCK):
        stop = min(start + _BLOCK, share.stop)
        size = (stop - start) * pixels
        x = np.ascontiguousarray(truth[start:stop], dtype=np.float64)
        y = np.ascontiguousarray(estimate[start:stop], dtype=np.float64)
        if not full:
            x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        x, y = x.reshape(-1), y.reshape(-1)
        valid = size - (window - 1) * (width + 1)
        product = maps[4, :size]
        twice, square, top, bottom = maps[:4, :valid]

        _window_sums(x, width, window, scratch, square)
        _window_sums(y, width, window, scratch, top)
        np.multiply(square, top, out=twice)
        twice *= 2
        square -= top
        square *= square
        np.multiply(x, y, out=product)
        _window_sums(product, width, window, scratch, top)
        top *= 2 * count
        top -= twice
        top += c2
        np.subtract(x, y, out=product)
        product *= product
        _window_sums(product, width, window, scratch, bottom)
        bottom *= count
        bottom -= square
        bottom += top
        twice += c1
        square += twice
        top *= twice
        bottom *= square
        top /= bottom
        np.dot(maps[2, :size].reshape(-1, pixels), weights.reshape(-1), out=out[start:stop])
        # A full image that is not finite shows in its mean, which is cheaper to look at.
        if not full or not np.isfinite(out[start:stop]).all():
            _finite(truth[start:stop], inside, "truth", start)
            _finite(estimate[start:stop], inside, "estimate", start)


def _window_sums(images: Array, width: int, window: int, scratch: Array, out: Array) -> None:
    """Sums over the window right of and above each pixel; `images` is flat, rows of `width`.

    Sums of 2, 4, ... pixels are doubled into each other, and those that the window's side is made
    of are added up; nothing is subtracted, so no digits cancel.
    """
    rows = scratch[2, : len(images) - (window - 1) * width]
    _line_sums(images, width, window, scratch, rows)
    _line_sums(rows, 1, window, scratch, out)


def _line_sums(values: Array, step: int, window: int, scratch: Array, out: Array) -> None:
    out[:] = values[: len(out)]
    sums, reached = values, 1
    for level in range(1, window.bit_length()):
        half = 2 ** (level - 1)
        size = len(sums) - half * step
        # The two rows of scratch take turns, since NumPy would copy what it adds to itself.
        np.add(sums[:size], sums[half * step :], out=scratch[level % 2, :size])
        sums = scratch[level % 2, :size]
        if window & 2**level:
            out += sums[reached * step :][: len(out)]
            reached += 2**level
