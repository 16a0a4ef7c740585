"""What images of the design in `scenarios.phantoms.acuity` show, a row for each image.

A record of the leaderboard has few images: it keeps these rows, as `SEEN_FILE`.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import Run, cells_of, read_table
from eitbench.benchmark.findings.two_touch import are_apart
from eitbench.benchmark.metrics import tactile
from eitbench.benchmark.metrics.greit import greit_figures, mean_magnitude, spread
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.benchmark.rundir.tables import wrong_kind
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.phantoms.contacts import Contacts, contacts, locate
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

_BLOCK = 256
_NEEDED = ("family", "place", "pressure_pa", "snr_db", "x_m", "y_m", "x2_m", "y2_m",
           "probe_distance_mm")  # fmt: skip
GREIT = ("amplitude", "position_error_mm", "resolution", "shape_deformation", "ringing")
SEEN_FILE = "acuity.parquet"
_KEYS = ["scenario", "method", "sample"]
_SEEN = (
    "shown", "true", "found_x_mm", "found_y_mm", "count", "apart", "truth_apart", "magnitude",
    "spread", *GREIT, "signal", "rms",
)  # fmt: skip


def seen_table(run: Run) -> pd.DataFrame:
    """What all images of a run show: a row for each image, for `SEEN_FILE`; empty of other runs.

    Raises:
        DataCorruptError: the images of the run are damaged.
    """
    found = [
        table[["sample", *_SEEN]].assign(scenario=scenario, method=method)
        for scenario, method, _, table in seen_tables(run)
    ]
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def has_acuity(run: Run) -> bool:
    """True for runs of a suite with the design of acuity."""
    scenarios = run.manifest["plan"]["suite"]["scenarios"]
    return any(one.get("acuity") is not None for one in scenarios)


def seen_tables(run: Run) -> Iterator[tuple[str, str, Sensor, pd.DataFrame]]:
    """The scenario, method, sensor and rows of `seen` of each cell that has all three parts."""
    if not has_acuity(run):
        return
    suite = suite_of(run.manifest)
    designed = {
        one.name: one.nominal_sensor
        for one in suite.scenarios
        if isinstance(one, SimulatedScenario) and one.acuity is not None
    }
    kept = _kept(run.path / SEEN_FILE) if (run.path / SEEN_FILE).is_file() else None
    for (scenario, method), cell in cells_of(run.samples).items():
        if scenario not in designed or not set(_NEEDED) <= set(cell):
            continue
        sensor = designed[scenario]
        if kept is None:
            table = _seen_in(run, scenario, method, cell, sensor)
        else:
            table = cell[[*_KEYS, *_NEEDED]].merge(kept, on=_KEYS)
            if len(table) != len(cell):
                raise DataCorruptError(
                    f"{run.path / SEEN_FILE} lacks images of {method!r} on {scenario!r}, or has "
                    "some twice: make the record again."
                )
        if table is not None and {"no-touch", "touch", "pair"} <= set(table["family"]):
            yield scenario, method, sensor, table


def _kept(path: Path) -> pd.DataFrame:
    table = read_table(path)
    if not {*_KEYS, *_SEEN} <= set(table) or wrong_kind(table, (), ("sample", *_SEEN)):
        raise DataCorruptError(f"{path} does not hold what images show: make the record again.")
    return table


def _seen_in(
    run: Run, scenario: str, method: str, cell: pd.DataFrame, sensor: Sensor
) -> pd.DataFrame | None:
    """What the images of a cell show, with the `signal` and `rms` of its voltages (`_signal`).

    None where images lack.
    """
    samples = cell["sample"].tolist()
    shown = []
    for first in range(0, len(samples), _BLOCK):
        block = samples[first : first + _BLOCK]
        images = run.estimates(scenario, method, block)
        truth = run.scene(scenario, block).truth
        if images is None or truth is None:
            return None
        rows = cell.iloc[first : first + _BLOCK]
        shown.append(seen(images.astype(np.float64), truth, rows, sensor))
    table = pd.concat(shown, ignore_index=True).assign(sample=samples)
    if "touch" not in set(table["family"]):
        return table
    truth = run.scene(scenario, [samples[int(nearest_the_middle(table, sensor).index[0])]]).truth
    assert truth is not None  # as of all samples
    signal, rms = _signal(truth, sensor)
    return table.assign(signal=signal, rms=rms)


def _signal(truth: Array, sensor: Sensor) -> tuple[float, float]:
    """Of a true image (1, H, W): the mean |change| of the voltages, and their rms [V/A].

    Voltages are those of the nominal model.
    """
    model = forward_model(sensor)
    touched, untouched = model.voltages(truth)[0], model.voltages(model.background)
    (signal,) = mean_magnitude((touched - untouched)[None])
    return float(signal), float(np.sqrt(np.mean(touched**2)))


def firmest(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of single touches of the greatest pressure."""
    touch = table[table["family"] == "touch"]
    pressure = touch["pressure_pa"]
    found: pd.DataFrame = touch.loc[pressure == pressure.max()]
    return found


