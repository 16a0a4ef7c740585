"""Figures of one method's estimates on one data set, by what is known of the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from eitbench.benchmark.metrics import ktc, tactile
from eitbench.benchmark.metrics.image_metrics import cc, image_figures
from eitbench.benchmark.metrics.load import LoadCalibration, fit_load
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS, bounded_score, score
from eitbench.benchmark.metrics.threads import for_each
from eitbench.scenarios.arrays import Array, nearest_pixels
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import Contacts, contacts, is_constant, locate
from eitbench.scenarios.recordings.descriptors import LOADS, contact_places
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.similarity import Similarity, fit_similarity

if TYPE_CHECKING:
    from eitbench.scenarios.data.datasets import Dataset

Columns = dict[str, NDArray[np.float64] | NDArray[np.bool_]]

_BLOCK = 64  # frames that a thread scores at once
_REFITS = 5
_TURNS = 24
"""Tried where the middles of touches may say nothing, each mirrored, too."""
REGISTRATION_FRAMES = 100
"""Validation presses, the first ones, that register a method's images with the robot."""
LEAST_REGISTRATION_PRESSES = 3
"""Fewer validation presses determine no registration."""


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The part of a `Dataset` that scoring needs."""

    scenario: str
    sensor: Sensor
    samples: pd.DataFrame
    truth: Literal["conductivity", "position", "classes", "none"]
    conductivity: Array | None = None
    classes: NDArray[np.number] | None = None


Known: TypeAlias = "Dataset | GroundTruth"


class Scorer:
    """Scores estimates of the images of a data set; what it takes of the truth is found once.

    Attributes:
        dataset: with the truth.
    """

    def __init__(self, dataset: Known) -> None:
        self.dataset = dataset
        self._touches: dict[int, _Touches] = {}

    def __call__(
        self,
        estimates: ArrayLike,
        registration: Similarity | None = None,
        calibration: LoadCalibration | None = None,
    ) -> pd.DataFrame:
        """Return the table of `evaluate`; arguments and errors as there."""
        dataset, images = self.dataset, _imputed(self.dataset, estimates)
        if dataset.truth == "position" and registration is None:
            raise InputError(
                f"Scenario {dataset.scenario!r} has places in the robot's coordinates: first find "
                "how images map to them (`fit_registration`), on its validation split."
            )
        table = pd.DataFrame({"sample": dataset.samples["sample"].to_numpy()})
        for name in METRIC_COLUMNS:
            table[name] = np.nan
        table["cc_undefined"] = False
        found: dict[int, Columns] = {}

        def score_block(start: int) -> None:
            rows = np.arange(start, min(start + _BLOCK, len(images)))
            figures = self._figures(rows, images[rows], registration)
            if calibration is not None:
                figures |= _figures_of_loads(dataset, rows, images[rows], calibration)
            found[start] = figures

        starts = range(0, len(images), _BLOCK)
        for_each(score_block, starts)
        for start in starts:
            for name, values in found[start].items():
                table.loc[start : start + len(values) - 1, name] = values
        return table

    def _figures(
        self,
        rows: NDArray[np.intp],
        images: NDArray[np.float32],
        registration: Similarity | None,
    ) -> Columns:
        dataset = self.dataset
        contrast = images.astype(np.float64) - dataset.sensor.background
        if registration is not None and dataset.truth == "position":
            if "contacts" in dataset.samples:
                places = contact_places(dataset.samples)[rows]
                return _figures_of_contacts(registration, dataset.sensor, places, contrast)
            presses = _presses(dataset)[rows]
            return _figures_of_positions(registration, dataset.sensor, presses, contrast)
        if dataset.truth == "none":
            return {"response": np.sqrt(np.mean(contrast[:, dataset.sensor.mask] ** 2, axis=1))}
        truth = _true_images(dataset, rows)
        if rows[0] not in self._touches:
            self._touches[rows[0]] = _Touches.of(dataset, truth)
        return _figures_of_images(dataset, rows, truth, self._touches[rows[0]], images, contrast)


def evaluate(
    dataset: Known,
    estimates: ArrayLike,
    registration: Similarity | None = None,
    calibration: LoadCalibration | None = None,
) -> pd.DataFrame:
    """Return one row per sample with `sample`, `METRIC_COLUMNS` and `cc_undefined`.

    Estimates (n, H, W) of absolute conductivity [S/m] are scored as float32, the precision they are
    kept in. A frame with a value that is not finite inside the sensor is charged what an image of
    the untouched sensor gets: such an image says no more than none. Where only positions are known,
    `registration` maps the image's frame onto the robot's, see `fit_registration`; where loads were
    measured, `calibration` maps the image's strength onto them, see `fit_calibration`.

    Raises:
        InputError: estimates of the wrong shape, or no registration where it is needed.
    """
    return Scorer(dataset)(estimates, registration, calibration)


def fit_registration(validation: Known, estimates: ArrayLike) -> Similarity:
    """Fit the similarity from a method's images onto the robot's coordinates by validation presses.

    Where touches have several contacts, the middle of each touch comes first, and where no touch
    has a single one, also turns and mirror images of the contacts' spread; found contacts are then
    assigned to places, and the similarity is fitted to these pairs, several times. Touches that lie
    symmetrically about one point leave open whether the sensor is turned by 180 degrees.

    Where the images do not determine one (nothing found, or always the same place), the sensor's
    centre is put on the mean press position, unturned: such a method gains nothing by it.

    Raises:
        InputError: estimates of the wrong shape.
    """
    sensor = validation.sensor
    contrast = _imputed(validation, estimates).astype(np.float64) - sensor.background
    presses = _presses(validation)
    similarity = fit_similarity(locate(contrast, sensor), presses)
    if similarity is not None:
        several = "contacts" in validation.samples
        return _refitted(similarity, validation, contrast) if several else similarity
    return Similarity(1.0, np.eye(2), presses.mean(axis=0) - sensor.outline.centre)


def _refitted(similarity: Similarity, validation: Known, contrast: Array) -> Similarity:
    places, found = contact_places(validation.samples), contacts(contrast, validation.sensor)
    touches = []
    for n, known in enumerate(places):
        true = known[np.isfinite(known).all(axis=1)]
        touches.append((true, found.position[found.of(n)][: len(true)]))
    if all(len(true) > 1 for true, _ in touches):
        # Middles of touches can lie too close together to say how the sensor is turned.
        starts = [similarity, *_turned(*map(np.concatenate, zip(*touches, strict=True)))]
        similarity = min(starts, key=lambda start: _distance(start, touches))
    for _ in range(_REFITS):
        fitted = fit_similarity(*_pairs(similarity, touches))
        if fitted is None:
            break
        similarity = fitted
    return similarity


def _turned(target: Array, source: Array) -> list[Similarity]:
    """Similarities that map the centre and the spread of `source` (m, 2) onto those of `target`."""
    if len(source) < LEAST_REGISTRATION_PRESSES or not np.ptp(source, axis=0).any():
        return []
    scale = float(np.sqrt(np.var(target, axis=0).sum() / np.var(source, axis=0).sum()))
    angles = np.deg2rad(np.arange(0, 360, 360 / _TURNS))
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
    return [
        Similarity(scale, turn, target.mean(axis=0) - scale * turn @ source.mean(axis=0))
        for turn in (*turns, *(turn @ np.diag([1.0, -1.0]) for turn in turns))
    ]


def _pairs(similarity: Similarity, touches: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Found and true places (m, 2) each, those together that belong together."""
    source, target = [np.empty((0, 2))], [np.empty((0, 2))]
    for true, position in touches:
        rows, columns = tactile.matched(true, similarity(position))
        source.append(position[columns])
        target.append(true[rows])
    return np.concatenate(source), np.concatenate(target)


