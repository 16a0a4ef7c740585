"""Positions of real presses from voltages, learned from few real presses and cross-validated.

Here estimators may learn from real presses of the sensor they are scored on. Presses are split into
`FOLDS` parts in a random order; each part is scored with estimators that learned from the first
0, 25, ... presses of the other parts, as far as there are so many.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import joblib
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.methods import Problem
from eitbench.methods.places.kernel_ridge import Kernel, gaussians, kernel_ridge, linear
from eitbench.methods.places.place_network import REAL, SIMULATED, PlaceNetwork, TrainingPhase
from eitbench.methods.training.samples import no_split
from eitbench.scenarios.arrays import Array, unit_frames
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import RecordedScenario
from eitbench.scenarios.suites.suite import learned_from

COUNTS = (0, 25, 100, 400)
FOLDS = 5
SIMULATED_PRESSES = 3000
SEEDS = (0, 1, 2)
"""Seeds of the networks whose places are averaged."""


@dataclass(frozen=True, eq=False)
class Presses:
    """Frames and places of presses.

    Attributes:
        frames: (n, M) differences to the reference frame.
        places: (n, 2) [m].
    """

    frames: Array
    places: Array

    def __len__(self) -> int:
        """Number of presses n."""
        return len(self.frames)

    def __getitem__(self, rows: NDArray[np.intp] | slice) -> "Presses":
        """Return the presses at `rows`."""
        return Presses(self.frames[rows], self.places[rows])


Estimator = Callable[[Array], Array]
"""A function from differences (n, M) to places (n, 2) [m]."""


class Estimators:
    """Estimators that learn places from real presses, from simulated ones, or from both."""

    def __init__(self, simulated: Presses, centre: Array, scale: float) -> None:
        m = simulated.frames.shape[1]
        self._untrained = [PlaceNetwork(m, centre, scale, seed) for seed in SEEDS]
        self._pretrained = _trained(self._untrained, simulated, SIMULATED)
        self._centre = centre

    def known(self, count: int) -> Mapping[str, Callable[[Presses], Estimator]]:
        """Return the estimators that can learn from `count` real presses, by name."""
        if count == 0:
            return {"one place": self._guess, "simulated network": self._simulated}
        return {
            "one place": self._guess,
            "ridge": partial(_regression, kernels=lambda _: [linear]),
            "kernel ridge": partial(_regression, kernels=gaussians),
            "simulated network": self._simulated,
            "network": lambda seen: _mean_place(_trained(self._untrained, seen, REAL)),
            "fine-tuned network": lambda seen: _mean_place(_trained(self._pretrained, seen, REAL)),
        }

    def _guess(self, presses: Presses) -> Estimator:
        place = presses.places.mean(axis=0) if len(presses) else self._centre
        return lambda frames: np.tile(place, (len(frames), 1))

    def _simulated(self, presses: Presses) -> Estimator:
        """Register the network's coordinates with the robot's by real presses."""
        estimate = _mean_place(self._pretrained)
        register = fit_similarity(estimate(presses.frames), presses.places)
        return estimate if register is None else lambda frames: register(estimate(frames))


def _regression(presses: Presses, kernels: Callable[[Array], Sequence[Kernel]]) -> Estimator:
    x = unit_frames(presses.frames)
    found = kernel_ridge(x, presses.places, kernels(x))
    return lambda frames: found(unit_frames(frames))


def _trained(
    networks: list[PlaceNetwork], presses: Presses, phase: TrainingPhase
) -> list[PlaceNetwork]:
    return [network.trained(presses.frames, presses.places, phase) for network in networks]


def _mean_place(networks: list[PlaceNetwork]) -> Estimator:
    return lambda frames: np.asarray(np.mean([network(frames) for network in networks], axis=0))


def real_trained(recording: str, *, jobs: int = 1) -> pd.DataFrame:
    """Return the errors of every estimator: `estimator`, `presses`, `press`, `error_mm`.

    Raises:
        InputError: unknown recorded set, or one without places or with too few presses.
        DataUnavailableError: the set is not here and cannot be downloaded.
    """
    recorded = recorded_set(recording)
    if recorded.truth != "position":
        raise InputError(
            f"The recorded set {recording!r} does not know where it was pressed: choose one that "
            "does (eitbench list recordings)."
        )
    # The name of a recording of one's own is its path, which is no name of a scenario.
    name = recorded.name if recorded.own is None else "own"
    scenario = RecordedScenario(name=name, recording=recording)
    real = _real(scenario)
    counts = [count for count in COUNTS if count <= len(real) * (FOLDS - 1) / FOLDS]
    if not any(counts):
        fewest = min(filter(None, COUNTS))
        raise InputError(
            f"The recorded set {recording!r} has {len(real)} presses, and at least "
            f"{math.ceil(fewest * FOLDS / (FOLDS - 1))} are needed to learn from {fewest} of them."
        )
    sensor = scenario.nominal_sensor
    x0, y0, x1, y1 = sensor.outline.bounds
    centre = np.array([x0 + x1, y0 + y1]) / 2
    estimators = Estimators(_simulated(scenario), centre, max(x1 - x0, y1 - y0) / 2)
    # The order follows from the data: a recording that was moved gives the same figures.
    key = recording if recorded.own is None else recorded.files[0].sha256
    order = generator("real-trained", key).permutation(len(real))
    folds = np.array_split(order, FOLDS)
    parts: list[pd.DataFrame] = joblib.Parallel(n_jobs=jobs, inner_max_num_threads=1)(
        joblib.delayed(_fold)(
            estimators, real, fold, np.concatenate(folds[:k] + folds[k + 1 :]), counts
        )
        for k, fold in enumerate(folds)
    )
    return pd.concat(parts, ignore_index=True)


def _fold(
    estimators: Estimators,
    real: Presses,
    scored: NDArray[np.intp],
    others: NDArray[np.intp],
    counts: Sequence[int],
) -> pd.DataFrame:
    tables = []
    for count in counts:
        for name, learn in estimators.known(count).items():
            found = learn(real[others[:count]])(real.frames[scored])
            error = 1e3 * np.hypot(*(found - real.places[scored]).T)
            row = {"estimator": name, "presses": count, "press": scored, "error_mm": error}
            tables.append(pd.DataFrame(row))
    return pd.concat(tables, ignore_index=True)


def _real(scenario: RecordedScenario) -> Presses:
    """Return all presses of the set, of every split."""
    splits = [load(scenario, split) for split in ("validation", "test")]
    if any("contacts" in data.samples for data in splits):
        raise InputError(
            f"The recorded set {scenario.recording!r} has touches of several contacts, and one "
            "place is learned for each: leave them out."
        )
    problem = Problem(splits[0].sensor, splits[0].references[0], no_split)
    return Presses(
        np.concatenate([problem.differences(data) for data in splits]),
        np.concatenate([data.samples[["x_m", "y_m"]].to_numpy(np.float64) for data in splits]),
    )


def _simulated(scenario: RecordedScenario) -> Presses:
    data = load(learned_from(scenario), "train", SIMULATED_PRESSES)
    assert data.conductivity is not None  # simulated
    return Presses(
        data.voltages - data.references,
        locate(data.conductivity - data.sensor.background, data.sensor),
    )