def nearest_the_middle(table: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """The firmest touches nearest to the sensor's centre: the draws of one of them."""
    pressed = firmest(table)
    away = np.hypot(*(pressed[["x_m", "y_m"]].to_numpy(np.float64) - sensor.outline.centre).T)
    nearest = pressed["place"].iloc[int(away.argmin())]
    found: pd.DataFrame = pressed.loc[pressed["place"] == nearest]
    return found


def seen(images: Array, truth: Array, samples: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """Return what images (n, H, W) [S/m] show: columns of `samples`, and what follows.

    Added are `shown` and `true`, strengths [S/m mm^2]; `found_x_mm`, `found_y_mm`, the place of a
    single touch; `count` of the contacts shown; whether two touches are told apart, `apart`, also
    in the true image, `truth_apart`; GREIT's figures of single touches; and, for the noise figure,
    `magnitude` and `spread` of the pixels [S/m].
    An image that is not finite shows nothing of a touch, and of an untouched sensor a touch of
    infinite strength: a method that fails gains nothing by it.
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
    pixels = contrast[:, sensor.mask]
    table["magnitude"], table["spread"] = mean_magnitude(pixels), spread(pixels)
    failed = ~valid & (table["family"] == "no-touch").to_numpy()
    table["shown"] = table["shown"].mask(failed, np.inf)
    table["spread"] = table["spread"].mask(failed, np.nan)
    return table.join(_greit(contrast, truth - sensor.background, table, sensor))


def _greit(contrast: Array, truth: Array, table: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """GREIT's figures of single touches; NaN of other rows."""
    rows = np.flatnonzero(table["family"] == "touch")
    of_truth = truth[rows][:, sensor.mask].sum(axis=1)
    sign = np.sign(of_truth)[:, None, None]
    x, y = (axis - c for axis, c in zip(sensor.pixel_centres, sensor.outline.centre, strict=True))
    target = table[["x_m", "y_m"]].to_numpy(np.float64)[rows] - sensor.outline.centre
    area = sensor.pixel_size[0] * sensor.pixel_size[1]
    found = greit_figures(sign * contrast[rows], target, x, y, sensor.mask, area)
    values = np.full((len(table), len(GREIT)), np.nan)
    values[rows] = np.stack(
        [found.amplitude / np.abs(of_truth), 1e3 * found.position_error, found.resolution,
         found.shape_deformation, found.ringing], axis=1,
    )  # fmt: skip
    return pd.DataFrame(values, columns=list(GREIT))


def _told_apart(found: Contacts, table: pd.DataFrame) -> NDArray[np.bool_]:
    """Whether two touches are told apart (n,), by the rule of `two_touch`; False of other rows."""
    places = contact_places(table)
    apart = np.zeros(len(table), dtype=np.bool_)
    for n in np.flatnonzero(table["family"] == "pair").tolist():
        strongest = found.position[found.of(n)][:2]
        if len(strongest) == 2:
            farthest = 1e3 * tactile.distances(places[n], strongest).max()
            apart[n] = are_apart(farthest, table["probe_distance_mm"][n])
    return apart
