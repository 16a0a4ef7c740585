"""Tactile acuity of methods, from the stored images of the design in `scenarios.phantoms.acuity`.

What is felt: a touch is detected if the strength that its image shows exceeds a threshold for 1 %
of false alarms, which is taken from frames without a touch, of the same method at the same noise.
Where it is felt: error and bias of the place. How far apart: two touches are told apart by the rule
of `two_touch`. How strong: shown strength over true strength.

The strength of an image is that of all its contacts (`scenarios.phantoms.contacts`): |contrast|
integrated over them [S/m m^2].
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import Run, cells_of
from eitbench.benchmark.findings.two_touch import WITHIN_MM
from eitbench.benchmark.metrics import tactile
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import Contacts, contacts, locate
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

FALSE_ALARMS = 0.01
DETECTED, APART = 0.5, 0.9
"""Share of touches detected at the smallest one, and of pairs told apart at the least distance."""
_BLOCK = 256
_DRAWS = 1000
_NEEDED = ("family", "place", "pressure_pa", "snr_db", "x_m", "y_m", "x2_m", "y2_m",
           "probe_distance_mm")  # fmt: skip


@dataclass(frozen=True, eq=False)
class AcuityResult:
    """Acuity of one method at one level of noise; places are those of the lattice.

    Attributes:
        scenario, method: names.
        snr_db: of the frames [dB].
        place: (k, 2) x and y [m] of the lattice.
        smallest_pa: (k,) smallest pressure detected [Pa]; NaN where the firmest is not.
        smallest_s_mm2: (k,) the same as true contrast times area [S/m mm^2].
        error_mm: (k,) median error of the place of detected touches [mm]; NaN without one.
        bias_mm: (k, 2) their mean displacement [mm].
        least_mm: (k,) least distance from which on all pairs around a place are told apart [mm];
            NaN where the farthest are not, or no pair has room.
        gain: (k,) slope of shown over true strength.
        roc: (2, m) false alarms and detections at falling thresholds, all pressures together.
        figures: one number each, for tables; see `figures_of`.
    """

    scenario: str
    method: str
    snr_db: float
    place: Array
    smallest_pa: Array
    smallest_s_mm2: Array
    error_mm: Array
    bias_mm: Array
    least_mm: Array
    gain: Array
    roc: Array
    figures: dict[str, float]


def acuity_of(run: Run) -> list[AcuityResult]:
    """Return the acuity of every method at every level of noise; none of other runs.

    Frames that a method gave no valid image of count as not detected, and pairs as not told apart.

    Raises:
        DataCorruptError: the images of the run are damaged.
    """
    if not any(one.get("acuity") for one in _declared(run)):
        return []
    suite = suite_of(run.manifest)
    designed = {
        one.name: one.nominal_sensor
        for one in suite.scenarios
        if isinstance(one, SimulatedScenario) and one.acuity is not None
    }
    return [
        result
        for (scenario, method), cell in cells_of(run.samples).items()
        if scenario in designed and set(_NEEDED) <= set(cell)
        for result in _of_cell(run, scenario, method, cell, designed[scenario])
    ]


def _declared(run: Run) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = run.manifest.get("plan", {}).get("suite", {}).get("scenarios", [])
    return found


def _of_cell(
    run: Run, scenario: str, method: str, cell: pd.DataFrame, sensor: Sensor
) -> Iterator[AcuityResult]:
    samples = cell["sample"].tolist()
    shown = []
    for first in range(0, len(samples), _BLOCK):
        block = samples[first : first + _BLOCK]
        images = run.estimates(scenario, method, block)
        truth = run.scene(scenario, block).truth
        if images is None or truth is None:
            return
        rows = cell.iloc[first : first + _BLOCK]
        shown.append(seen(images.astype(np.float64), truth, rows, sensor))
    table = pd.concat(shown, ignore_index=True)
    for level, of in table.groupby("snr_db", sort=True):
        whole = [(of["family"] == part).any() for part in ("no-touch", "touch", "pair")]
        if all(whole):
            yield result_of(scenario, method, float(np.float64(str(level))), of)


def seen(images: Array, truth: Array, samples: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """Return what images (n, H, W) [S/m] show: columns of `samples`, and what follows.

    Added are `shown` and `true`, strengths [S/m mm^2]; `found_x_mm`, `found_y_mm`, the place of a
    single touch; `count` of the contacts shown; and whether two touches are told apart, `apart`,
    also in the true image, `truth_apart`.
    An image that is not finite shows nothing.
    """
    table = samples.loc[:, list(_NEEDED)].reset_index(drop=True)
    # Equal distances in other directions differ by rounding.
    table["probe_distance_mm"] = table["probe_distance_mm"].astype(np.float64).round(6)
    contrast = images - sensor.background
    valid = np.isfinite(contrast[:, sensor.mask]).all(axis=1)
    contrast[~valid] = 0.0
    found = contacts(contrast, sensor)
    pixel_mm2 = 1e6 * sensor.pixel_size[0] * sensor.pixel_size[1]
    table["shown"] = 1e6 * found.total_strength
    table["true"] = pixel_mm2 * np.abs(truth - sensor.background)[:, sensor.mask].sum(axis=1)
    table["found_x_mm"], table["found_y_mm"] = 1e3 * locate(contrast, sensor).T
    table["count"] = found.count
    table["apart"] = _told_apart(found, table)
    table["truth_apart"] = _told_apart(contacts(truth - sensor.background, sensor), table)
    return table


def _told_apart(found: Contacts, table: pd.DataFrame) -> NDArray[np.bool_]:
    """Whether two touches are told apart (n,), by the rule of `two_touch`; False of other rows."""
    places = contact_places(table)
    apart = np.zeros(len(table), dtype=np.bool_)
    for n in np.flatnonzero(table["family"] == "pair").tolist():
        strongest = found.position[found.of(n)][:2]
        if len(strongest) == 2:
            farthest = 1e3 * tactile.distances(places[n], strongest).max()
            apart[n] = farthest < min(WITHIN_MM, table["probe_distance_mm"][n] / 2)
    return apart


def result_of(scenario: str, method: str, level: float, table: pd.DataFrame) -> AcuityResult:
    """Return the acuity at one level of noise from the rows of `seen`."""
    none, touch, pair = (table[table["family"] == part] for part in ("no-touch", "touch", "pair"))
    limit = threshold(numbers(none, "shown"))
    touch = touch.assign(detected=touch["shown"] > limit)
    known = touch.groupby("place", sort=True)
    keys = list(known.groups)
    place = known[["x_m", "y_m"]].first().to_numpy(np.float64)
    smallest = np.array([_smallest(of) for _, of in known])
    error, bias = _places(touch, keys)
    pairs: dict[Any, pd.DataFrame] = dict(iter(pair.groupby("place")))
    least = np.array([least_apart(pairs[k], 1.0) if k in pairs else np.nan for k in keys])
    gain = np.array([_line(numbers(of, "true"), numbers(of, "shown"))[0] for _, of in known])
    curve = roc(numbers(none, "shown"), numbers(touch, "shown"))
    figures = figures_of(touch, pair, smallest, gain, curve)
    return AcuityResult(
        scenario, method, level, place, smallest[:, 0], smallest[:, 1], error, bias, least, gain,
        curve, figures,
    )  # fmt: skip


def threshold(shown: Array) -> float:
    """Strength that new frames without a touch exceed with a probability of at most 1 %.

    It is one of the n strengths `shown`, n >= 99: of n + 1 exchangeable frames, the new one is
    among the r strongest with probability r / (n + 1) (order statistics, as in split conformal
    prediction). The rate given these n frames may be higher than its mean.
    """
    rank = int(np.ceil((1 - FALSE_ALARMS) * (len(shown) + 1) - 1e-9))
    return float(np.sort(shown)[min(rank, len(shown)) - 1])


def _smallest(touches: pd.DataFrame) -> tuple[float, float]:
    """Smallest pressure [Pa] and strength [S/m mm^2] that are detected at a place."""
    ladder = touches.groupby("pressure_pa")[["detected", "true"]].mean().sort_index()
    share = ladder["detected"].to_numpy(np.float64)
    pressure = ladder.index.to_numpy(np.float64)
    return smallest_detected(pressure, share), smallest_detected(numbers(ladder, "true"), share)


def smallest_detected(sizes: Array, share: Array) -> float:
    """Size from which on at least half of the touches are detected; NaN where there is none.

    Between the last size below and the first above, the share is taken as a straight line over the
    logarithm of the size. Where all sizes are detected, it is the least of them: an upper bound.

    Args:
        sizes: (n,) rising.
        share: (n,) of the touches of each size that are detected.
    """
    enough = np.logical_and.accumulate((share >= DETECTED)[::-1])[::-1]
    if not enough.any():
        return float("nan")
    k = int(enough.argmax())
    if k == 0:
        return float(sizes[0])
    part = (DETECTED - share[k - 1]) / (share[k] - share[k - 1])
    low, high = np.log(sizes[k - 1 : k + 1])
    return float(np.exp(low + part * (high - low)))


def _places(touches: pd.DataFrame, keys: list[Any]) -> tuple[Array, Array]:
    """Median error (k,) and mean displacement (k, 2) [mm] of the detected touches of each place."""
    found = touches[touches["detected"]]
    offset = _offset(found)
    by = [(found["place"] == key).to_numpy() for key in keys]
    error = [np.median(np.hypot(*offset[of].T)) if of.any() else np.nan for of in by]
    bias = [offset[of].mean(axis=0) if of.any() else np.full(2, np.nan) for of in by]
    return np.array(error), np.array(bias)


def _offset(touches: pd.DataFrame) -> Array:
    """Displacement (n, 2) [mm] of the found places from the true ones."""
    found = touches[["found_x_mm", "found_y_mm"]].to_numpy(np.float64)
    return np.asarray(found - 1e3 * touches[["x_m", "y_m"]].to_numpy(np.float64))


def least_apart(pairs: pd.DataFrame, share: float, column: str = "apart") -> float:
    """Least distance [mm] from which on at least `share` of the pairs are told apart; or NaN."""
    by = pairs.groupby("probe_distance_mm")[column].mean().sort_index(ascending=False)
    enough = (by >= share).cumprod().astype(bool)
    return float(by.index[enough].min()) if enough.any() else float("nan")


def roc(untouched: Array, touched: Array) -> Array:
    """Share of false alarms and of detections (2, m) at every threshold, from (0, 0) to (1, 1)."""
    limits = np.unique(np.concatenate([untouched, touched]))[::-1]
    ends = [
        np.searchsorted(np.sort(-of), -limits, side="right") / len(of)
        for of in (untouched, touched)
    ]
    return np.concatenate([np.zeros((2, 1)), np.array(ends)], axis=1)


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope of the least-squares line of `y` over `x`, and its R^2; NaN where y is constant."""
    if np.ptp(y) == 0 or np.ptp(x) == 0:
        return 0.0, float("nan")
    slope = float(np.polyfit(x, y, 1)[0])
    return slope, float(np.corrcoef(x, y)[0, 1] ** 2)