def _distance(similarity: Similarity, touches: Sequence[tuple[Array, Array]]) -> float:
    source, target = _pairs(similarity, touches)
    return float(np.hypot(*(similarity(source) - target).T).sum())


def knows_loads(samples: pd.DataFrame, truth: str) -> bool:
    """True where images are judged by what presses: in recordings that measured it."""
    return truth in ("position", "none") and any(name in samples for name in LOADS)


def fit_calibration(validation: Known, estimates: ArrayLike) -> LoadCalibration | None:
    """Fit the line from the strength of a method's images to measured loads; None without loads.

    Raises:
        InputError: estimates of the wrong shape.
    """
    if not knows_loads(validation.samples, validation.truth):
        return None
    return fit_load(
        validation.samples, _strength(_imputed(validation, estimates), validation.sensor)
    )


def _strength(images: NDArray[np.float32], sensor: Sensor) -> Array:
    """Integrated |contrast| (n,) of all contacts of images (n, H, W)."""
    return contacts(images.astype(np.float64) - sensor.background, sensor).total_strength


def _figures_of_loads(
    dataset: Known,
    rows: NDArray[np.intp],
    images: NDArray[np.float32],
    calibration: LoadCalibration,
) -> Columns:
    strength = _strength(images, dataset.sensor)
    error = calibration.error(strength, dataset.samples.iloc[rows])
    figures: Columns = {"strength": strength}
    figures["measured_load_error_percent"] = 100 * error / calibration.full_scale
    if calibration.quantity == "force_N":
        figures["measured_force_error_n"] = error
    return figures


