"""Bounds of what a sensor can feel: detectability, Cramer-Rao bounds and two points, as maps.

A touch at p multiplies the background b by 1 + c exp(-|x - p|^2 / r^2). It has the area pi r^2 and
the greatest contrast c of a disc of radius r, and a derivative in every parameter. Its strength is
q = b c pi r^2 [S/m m^2]. The frame's change is linear in the conductivity, dv = J dsigma, with the
Jacobian J of the model at the untouched state.

Noise. A frame and its reference frame each have white noise of standard deviation s, and between
both the logarithm of the conductivity drifts by d (e + (x' f + y' g) / 2), with x' and y' from -1
to 1 over the sensor and e, f and g standard normal: the drift of `scenarios.imperfections`. With
the changes h_k = J (b, b x' / 2, b y' / 2) the covariance of a difference is

    C = 2 s^2 I + d^2 sum_k h_k h_k^T.

Detectability is z = sqrt(dv^T C^-1 dv), mean over standard deviation of the optimal linear test for
a touch at a known place (Adler, Gaggero and Maimaitijiang, Physiological Measurement 32, 2011).

The Cramer-Rao bound is F^-1 with F = T^T C^-1 T and T the derivatives of dv by x, y, ln q and ln r
(Kay, Fundamentals of Statistical Signal Processing I, 1993, sec. 3.9). Contrast and area of a small
touch can hardly be told apart; their product q can. So the bounds of place and strength hold with
the size unknown, and the bound of ln r says whether there is a size to see: above 100 % there is
none.

Two points. Two touches of q / 2 at p - a and p + a have the frame dv_2. What no small change of one
touch's place, strength and size explains of dv_2 - dv has the size delta = |P C^-1/2 (dv_2 - dv)|,
with P the projection off C^-1/2 T. A test with 1 % false alarms finds it in 90 % of cases where
delta is at least `SEEN`. The two-point bound is the smallest distance 2 |a| from which on this is
so, in the worst of four directions. It is a bound to first order in the change of the one touch.

Ambiguous places. The Cramer-Rao bound is local: it does not see that a touch far away has nearly
the same frame. A place is ambiguous if a touch of some strength at another place of the lattice,
further away than 2 r and than three times the bound of the place, leaves less than `SEEN` of its
frame unexplained. There no method need attain the bound.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import independent
from eitbench.scenarios.sensors.sensor import Sensor

FALSE_ALARMS, DETECTED = 0.01, 0.90
SEEN = float(stats.norm.isf(FALSE_ALARMS) + stats.norm.ppf(DETECTED))
"""z of what a one-sided test with 1 % false alarms finds in 90 % of cases: 3.61."""
LATTICE = 20
"""Places of the lattice along the longer side of a sensor."""
_SINGULAR = 1e-12  # a direction with so little of the largest singular value is not told at all
LEAST_PIXELS = 1.5  # sampled on coarser pixels, the touch changes with its place in a pixel
_DIRECTIONS = ((1, 0), (0, 1), (1, 1), (1, -1))


@dataclass(frozen=True)
class Touch:
    """The touch that bounds are for: of a disc's `radius` [m], and its greatest `contrast`.

    The contrast is relative to the background; it is negative where a touch conducts less.

    Raises:
        InputError: a radius that is not above 0, or a contrast that is 0, or not above -1.
    """

    radius: float
    contrast: float = -0.3

    def __post_init__(self) -> None:
        if not 0 < self.radius < np.inf:
            raise InputError(f"A touch needs a radius above 0 mm, got {1e3 * self.radius:g}.")
        if not -1 < self.contrast < np.inf or self.contrast == 0:
            raise InputError(
                "The contrast of a touch is relative to the background: above -1 and not 0, for "
                f"example -0.3; got {self.contrast:g}."
            )


@dataclass(frozen=True)
class Noise:
    """Noise of a frame: `std` [V/A] of a value, and `drift` since the reference frame, relative."""

    std: float
    drift: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.std < np.inf and 0 <= self.drift < 1):
            raise InputError(
                "A design needs noise: an SNR in dB (`--snr 60`) that leaves noise above 0, and a "
                f"drift from 0 to below 1; got {self.std:g} V/A and {self.drift:g}."
            )


def noise_of(sensor: Sensor, snr_db: float | None, drift: float = 0.0) -> Noise:
    """Noise of the frames of `sensor` at an SNR [dB] of its untouched frame, as suites define it.

    Raises:
        InputError: no SNR is given, or it is not finite; a drift below 0 or from 1.
    """
    if snr_db is None or not np.isfinite(snr_db):
        raise InputError(
            "What a sensor can feel depends on its noise: give the SNR of a frame in dB, for "
            "example `--snr 60`."
        )
    model = forward_model(sensor)
    rms = float(np.sqrt(np.mean(model.voltages(model.background) ** 2)))
    return Noise(rms * 10 ** (-snr_db / 20), drift)


@dataclass(frozen=True, eq=False)
class Maps:
    """Bounds over a lattice of places; all (rows, columns), NaN where no touch has room.

    Attributes:
        x: places of the columns (columns,) [m].
        y: places of the rows (rows,) [m].
        detectability: z of the touch.
        place: standard deviation of the place [m], sqrt(var x + var y).
        strength: standard deviation of the strength, relative.
        size: standard deviation of the radius, relative; above 1 a size cannot be seen.
        smallest: strength [S/m m^2] of the smallest touch that is detected.
        two_point: two-point bound [m]; inf where two touches are not told from one
            before one of them leaves the sensor.
        ambiguous: 1 where a touch elsewhere has nearly the same frame, else 0.
        covariance: (rows, columns, 4, 4) bound of the covariance of x / r, y / r, ln q and ln r.
    """

    x: Array
    y: Array
    detectability: Array
    place: Array
    strength: Array
    size: Array
    smallest: Array
    two_point: Array
    ambiguous: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class WhitenedJacobian:
    """Changes of frames in units of their noise, without what is redundant in them.

    `rows` (K, H, W) is such that |rows dsigma| is |C^-1/2 J dsigma| for every image dsigma [S/m];
    `singular` (K,) are the singular values of C^-1/2 J, falling.
    """

    sensor: Sensor
    rows: Array
    singular: Array


def whitened_jacobian(sensor: Sensor, noise: Noise) -> WhitenedJacobian:
    """The Jacobian of `sensor` at the untouched state, whitened by the covariance of `noise`."""
    changes = _changes(sensor)
    covariance = 2 * noise.std**2 * np.eye(len(changes))
    if noise.drift:
        x, y = sensor.pixel_centres
        x0, y0, x1, y1 = sensor.outline.bounds
        across, along = (2 * x - x0 - x1) / (x1 - x0), (2 * y - y0 - y1) / (y1 - y0)
        even = np.ones(sensor.image_shape)
        drifts = sensor.background * np.stack([even, across / 2, along / 2])
        frames = noise.drift * drifts.reshape(3, -1) @ changes.T
        covariance += frames.T @ frames
    return whitened(sensor, covariance)


def whitened(sensor: Sensor, covariance: Array) -> WhitenedJacobian:
    """The Jacobian of `sensor`, whitened by any `covariance` (M, M) of a frame's change [V^2/A^2].

    Raises:
        InputError: a covariance of another size, or one that is not positive definite.
    """
    changes = _changes(sensor)
    first, owner, sign = independent(sensor.pattern)
    try:
        white = np.linalg.solve(
            np.linalg.cholesky(covariance), sign[:, None] * np.eye(len(first))[owner]
        )
    except (np.linalg.LinAlgError, ValueError):
        raise InputError(
            f"A covariance of {len(changes)} values has to be a positive definite matrix of as "
            f"many rows and columns, got shape {np.shape(covariance)}: give more frames, or add "
            "white noise to it."
        ) from None
    # By reciprocity a frame is `white` times its independent values. Where white = Q R with an
    # orthonormal Q, R J_independent has all norms of C^-1/2 J and half of the rows, or fewer.
    r = np.linalg.qr(white, mode="r")
    _, singular, right = np.linalg.svd(r @ changes[first], full_matrices=False)
    rows = (singular[:, None] * right).reshape(-1, *sensor.image_shape)
    return WhitenedJacobian(sensor, rows, singular)


def _changes(sensor: Sensor) -> Array:
    """(M, H * W): derivatives of a frame by the pixels on the sensor, at the untouched state."""
    model = forward_model(sensor)
    jacobian = model.jacobian(model.background)
    return np.asarray(jacobian.reshape(len(jacobian), -1) * sensor.mask.ravel())


def lattice(sensor: Sensor, radius: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pixels whose centres are the places of a lattice over `sensor`.

    Raises:
        InputError: pixels too coarse for the radius [m], or nowhere room for such a touch.
    """
    if radius < LEAST_PIXELS * max(sensor.pixel_size):
        raise InputError(
            f"A touch of radius {1e3 * radius:.3g} mm is too small for the pixels of "
            f"{sensor.name!r}, {1e3 * max(sensor.pixel_size):.3g} mm: give a radius of at least "
            f"{1e3 * LEAST_PIXELS * max(sensor.pixel_size):.3g} mm, or the sensor a finer image."
        )
    step = max(1, round(max(sensor.image_shape) / LATTICE))
    rows, columns = (
        np.arange((count % step or step) // 2, count, step) for count in sensor.image_shape
    )
    if not room(sensor, radius)[np.ix_(rows, columns)].any():
        raise InputError(
            f"The sensor {sensor.name!r} has no room for a touch of radius {1e3 * radius:.3g} mm: "
            "give a smaller one with `--radius`."
        )
    return rows, columns


def room(sensor: Sensor, radius: float) -> NDArray[np.bool_]:
    """True (H, W) where a disc of `radius` [m] round the centre of the pixel lies on `sensor`."""
    x, y = sensor.pixel_centres
    free = sensor.outline.contains(x, y)
    for angle in np.linspace(0, 2 * np.pi, 32, endpoint=False):
        free &= sensor.outline.contains(x + radius * np.cos(angle), y + radius * np.sin(angle))
    return np.asarray(free)


def changes_and_derivatives(
    of: WhitenedJacobian, touch: Touch, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Whitened changes (rows, columns, K) by a touch at pixel centres, and their derivatives.

    The derivatives (rows, columns, K, 4) are by x / r, y / r, ln q and ln r.
    """
    sensor = of.sensor
    dx, dy = sensor.pixel_size
    height, width = sensor.image_shape
    # The touch is a product of functions of x and of y.
    u = (np.arange(width) - columns[:, None]) * dx / touch.radius
    v = (np.arange(height) - rows[:, None]) * dy / touch.radius
    flat_u, flat_v = np.exp(-(u**2)), np.exp(-(v**2))
    peak = sensor.background * touch.contrast

    def changed(by_v: Array, by_u: Array) -> Array:
        return peak * np.moveaxis(by_v @ of.rows @ by_u.T, 0, -1)

    change = changed(flat_v, flat_u)
    # d/d ln r at a fixed q: the contrast falls by r^-2.
    wider = changed(flat_v, (2 * u**2 - 1) * flat_u) + changed((2 * v**2 - 1) * flat_v, flat_u)
    east, north = changed(flat_v, 2 * u * flat_u), changed(2 * v * flat_v, flat_u)
    return change, np.stack([east, north, change, wider], axis=-1)


def maps(of: WhitenedJacobian, touch: Touch) -> Maps:
    """The bounds of a touch over the lattice of the sensor, see the module's description.

    Raises:
        InputError: no room for the touch, or pixels too coarse for it.
    """
    sensor = of.sensor
    rows, columns = lattice(sensor, touch.radius)
    change, derivatives = changes_and_derivatives(of, touch, rows, columns)
    free = room(sensor, touch.radius)[np.ix_(rows, columns)]
    # Q, R: the inverse of F is that of R twice, without squaring the condition.
    bases, triangles = np.linalg.qr(derivatives)
    inverse = np.linalg.pinv(triangles, rcond=_SINGULAR)
    spread = np.linalg.svd(triangles, compute_uv=False)
    told = (spread > _SINGULAR * spread[..., :1]).sum(axis=-1) == derivatives.shape[-1]
    inverse[~told] = np.inf  # there is a change of the touch that no frame shows
    covariance = np.where(free[..., None, None], inverse @ inverse.swapaxes(-1, -2), np.nan)
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    z = np.where(free, np.linalg.norm(change, axis=-1), np.nan)
    strength = sensor.background * abs(touch.contrast) * np.pi * touch.radius**2
    place = touch.radius * np.sqrt(variances[..., 0] + variances[..., 1])
    x, y = (centres[np.ix_(rows, columns)] for centres in sensor.pixel_centres)
    alike = np.full(z.shape, np.nan)
    far = np.maximum(2 * touch.radius, 3 * place[free])
    alike[free] = _ambiguous(np.stack([x[free], y[free]], -1), change[free], far)
    return Maps(
        x=x[0],
        y=y[:, 0],
        detectability=z,
        place=place,
        strength=np.sqrt(variances[..., 2]),
        size=np.sqrt(variances[..., 3]),
        smallest=SEEN / z * strength,
        two_point=np.where(free, _two_points(of, touch, rows, columns, change, bases), np.nan),
        ambiguous=alike,
        covariance=covariance,
    )


def _ambiguous(places: Array, changes: Array, far: Array) -> NDArray[np.bool_]:
    """True (n,) for `places` (n, 2) whose whitened `changes` (n, K) another one explains.

    The other one is further away than `far` (n,) [m], and of any strength of the same sign.
    """
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    size = np.linalg.norm(changes, axis=1)
    inner = np.maximum(changes @ changes.T, 0) / size
    left = size[:, None] ** 2 - inner**2
    return np.asarray(((apart > far[:, None]) & (left < SEEN**2)).any(axis=1))


def _two_points(
    of: WhitenedJacobian,
    touch: Touch,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    one: Array,
    bases: Array,
) -> Array:
    """Two-point bound (rows, columns) [m] in the worst of four directions."""
    sensor = of.sensor
    height, width = sensor.image_shape
    every, _ = changes_and_derivatives(of, touch, np.arange(height), np.arange(width))
    free = room(sensor, touch.radius)
    dx, dy = sensor.pixel_size
    bounds = []
    for across, along in _DIRECTIONS:
        step = 2 * np.hypot(across * dx, along * dy)
        last = np.zeros((len(rows), len(columns)))
        bound = np.full(last.shape, np.inf)
        for k in range(1, max(height, width) // 2 + 1):
            first, second = (
                np.ix_(rows + sign * k * along, columns + sign * k * across) for sign in (-1, 1)
            )
            inside = _inside(first, free.shape) & _inside(second, free.shape)
            if not inside.any():
                break
            (a, b), (c, d) = (
                (np.clip(r, 0, height - 1), np.clip(s, 0, width - 1)) for r, s in (first, second)
            )
            inside &= free[a, b] & free[c, d]
            extra = (every[a, b] + every[c, d]) / 2 - one
            known = np.einsum("ijkl,ijk->ijl", bases, extra)
            extra = extra - np.einsum("ijkl,ijl->ijk", bases, known)
            delta = np.where(inside, np.linalg.norm(extra, axis=-1), np.nan)
            # delta grows about as the square of the distance: its root is interpolated.
            low, high = np.sqrt(last), np.sqrt(delta)
            with np.errstate(invalid="ignore", divide="ignore"):
                crossing = step * (k - 1 + (np.sqrt(SEEN) - low) / (high - low))
            crosses = (delta >= SEEN) & (last < SEEN)
            bound = np.where(crosses, crossing, np.where(delta < SEEN, np.inf, bound))
            last = np.where(inside, delta, last)
        bounds.append(bound)
    return np.asarray(np.max(bounds, axis=0))


def _inside(pixels: tuple[NDArray[np.int64], ...], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    row, column = pixels
    return (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])


def averaged(noise: Noise, frames: int) -> Noise:
    """The noise of the mean of so many frames; what drifts does not fall."""
    return replace(noise, std=noise.std / np.sqrt(frames))