def figures_of(
    touch: pd.DataFrame, pair: pd.DataFrame, smallest: Array, gain: Array, curve: Array
) -> dict[str, float]:
    """Return the figures of a level.

    - `detected`: share of all touches; `auc`: area under the ROC.
    - `smallest_pa`, `smallest_s_mm2`: medians over the places; one that feels nothing counts as
      infinite.
    - `error_mm`: median error of detected touches; `pull`, `pull_low`, `pull_high`: see
      `pull_to_centre`.
    - `least_mm`: least distance from which on 90 % of the pairs are told apart;
      `truth_least_mm`: the same of the true images.
    - `false_pairs`: share of detected single touches that are shown as several.
    - `linearity`: median over places of R^2 of shown over true strength; `unevenness`: coefficient
      of variation of its slope over the places.
    """
    found = touch[touch["detected"]]
    error = np.hypot(*_offset(found).T)
    pull, low, high = pull_to_centre(touch)
    linear = [
        _line(numbers(of, "true"), numbers(of, "shown"))[1] for _, of in touch.groupby("place")
    ]
    typical = np.median(np.where(np.isnan(smallest), np.inf, smallest), axis=0)
    typical[np.isinf(typical)] = np.nan
    return {
        "detected": float(touch["detected"].mean()),
        "auc": float(np.trapezoid(curve[1], curve[0])),
        "smallest_pa": float(typical[0]),
        "smallest_s_mm2": float(typical[1]),
        "error_mm": float(np.median(error)) if len(error) else float("nan"),
        "pull": pull,
        "pull_low": low,
        "pull_high": high,
        "least_mm": least_apart(pair, APART),
        "truth_least_mm": least_apart(pair, APART, "truth_apart"),
        "false_pairs": float((found["count"] > 1).mean()) if len(found) else float("nan"),
        "linearity": float(np.nanmedian(linear)) if np.isfinite(linear).any() else float("nan"),
        "unevenness": float(np.std(gain) / np.mean(gain)) if np.mean(gain) else float("nan"),
    }