def _imputed(dataset: Known, estimates: ArrayLike) -> NDArray[np.float32]:
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


def _soft_presses(dataset: Known) -> NDArray[np.bool_]:
    """The samples (n,) that a pressure is known of."""
    if "pressure_pa" not in dataset.samples:
        return np.zeros(len(dataset.samples), dtype=np.bool_)
    return dataset.samples["pressure_pa"].notna().to_numpy()


def _presses(dataset: Known) -> Array:
    """Places (n, 2) [m], of several contacts their middle."""
    places = contact_places(dataset.samples)
    return places[:, 0] if places.shape[1] == 1 else np.asarray(np.nanmean(places, axis=1))


class _Touches(NamedTuple):
    """What images are compared with, of the true images of a block.

    Attributes:
        contacts: the true ones.
        zones: around their edges; of images of classes there are none.
    """

    contacts: Contacts
    zones: list[tactile.EdgeZone | None]

    @classmethod
    def of(cls, dataset: Known, truth: Array) -> _Touches:
        """Those of true images (n, H, W)."""
        conducts = dataset.truth == "conductivity"
        contrast = truth - dataset.sensor.background if conducts else truth
        true = contacts(contrast, dataset.sensor)
        return cls(true, tactile.edge_zones(true, contrast, dataset.sensor) if conducts else [])


def _true_images(dataset: Known, rows: NDArray[np.intp]) -> Array:
    """True conductivity or classes (n, H, W) on the pixels of estimates."""
    known = dataset.conductivity if dataset.truth == "conductivity" else dataset.classes
    if known is None:
        raise InputError(f"Scenario {dataset.scenario!r} holds no true {dataset.truth}.")
    return nearest_pixels(known[rows], dataset.sensor.image_shape).astype(np.float64)


