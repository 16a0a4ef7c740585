"""Figures of one method's estimates on one data set, by what is known of the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from eitbench.benchmark.metrics import tactile
from eitbench.benchmark.metrics.image_metrics import cc, image_figures
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS, bounded_score, score
from eitbench.benchmark.metrics.tactile import Similarity
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import Contacts, contacts, is_constant, locate
from eitbench.scenarios.sensors.sensor import Sensor

if TYPE_CHECKING:
    from eitbench.scenarios.data.datasets import Dataset

Columns = dict[str, NDArray[np.float64] | NDArray[np.bool_]]

_BLOCK = 256
REGISTRATION_FRAMES = 100
"""Validation presses, the first ones, that register a method's images with the robot."""
LEAST_PRESSES = 3
"""Fewer validation presses determine no registration."""


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The part of a `Dataset` that scoring needs.

    Attributes:
        scenario: its name.
        sensor: the nominal sensor.
        samples: one row per frame.
        truth: what is known of each frame.
        conductivity: (n, H, W) [S/m], where it is known.
        classes: (n, H, W), where they are known.
    """

    scenario: str
    sensor: Sensor
    samples: pd.DataFrame
    truth: Literal["conductivity", "position", "classes", "none"]
    conductivity: Array | None = None
    classes: NDArray[np.int8] | None = None


def evaluate(
    dataset: Dataset | GroundTruth, estimates: ArrayLike, registration: Similarity | None = None
) -> pd.DataFrame:
    """Return one row per sample with `sample`, `METRIC_COLUMNS` and `cc_undefined`.

    Estimates are scored as float32, the precision they are kept in. A frame with a value that is
    not finite inside the sensor is charged what an image of the untouched sensor gets: such an
    image says no more than none.

    Args:
        dataset: frames with what is known of them.
        estimates: (n, H, W) absolute conductivity [S/m].
        registration: maps the image's frame onto the robot's; needed where only positions are
            known, see `fit_registration`.

    Raises:
        InputError: estimates of the wrong shape, or no registration where it is needed.
    """
    images = _imputed(dataset, estimates)
    figures_of = _FIGURES.get(dataset.truth)
    if figures_of is None:
        if registration is None:
            raise InputError(
                f"Scenario {dataset.scenario!r} knows positions in the robot's coordinates only: "
                "fit a registration on its validation split first."
            )
        figures_of = partial(_figures_of_positions, registration)
    n = len(images)
    table = pd.DataFrame({"sample": dataset.samples["sample"].to_numpy()})
    for name in METRIC_COLUMNS:
        table[name] = np.nan
    table["cc_undefined"] = False
    for start in range(0, n, _BLOCK):
        rows = np.arange(start, min(start + _BLOCK, n))
        for name, values in figures_of(dataset, rows, images[rows]).items():
            table.loc[rows, name] = values
    return table


def fit_registration(validation: Dataset | GroundTruth, estimates: ArrayLike) -> Similarity:
    """Fit the similarity from a method's images onto the robot's coordinates by validation presses.

    Where the images do not determine one (nothing found, or always the same place), the sensor's
    centre is put on the mean press position, unturned: such a method gains nothing by it.

    Raises:
        InputError: estimates of the wrong shape.
    """
    sensor = validation.sensor
    images = _imputed(validation, estimates).astype(np.float64)
    found = locate(images - sensor.background, sensor)
    presses = _presses(validation)
    similarity = tactile.fit_similarity(found, presses)
    if similarity is not None:
        return similarity
    x0, y0, x1, y1 = sensor.outline.bounds
    centre = np.array([x0 + x1, y0 + y1]) / 2
    return Similarity(1.0, np.eye(2), presses.mean(axis=0) - centre)


def _imputed(dataset: Dataset | GroundTruth, estimates: ArrayLike) -> NDArray[np.float32]:
    """Estimates as float32, those that are not finite replaced by the untouched sensor."""
    images = np.array(estimates, dtype=np.float32)
    expected = (len(dataset.samples), *dataset.sensor.image_shape)
    if images.shape != expected:
        raise InputError(
            f"Scenario {dataset.scenario!r} needs estimates of shape {expected}, got "
            f"{images.shape}."
        )
    mask = dataset.sensor.mask
    images[~np.isfinite(images[:, mask]).all(axis=1)] = dataset.sensor.background
    return images


def _presses(dataset: Dataset | GroundTruth) -> Array:
    return dataset.samples[["x_m", "y_m"]].to_numpy(dtype=np.float64)


def _figures_of_conductivity(
    dataset: Dataset | GroundTruth, rows: NDArray[np.intp], images: NDArray[np.float32]
) -> Columns:
    if dataset.conductivity is None:
        raise InputError(f"Scenario {dataset.scenario!r} holds no true conductivity.")
    truth, sensor = dataset.conductivity[rows], dataset.sensor
    mask, data_range = sensor.mask, sensor.data_range
    four = image_figures(truth, images, data_range, mask)
    contrast = images.astype(np.float64) - sensor.background
    figures: Columns = {
        **four,
        "score": score(**four),
        "bounded": bounded_score(four),
        "cc_undefined": is_constant(truth, mask) | is_constant(images, mask),
    }
    true = contacts(truth - sensor.background, sensor)
    return figures | _tactile(true, contacts(contrast, sensor), sensor)


def _figures_of_classes(
    dataset: Dataset | GroundTruth, rows: NDArray[np.intp], images: NDArray[np.float32]
) -> Columns:
    if dataset.classes is None:
        raise InputError(f"Scenario {dataset.scenario!r} holds no true classes.")
    truth, sensor = dataset.classes[rows].astype(np.float64), dataset.sensor
    contrast = images.astype(np.float64) - sensor.background
    mask = sensor.mask
    true, found = contacts(truth, sensor), contacts(contrast, sensor)
    figures: Columns = {
        "cc": cc(truth, contrast, mask),
        "cc_undefined": is_constant(truth, mask) | is_constant(images, mask),
        "iou_resistive": tactile.overlap(true.region, found.region, (-1,)),
        "iou_conductive": tactile.overlap(true.region, found.region, (1,)),
    }
    return figures | _tactile(true, found, sensor)


def _tactile(true: Contacts, found: Contacts, sensor: Sensor) -> Columns:
    area = true.total_area
    area_error = np.full(len(area), np.nan)
    np.divide(np.abs(found.total_area - area), area, out=area_error, where=area > 0)
    place = found.strongest(found.position, np.nan)
    return {
        "localisation_mm": 1e3 * tactile.localisation(true, found, sensor),
        "contact_count_error": np.abs(found.count - true.count).astype(np.float64),
        "area_error": area_error,
        "iou": tactile.overlap(true.region, found.region),
        "strength": found.strongest(found.strength, 0.0),
        "found_x_m": place[:, 0],
        "found_y_m": place[:, 1],
    }


def _figures_of_positions(
    registration: Similarity,
    dataset: Dataset | GroundTruth,
    rows: NDArray[np.intp],
    images: NDArray[np.float32],
) -> Columns:
    sensor = dataset.sensor
    contrast = images.astype(np.float64) - sensor.background
    place = locate(contrast, sensor)
    presses = _presses(dataset)[rows]
    error = np.hypot(*(registration(place) - presses).T)
    # Finding nothing costs what the farthest wrong place in the sensor would.
    error[np.isnan(place[:, 0])] = registration.scale * tactile.diameter(sensor)
    expected = registration.inverse(presses)
    return {
        "localisation_mm": 1e3 * error,
        "strength": contacts(contrast, sensor).total_strength,
        "found_x_m": place[:, 0],
        "found_y_m": place[:, 1],
        "expected_x_m": expected[:, 0],
        "expected_y_m": expected[:, 1],
    }


def _figures_of_response(
    dataset: Dataset | GroundTruth, _: NDArray[np.intp], images: NDArray[np.float32]
) -> Columns:
    contrast = images[:, dataset.sensor.mask].astype(np.float64) - dataset.sensor.background
    return {"response": np.sqrt(np.mean(contrast**2, axis=1))}


_FIGURES: dict[
    str, Callable[[Dataset | GroundTruth, NDArray[np.intp], NDArray[np.float32]], Columns]
] = {
    "conductivity": _figures_of_conductivity,
    "classes": _figures_of_classes,
    "none": _figures_of_response,
}
"""By what is known of the frames; positions need a registration, too."""