def pull_to_centre(touch: pd.DataFrame) -> tuple[float, float, float]:
    """Share of a touch's distance from the centre that its image loses, with a 95 % interval.

    It is 1 minus the slope of found places over true ones, both from the centre of the lattice, by
    least squares over detected touches: 0 without a pull, 1 where all are found at one place,
    negative where they are pushed out. The interval is of a bootstrap over places.
    """
    centre = 1e3 * touch.groupby("place")[["x_m", "y_m"]].first().mean().to_numpy(np.float64)
    found = touch[touch["detected"]]
    true = 1e3 * found[["x_m", "y_m"]].to_numpy(np.float64) - centre
    shown = true + _offset(found)
    keys, group = np.unique(found["place"].to_numpy(np.float64), return_inverse=True)
    if len(keys) < 2:
        return float("nan"), float("nan"), float("nan")
    cross = np.bincount(group, (shown * true).sum(axis=1))
    square = np.bincount(group, (true * true).sum(axis=1))
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(len(keys), np.full(len(keys), 1 / len(keys)), size=_DRAWS)
    below = drawn @ square
    draws = 1 - (drawn @ cross)[below > 0] / below[below > 0]
    low, high = np.quantile(draws, (0.025, 0.975))
    return float(1 - cross.sum() / square.sum()), float(low), float(high)