def _figures_of_images(
    dataset: Known,
    rows: NDArray[np.intp],
    truth: Array,
    touches: _Touches,
    images: NDArray[np.float32],
    contrast: Array,
) -> Columns:
    sensor, mask = dataset.sensor, dataset.sensor.mask
    true, found = touches.contacts, contacts(contrast, sensor)
    figures: Columns = {"cc_undefined": is_constant(truth, mask) | is_constant(images, mask)}
    if dataset.truth == "conductivity":
        four = image_figures(truth, images, sensor.data_range, mask)
        figures |= {**four, "score": score(**four), "bounded": bounded_score(four)}
        edge, artefacts = tactile.edges_and_artefacts(touches.zones, contrast, sensor)
        figures |= {"edge": edge, "artefacts": artefacts}
        pressed = _soft_presses(dataset)[rows]
        if pressed.any():
            shown, applied = (tactile.force(which, sensor) for which in (images, truth))
            error = np.abs(shown - applied) / applied
            figures["force_error"] = np.where(pressed, error, np.nan)
    else:
        figures["cc"] = cc(truth, contrast, mask)
        if dataset.classes is not None and dataset.classes.shape[1:] == (ktc.SIDE, ktc.SIDE):
            inside = np.where(mask, contrast, 0.0)  # as the challenge fills its images up
            figures["ktc_score"] = ktc.ktc_score(dataset.classes[rows], inside)
        for name, sign in (("iou_resistive", -1), ("iou_conductive", 1)):
            figures[name] = tactile.overlap(true.region, found.region, (sign,))
    area = true.total_area
    area_error = np.full(len(area), np.nan)
    np.divide(np.abs(found.total_area - area), area, out=area_error, where=area > 0)
    place = found.strongest(found.position, np.nan)
    return figures | {
        "localisation_mm": 1e3 * tactile.localisation(true, found, sensor),
        "contact_count_error": np.abs(found.count - true.count).astype(np.float64),
        "area_error": area_error,
        "iou": tactile.overlap(true.region, found.region),
        "strength": found.strongest(found.strength, 0.0),
        "found_x_m": place[:, 0],
        "found_y_m": place[:, 1],
    }


def _figures_of_positions(
    registration: Similarity, sensor: Sensor, presses: Array, contrast: Array
) -> Columns:
    place = locate(contrast, sensor)
    error = np.hypot(*(registration(place) - presses).T)
    error[np.isnan(place[:, 0])] = _cost_of_nothing(registration, sensor)
    expected = registration.inverse(presses)
    return {
        "localisation_mm": 1e3 * error,
        "strength": contacts(contrast, sensor).total_strength,
        "found_x_m": place[:, 0],
        "found_y_m": place[:, 1],
        "expected_x_m": expected[:, 0],
        "expected_y_m": expected[:, 1],
    }


def _cost_of_nothing(registration: Similarity, sensor: Sensor) -> float:
    """Error [m] of an image without a contact: what the farthest wrong place in the sensor costs.

    A similarity that shrinks what it cannot register does not make it cheaper.
    """
    return max(registration.scale, 1.0) * tactile.diameter(sensor)


def _figures_of_contacts(
    registration: Similarity, sensor: Sensor, places: Array, contrast: Array
) -> Columns:
    """Figures of touches of up to k contacts, at places (n, k, 2) [m], NaN for those not there."""
    found = contacts(contrast, sensor)
    registered = registration(found.position)
    missing = _cost_of_nothing(registration, sensor)
    mean, farthest = np.full(len(places), missing), np.full(len(places), missing)
    expected = places[:, 0].copy()
    for n, known in enumerate(places):
        true = known[np.isfinite(known).all(axis=1)]
        if len(position := registered[found.of(n)][: len(true)]):
            error = tactile.distances(true, position)
            mean[n], farthest[n] = error.mean(), error.max()
            # A picture shows the strongest contact, and the true one nearest to it.
            expected[n] = true[np.hypot(*(true - position[0]).T).argmin()]
    place, expected = found.strongest(found.position, np.nan), registration.inverse(expected)
    true_count = np.isfinite(places).all(axis=2).sum(axis=1)
    return {
        "localisation_mm": 1e3 * mean,
        "farthest_contact_mm": 1e3 * farthest,
        "contact_count_error": np.abs(found.count - true_count).astype(np.float64),
        "strength": found.total_strength,
        "found_x_m": place[:, 0],
        "found_y_m": place[:, 1],
        "expected_x_m": expected[:, 0],
        "expected_y_m": expected[:, 1],
    }
