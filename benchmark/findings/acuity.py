"""Tactile acuity of methods, from the stored images of the design in `scenarios.phantoms.acuity`.

What is felt: a touch is detected if the strength that its image shows exceeds a threshold for 1 %
of false alarms, which is taken from frames without a touch, of the same method at the same noise.
Where it is felt: error and bias of the place. How far apart: two touches are told apart by the rule
of `two_touch`. How strong: shown strength over true strength.

The strength of an image is that of all its contacts (`scenarios.phantoms.contacts`): |contrast|
integrated over them [S/m m^2]. GREIT's figures of merit (`benchmark.metrics.greit`) are those of
the firmest touches.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.findings.acuity_seen import GREIT, firmest, nearest_the_middle, seen_tables
from eitbench.benchmark.findings.two_touch import least_distance
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.greit import noise_figure
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, intervals
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.sensor import Sensor

FALSE_ALARMS = 0.01
DETECTED, APART = 0.5, 0.9
"""Share of touches detected at the smallest one, and of pairs told apart at the least distance."""
_DRAWS = 1000
_RIM_POINTS = 720


@dataclass(frozen=True, eq=False)
class AcuityResult:
    """Acuity of one method at one level of noise; places are those of the lattice.

    Attributes:
        scenario, method: names.
        snr_db: of the frames [dB].
        outline: (m, 2) points of the sensor's rim [m].
        places: a row for each place, its columns:
            `x_mm`, `y_mm`, and `depth_mm` from the rim;
            `smallest_pa`, `smallest_s_mm2`, the smallest pressure detected, and the same as true
            contrast times area [S/m mm^2]; NaN where the firmest is not;
            `error_mm`, median error of the place of detected touches, and `bias_x_mm`,
            `bias_y_mm`, their mean displacement; NaN without one;
            `room_mm`, distance of the farthest pairs around the place, NaN where none has room, and
            `least_mm`, least distance from which on all pairs are told apart, NaN where the
            farthest are not;
            `gain`, slope of shown over true strength;
            GREIT's figures, means over the firmest touches; NaN where one of them shows nothing.
        roc: (2, m) false alarms and detections at falling thresholds, all pressures together.
        figures: one number each, by the names of `ACUITY_SPECS`, and the ends of the interval of
            the pull, `pull_low` and `pull_high`.
    """

    scenario: str
    method: str
    snr_db: float
    outline: Array
    places: pd.DataFrame
    roc: Array
    figures: dict[str, float]


def acuity_of(run: Run) -> list[AcuityResult]:
    """Return the acuity of every method at every level of noise; none of other runs.

    Frames that a method gave no valid image of count as not detected, and pairs as not told apart.

    Raises:
        DataCorruptError: the images of the run are damaged.
    """
    return [
        result_of(scenario, method, float(table["snr_db"].iloc[0]), table, sensor)
        for scenario, method, sensor, table in seen_tables(run)
    ]


def result_of(
    scenario: str, method: str, level: float, table: pd.DataFrame, sensor: Sensor
) -> AcuityResult:
    """Return the acuity at one level of noise [dB] from the rows of `seen`.

    With their columns `signal` and `rms` (`_signal`) of the firmest touch nearest to the middle
    there is a noise figure.
    """
    none, touch, pair = (table[table["family"] == part] for part in ("no-touch", "touch", "pair"))
    limit = threshold(numbers(none, "shown"))
    touch = touch.assign(detected=touch["shown"] > limit)
    outline = sensor.outline.point(
        np.linspace(0.0, sensor.outline.perimeter, _RIM_POINTS, endpoint=False)
    )
    places = _places(touch, pair, outline)
    curve = roc(numbers(none, "shown"), numbers(touch, "shown"))
    figures = figures_of(touch, pair, places, curve)
    if {"signal", "rms"} <= set(table):
        signal, rms = table[["signal", "rms"]].iloc[:1].to_numpy(np.float64).T
        # The noise of the frame and of its reference frame.
        noise = np.sqrt(2) * rms * 10 ** (-level / 20)
        figures["noise_figure"] = noise_figure(
            signal,
            noise,
            numbers(nearest_the_middle(touch, sensor), "magnitude"),
            numbers(none, "spread"),
        )
    return AcuityResult(scenario, method, level, outline, places, curve, figures)


def _places(touch: pd.DataFrame, pair: pd.DataFrame, outline: Array) -> pd.DataFrame:
    """The maps of `AcuityResult`."""
    pairs: dict[Any, pd.DataFrame] = dict(iter(pair.groupby("place")))
    of_firmest: dict[Any, pd.DataFrame] = dict(iter(firmest(touch).groupby("place")))
    rows = []
    for key, of in touch.groupby("place", sort=True):
        place = of[["x_m", "y_m"]].iloc[0].to_numpy(np.float64)
        pascal, strength = _smallest(of)
        found = of[of["detected"]]
        offset = _offset(found)
        bias = offset.mean(axis=0) if len(found) else (np.nan, np.nan)
        around = pairs.get(key)
        rows.append(
            {
                "x_mm": 1e3 * place[0],
                "y_mm": 1e3 * place[1],
                "depth_mm": 1e3 * float(np.hypot(*(outline - place).T).min()),
                "smallest_pa": pascal,
                "smallest_s_mm2": strength,
                "error_mm": float(np.median(np.hypot(*offset.T))) if len(found) else np.nan,
                "bias_x_mm": bias[0],
                "bias_y_mm": bias[1],
                "room_mm": np.nan if around is None else around["probe_distance_mm"].max(),
                "least_mm": np.nan if around is None else least_apart(around, 1.0),
                "gain": _line(numbers(of, "true"), numbers(of, "shown"))[0],
                **{name: of_firmest[key][name].mean(skipna=False) for name in GREIT},
            }
        )
    return pd.DataFrame(rows)


def threshold(shown: Array) -> float:
    """Strength that new frames without a touch exceed with a probability of at most 1 %.

    It is one of the n strengths `shown`: of n + 1 exchangeable frames, the new one is among the r
    strongest with probability r / (n + 1) (order statistics, as in split conformal prediction).
    The rate given these n frames may be higher than its mean. It is infinite for n < 99: of so few
    not even the strongest is exceeded so rarely.
    """
    rank = int(np.ceil((1 - FALSE_ALARMS) * (len(shown) + 1) - 1e-9))
    return float(np.sort(shown)[rank - 1]) if rank <= len(shown) else float("inf")


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


def _offset(touches: pd.DataFrame) -> Array:
    """Displacement (n, 2) [mm] of the found places from the true ones."""
    found = touches[["found_x_mm", "found_y_mm"]].to_numpy(np.float64)
    return np.asarray(found - 1e3 * touches[["x_m", "y_m"]].to_numpy(np.float64))


def least_apart(pairs: pd.DataFrame, share: float, column: str = "apart") -> float:
    """Least distance [mm] from which on at least `share` of the pairs are told apart; or NaN."""
    return least_distance(pairs.groupby("probe_distance_mm")[column].mean(), share)


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
    touch: pd.DataFrame, pair: pd.DataFrame, places: pd.DataFrame, curve: Array
) -> dict[str, float]:
    """Return the figures of a level, but for the noise figure: see `ACUITY_SPECS`."""
    found = touch[touch["detected"]]
    error = np.hypot(*_offset(found).T)
    pull, low, high = pull_to_centre(touch)
    linear = [
        _line(numbers(of, "true"), numbers(of, "shown"))[1] for _, of in touch.groupby("place")
    ]
    # A place that shows nothing counts as the worst, not as none.
    worst = dict.fromkeys(("smallest_pa", "smallest_s_mm2", *GREIT), np.inf) | {"amplitude": 0.0}
    typical = places[[*worst]].fillna(worst).median().replace(np.inf, np.nan)
    gain, amplitude = numbers(places, "gain"), numbers(places, "amplitude")
    return {
        "auc": float(np.trapezoid(curve[1], curve[0])),
        "smallest_pa": float(typical["smallest_pa"]),
        "smallest_s_mm2": float(typical["smallest_s_mm2"]),
        "error_mm": float(np.median(error)) if len(error) else float("nan"),
        "pull": pull,
        "pull_low": low,
        "pull_high": high,
        "least_mm": least_apart(pair, APART),
        "truth_least_mm": least_apart(pair, APART, "truth_apart"),
        "false_pairs": float((found["count"] > 1).mean()) if len(found) else float("nan"),
        "linearity": float(np.median(np.nan_to_num(linear))),
        "slope_cv": _variation(gain),
        "noise_figure": float("nan"),
        "amplitude": float(typical["amplitude"]),
        "amplitude_cv": _variation(amplitude),
        **{name: float(typical[name]) for name in GREIT[1:]},
    }


def _variation(values: Array) -> float:
    """Coefficient of variation of what is known of `values` (n,); NaN where their mean is 0."""
    known = values[np.isfinite(values)]
    return float(np.std(known) / np.mean(known)) if known.size and known.mean() else float("nan")


def pull_to_centre(touch: pd.DataFrame) -> tuple[float, float, float]:
    """Share of a touch's distance from the centre that its image loses, with a 95 % interval.

    It is 1 minus the slope of found places over true ones, both from the centre of the lattice, by
    least squares over detected touches: 0 without a pull, 1 where all are found at one place,
    negative where they are pushed out. The interval is of a bootstrap over places; NaN for fewer
    than `MIN_CLUSTERS`.
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
    pull = 1 - cross.sum() / square.sum()
    low, high = np.nan, np.nan
    if len(keys) >= MIN_CLUSTERS:
        low, high = intervals(np.asarray(pull), draws, len(keys))
    return float(pull), float(low), float(high)
