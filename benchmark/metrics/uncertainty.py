"""Figures of stated uncertainty: CRPS, calibration, sharpness, and whether it tells large errors.

A method states it by `DRAWS` images from its posterior (`Method.uncertainty`); of a standard
deviation, normal images are drawn here. If the posterior is right, the truth is one more draw: its
rank among the draws is uniform, and no figure here assumes more. Pixels of which all of these
images agree, such as most of the untouched sensor, say nothing of that and are left out of ranks.
That choice depends on the truth and the draws alike, so that ranks stay uniform.

Sources: Gneiting and Raftery, J. Am. Stat. Assoc. 102(477), 2007 (CRPS); Ferro, Q. J. R. Meteorol.
Soc. 140(683), 2014 (of few draws); Hamill, Mon. Weather Rev. 129(3), 2001 (ranks); Ilg et al., ECCV
2018 (sparsification).
"""

import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.threads import for_each
from eitbench.methods.method import DRAWS
from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.sensors.sensor import Sensor


def root_mean_square(rows: pd.DataFrame, counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Error over spread (b,) of the rows of a cell, each drawn `counts` (b, n) times."""
    squares = rows["error_over_spread"].to_numpy(np.float64) ** 2
    known = np.isfinite(squares)
    return np.asarray(np.sqrt(counts[:, known] @ squares[known] / counts[:, known].sum(axis=1)))


SPREAD = 0.01
"""Pixels are ranked where truth and draws span more than this part of the sensor's data range."""

PLACE_ROUNDING = 9
"""Decimals of distances [m] of places that are compared. Images of the same pixels have the same
place but for rounding, which is another in draws, of single precision, than in the truth."""

LEVELS = (50, 80, 95)
"""Central intervals [%]; with 39 draws each ends at a draw."""

REMOVED = np.arange(20) / 20
"""Parts of the pixels that sparsification leaves out, those of the largest deviation first."""

_STATED = "methods that state an uncertainty, on scenarios with a true conductivity"
_PLACES = "methods that draw images, where a press or a true conductivity is known"

UNCERTAINTY = {
    spec.name: spec
    for spec in (
        MetricSpec(
            "crps",
            "CRPS",
            formula="mean over pixels of mean |x_i - t| - sum |x_i - x_j| / (2 K (K - 1)), x_i the "
            f"K = {DRAWS} draws of a pixel; without spread it is the mean |p - t|",
            domain=_STATED,
            unit="S/m",
            best="min",
            form=".5f",
            traps="A proper score of independent draws: in the mean nothing beats the true "
            "posterior. Draws that avoid each other, such as evenly spaced quantiles, can, by a "
            "few per cent. Mostly a figure of the error: a better image without a word on its "
            "spread can win. Blind to whether neighbouring pixels vary together. Frames that fail "
            "are charged the score of a certain image of the untouched sensor, which some methods "
            "do not reach.",
        ),
        *(
            MetricSpec(
                f"coverage_{level}",
                f"In {level} %",
                formula=f"share of pixels whose truth lies within the central {level} % of the "
                "draws, between the draws of these ranks; equal values share their ranks",
                domain=_STATED,
                best=None,
                form=".1%",
                mask=f"pixels where truth and draws span more than {SPREAD:.0%} of the data range",
                traps=f"{level} % is right, more is too careful. An average: too wide at one place "
                "makes up for too narrow at another. Wide intervals reach it without knowing "
                "anything, see Sharpness. Methods that are unsure everywhere are judged on more "
                "pixels. Draws kept within a range at whose end the truth often lies are equal to "
                "it there, share its ranks, and look right whatever they say.",
            )
            for level in LEVELS
        ),
        MetricSpec(
            "sharpness",
            "Sharpness",
            formula="root of the mean variance of the draws over pixels",
            domain="methods that state an uncertainty",
            unit="S/m",
            best="min",
            form=".4f",
            traps="Of the statement alone: a method that is sure and wrong is sharp.",
        ),
        MetricSpec(
            "error_over_spread",
            "Error / spread",
            formula="root mean square error of the draws' mean / (sharpness * sqrt(1 + 1 / K)); of "
            "a scenario, the root mean square over frames",
            domain=_STATED,
            best=None,
            aggregate=root_mean_square,
            form=".2f",
            traps="1 is right; more says that errors are larger than stated. Frames whose draws "
            "are all alike have none, however wrong they are; one frame with next to no spread can "
            "rule the mean. CRPS charges both.",
        ),
        MetricSpec(
            "ause",
            "AUSE",
            formula="area between two curves of the mean |p - t| of the pixels that are left when "
            "those of the largest deviation, or of the largest error, are left out; over the mean "
            "|p - t| of all",
            domain=_STATED,
            best="min",
            form=".3f",
            traps="0 where deviations rank pixels as errors do. Blind to their scale. Deviations "
            f"are those of the {DRAWS} draws.",
        ),
        *(
            MetricSpec(
                f"place_coverage_{level}",
                f"Place in {level} %",
                formula=f"share of frames whose true place is among the {level} % nearest to the "
                "mean of the places in the draws and of itself; distances equal to the nanometre "
                "share their ranks; draws without a contact are left out, and where all are, it "
                "counts as 0",
                domain=_PLACES,
                best=None,
                form=".1%",
                traps=f"{level} % is right, more is too careful. Places are those of Localisation "
                "of a single contact; of several contacts it is the place of them all.",
            )
            for level in LEVELS
        ),
        MetricSpec(
            "place_radius_mm",
            "Place radius",
            formula="radius about their mean that holds 95 % of the places in the draws",
            domain=_PLACES,
            unit="mm",
            best="min",
            aggregate="median",
            form=".2f",
            traps="Of the statement alone, as Sharpness.",
        ),
        MetricSpec(
            "uncertainty_ms",
            "Time of it",
            formula="time to state the uncertainty of a frame, beside that of its image",
            domain="methods that state an uncertainty",
            unit="ms",
            best="min",
            aggregate="median",
            form=".1f",
            traps="In batches.",
        ),
    )
}
"""The figures of stated uncertainty by name; methods are ranked by the first."""

SCALARS = ("crps", "sharpness", "error_over_spread", "ause", "uncertainty_ms")
STORED: dict[str, tuple[int, ...]] = {
    **dict.fromkeys((*SCALARS, "placed"), ()),
    "ranks": (DRAWS + 1,), "sparsified": (2, len(REMOVED)), "places": (DRAWS, 2),
}  # fmt: skip
"""Shapes of what is kept of the draws of a frame, which are too large to keep. `placed` is 1 where
draws vary as wholes, so that `places` are theirs."""


def normal_draws(images: NDArray[np.floating[Any]], deviations: Array) -> NDArray[np.float32]:
    """Images (n, K, H, W) about `images` (n, H, W) with `deviations` (n, H, W), all in S/m.

    Each pixel varies on its own. What does not fit single precision becomes infinite.
    """
    offsets = _offsets(images.shape[1:])
    draws = np.empty((len(images), *offsets.shape), np.float32)
    for_each(lambda n: _fill_normal(draws[n], images[n], deviations[n], offsets), range(len(draws)))
    return draws


@compiled
def _fill_normal(
    draws: NDArray[np.float32],
    image: NDArray[np.floating[Any]],
    deviation: NDArray[np.floating[Any]],
    offsets: Array,
) -> None:
    """Fill in `draws` (K, H, W), each `offsets` (K, H, W) times `deviation` from `image` (H, W)."""
    for k in range(len(draws)):
        for i in range(draws.shape[1]):
            for j in range(draws.shape[2]):
                exact = np.float64(image[i, j]) + np.float64(deviation[i, j]) * offsets[k, i, j]
                draws[k, i, j] = np.float32(exact)


@cache
def _offsets(shape: tuple[int, ...]) -> Array:
    """Standard normal values (K, H, W), the same for all frames."""
    return np.random.default_rng(0).standard_normal((DRAWS, *shape))


def figures_of_draws(
    truth: NDArray[np.floating[Any]],
    draws: NDArray[np.floating[Any]],
    images: NDArray[np.floating[Any]],
    data_range: float,
    inside: Mask | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Figures of frames from their pixels inside the sensor.

    Args:
        truth: (n, P) true conductivity [S/m], which is rounded to single precision, as draws are.
        draws: (n, K, P) [S/m].
        images: (n, P) the estimates [S/m].
        data_range: [S/m].
        inside: (P,) true for the pixels that count; all by default.

    Returns:
        By name, as `STORED` has them: `ranks` is the share of pixels with each rank, from 0 for
        those below all draws; `sparsified` is the mean |p - t| of the pixels left at each of
        `REMOVED`, by stated deviation and by error itself.
    """
    single, drawn = (np.ascontiguousarray(of, dtype=np.float32) for of in (truth, draws))
    count, network = draws.shape[1], _network(draws.shape[1])
    sums = np.empty((len(draws), 7, truth.shape[1]))
    for n in range(len(sums)):
        _fill_sums(single[n], drawn[n], sums[n], network)
    known, images = (of.astype(np.float64) for of in (single, images))
    if inside is not None and not inside.all():
        sums, known, images = sums[..., inside], known[:, inside], images[:, inside]
    middle, distance, squares, apart, below, upto, span = sums.swapaxes(0, 1)
    crps = distance / count - apart / (count * (count - 1))
    spread = np.sqrt(np.mean(squares / (count - 1), axis=1))
    missed = np.sqrt(np.mean((middle - known) ** 2, axis=1))
    errors = np.abs(images - known)
    by_both = np.stack([left_over(errors, squares), _means_of_least(np.sort(errors))], axis=1)
    area, whole = np.mean(by_both[:, 0] - by_both[:, 1], axis=1), errors.mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            "crps": crps.mean(axis=1),
            "sharpness": spread,
            "error_over_spread": np.where(
                spread > 0, missed / spread / np.sqrt(1 + 1 / count), np.nan
            ),
            "ause": np.where(whole > 0, area / whole, 0.0),
            "ranks": rank_shares(below, upto, span > SPREAD * data_range, count),
            "sparsified": by_both,
        }


@cache
def _network(count: int) -> NDArray[np.int64]:
    """Pairs (m, 2) of places that sort `count` values if each is put in order, one after the other.

    Batcher's odd-even merge sort: Knuth, The Art of Computer Programming, vol. 3, 5.2.2, algorithm
    M. It has no branches, so that the draws of many pixels are sorted side by side.
    """
    pairs = []
    top = 1 << max(0, (count - 1).bit_length() - 1)
    p = top
    while p > 0:
        q, r, d = top, 0, p
        while True:
            pairs += [(i, i + d) for i in range(count - d) if i & p == r]
            if q == p:
                break
            d, q, r = q - p, q // 2, p
        p //= 2
    return np.array(pairs, np.int64).reshape(-1, 2)


_FEW = 4  # frames at once: fewer cost more steps, more do not fit into the cache
_TILE = 128  # pixels, whose draws in single precision fit into the first cache


@compiled
def _fill_sums(
    truth: NDArray[np.float32],
    draws: NDArray[np.float32],
    sums: Array,
    network: NDArray[np.int64],
) -> None:
    """Fill in the mean (P,) of the `draws` (K, P) of each pixel [S/m], and sums over them.

    The `sums` (7, P) are, after the mean, those of distances from the truth (P,) [S/m], of squared
    distances from the mean [(S/m)^2], and of distances between each two of them [S/m]; then the
    number of draws below the truth, and of those not above it, and what truth and draws span [S/m].
    The `network` sorts K values.
    """
    count, pixels = draws.shape
    # Integers of the same bits are in the same order, and are compared eight at once.
    bits = np.zeros((count, _TILE), np.int32)
    ordered = bits.view(np.float32)
    true, less, not_more = (
        np.zeros(_TILE, np.float32),
        np.zeros(_TILE, np.int32),
        np.zeros(_TILE, np.int32),
    )
    for start in range(0, pixels, _TILE):
        stop = min(start + _TILE, pixels)
        size = stop - start
        mean, from_true, from_mean = sums[0, start:stop], sums[1, start:stop], sums[2, start:stop]
        both, below, upto = sums[3, start:stop], sums[4, start:stop], sums[5, start:stop]
        span = sums[6, start:stop]
        mean[:], from_true[:], from_mean[:], both[:] = 0.0, 0.0, 0.0, 0.0
        true[:size] = truth[start:stop]
        for k in range(count):
            row, here = draws[k, start:stop], ordered[k]
            for p in range(size):
                here[p] = row[p]
                mean[p] += np.float64(row[p])
        for p in range(size):
            mean[p] /= count
        _turn_negative(bits)
        for k in range(len(network)):
            low, high = bits[network[k, 0]], bits[network[k, 1]]
            for p in range(_TILE):
                low[p], high[p] = min(low[p], high[p]), max(low[p], high[p])
        _turn_negative(bits)
        less[:], not_more[:] = 0, 0
        median = ordered[count // 2]
        for k in range(count):
            # Of values in order, each is the larger one of k pairs, and the lesser one of the rest.
            drawn, weight = ordered[k], 2.0 * k - count + 1
            for p in range(size):
                value = np.float64(drawn[p])
                from_true[p] += abs(value - np.float64(true[p]))
                from_mean[p] += (value - mean[p]) ** 2
                # Less the median, so that equal draws have no distance at all.
                both[p] += weight * (value - np.float64(median[p]))
            for p in range(_TILE):
                less[p] += np.int32(drawn[p] < true[p])
                not_more[p] += np.int32(drawn[p] <= true[p])
        for p in range(size):
            below[p], upto[p] = less[p], not_more[p]
            most = max(np.float64(ordered[count - 1, p]), np.float64(true[p]))
            span[p] = most - min(np.float64(ordered[0, p]), np.float64(true[p]))


@compiled
def _turn_negative(bits: NDArray[np.int32]) -> None:
    """Turn round the order of negative numbers, of which integers of the same bits fall."""
    for k in range(len(bits)):
        row = bits[k]
        for p in range(len(row)):
            row[p] ^= (row[p] >> 31) & 0x7FFFFFFF


def rank_shares(below: Array, upto: Array, ranked: Mask, count: int) -> Array:
    """Share (n, count + 1) of the `ranked` pixels by the rank of the truth among `count` draws.

    `below` and `upto` (n, P) are the number of draws less than the truth of each, and of those not
    greater. A truth that equals draws has all ranks between with equal parts. NaN without pixels.
    """
    part = np.where(ranked, 1 / (upto - below + 1), 0.0).ravel()
    begin = (count + 2) * np.arange(len(below))[:, None]
    steps = np.zeros((len(below), count + 2))
    for ends, sign in ((below, 1), (upto + 1, -1)):
        places = (begin + ends.astype(np.int64)).ravel()
        steps += sign * np.bincount(places, part, steps.size).reshape(steps.shape)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.cumsum(steps, axis=1)[:, :-1] / ranked.sum(axis=1, keepdims=True))


def left_over(errors: Array, by: Array) -> Array:
    """Mean (n, R) of the `errors` (n, P) left at each of `REMOVED` when the largest `by` go.

    Pixels of equal `by` go in any order: each counts as their mean.
    """
    order = by.argsort(axis=1)
    kept, ordered = (np.take_along_axis(of, order, axis=1) for of in (errors, by))
    new = np.ones(by.shape, dtype=bool)
    np.not_equal(ordered[:, 1:], ordered[:, :-1], out=new[:, 1:])
    if not new.all():
        first = np.flatnonzero(new)
        counts = np.diff(np.append(first, by.size))
        kept = np.repeat(np.add.reduceat(kept.ravel(), first) / counts, counts)
    return _means_of_least(kept.reshape(by.shape))


def _means_of_least(ordered: Array) -> Array:
    """Mean of the first values of `ordered` (n, P), as many as are left at each of `REMOVED`."""
    left = np.maximum(1, np.round((1 - REMOVED) * ordered.shape[1]).astype(int))
    return np.asarray(np.cumsum(ordered, axis=1)[:, left - 1] / left)


def coverages(ranks: Array) -> dict[str, Array]:
    """Share within each of the central `LEVELS` by shares of ranks (..., K + 1)."""
    bins = ranks.shape[-1]
    found = {}
    for level in LEVELS:
        out = round(bins * (1 - level / 100) / 2)
        found[f"coverage_{level}"] = ranks[..., out : bins - out].sum(axis=-1)
    return found


def place_figures(places: Array, true: Array) -> dict[str, Array]:
    """Figures (n,) of places (n, K, 2) [m] in the draws of frames, and of `true` places (n, 2).

    Draws without a contact are left out; where none has one, the true place is not covered and the
    radius is infinite. NaN where there is no true place.
    """
    figures = {f"place_coverage_{level}": np.full(len(true), np.nan) for level in LEVELS}
    figures["place_radius_mm"] = np.full(len(true), np.nan)
    for n in np.flatnonzero(np.isfinite(true).all(axis=1)).tolist():
        drawn = places[n][np.isfinite(places[n]).all(axis=1)]
        distances = _from_middle(np.concatenate([drawn, true[n, None]])).round(PLACE_ROUNDING)
        nearer, upto = (distances < distances[-1]).mean(), (distances <= distances[-1]).mean()
        for level in LEVELS:
            # The rank of the truth lies anywhere between the two ends.
            share = (level / 100 - nearer) / (upto - nearer)
            figures[f"place_coverage_{level}"][n] = share.clip(0, 1) if len(drawn) else 0.0
        radius = np.quantile(_from_middle(drawn), 0.95, method="higher") if len(drawn) else np.inf
        figures["place_radius_mm"][n] = 1e3 * radius
    return figures


def _from_middle(places: Array) -> Array:
    """Distance of each of `places` (m, 2) from their mean."""
    return np.asarray(np.hypot(*(places - places.mean(axis=0)).T))


def kept_of_draws(
    truth: NDArray[np.floating[Any]] | None,
    draws: NDArray[np.float32],
    images: NDArray[np.float32],
    sensor: Sensor,
    *,
    placed: bool,
) -> dict[str, Array]:
    """What is kept of the draws (n, K, H, W) of frames with `images` (n, H, W), as `STORED`.

    Args:
        truth: (n, H, W) conductivity [S/m]; None where it is not known.
        draws: [S/m].
        images: the estimates [S/m].
        sensor: whose pixels count.
        placed: true if the draws vary as wholes, so that each shows a place.
    """
    kept = {name: np.full((len(draws), *shape), np.nan) for name, shape in STORED.items()}
    kept["placed"][:] = placed
    flat, inside = draws.reshape(*draws.shape[:2], -1), sensor.mask.ravel()

    def fill(rows: slice) -> None:
        if placed:
            every = draws[rows].reshape(-1, *draws.shape[2:])
            places = locate(every, sensor, sensor.background)
            kept["places"][rows] = places.reshape(-1, draws.shape[1], 2)
        if truth is None:
            variance = flat[rows].var(axis=1, ddof=1, dtype=np.float64)
            kept["sharpness"][rows] = np.sqrt(variance[:, inside].mean(axis=1))
            return
        known, seen = (of[rows].reshape(-1, inside.size) for of in (truth, images))
        found = figures_of_draws(known, flat[rows], seen, sensor.data_range, inside)
        for name, value in found.items():
            kept[name][rows] = value

    for_each(fill, [slice(k, k + _FEW) for k in range(0, len(draws), _FEW)])
    return kept


def sample_figures(kept: Mapping[str, Array], places: Array, true: Array) -> dict[str, Array]:
    """Columns of a table of samples from what was kept of their draws.

    Args:
        kept: see `kept_of_draws`; places count if the draws of all frames vary as wholes.
        places: those kept, (n, K, 2), in the coordinates of the true ones.
        true: (n, 2) true places [m], NaN where there is none.
    """
    scalar = {name: kept[name] for name in SCALARS}
    # Of some frames alone they do not: a method could choose those whose places count.
    counts = (kept["placed"] == 1) & ~(kept["placed"] == 0).any()
    known = np.where(counts[:, None], true, np.nan)
    return scalar | coverages(kept["ranks"]) | place_figures(places, known)


def summary(kept: Mapping[str, Array]) -> str:
    """The mean `ranks` and `sparsified` of the frames of a cell as JSON; "" where none has them."""
    if not np.isfinite(kept["ranks"]).any():
        return ""
    means = {name: np.nanmean(kept[name], axis=0) for name in ("ranks", "sparsified")}
    return json.dumps({name: mean.round(7).tolist() for name, mean in means.items()})
