"""Presses of a skin for the transfer question: test presses, labelled and unlabelled ones.

Presses of a recorded set are put into an order that is drawn by a key of the files' hashes. The
first ones of this order, a fifth of all but at most `TEST`, are located; they are the same for
every number of labelled presses. The rest is the pool: its first presses are labelled, so that
the first 10 are among the first 25; its first `REGISTRATION` register methods that have none; and
the frames of the whole pool are given without their places, in the order of time. No test press
is ever learned from, with or without its place.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.guard import check_open
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import RecordedScenario, TransferScenario

TEST = 500
"""Most presses of a skin that are located."""
REGISTRATION = 25
"""Presses that register the places of methods that have no labelled ones."""


@dataclass(frozen=True, eq=False)
class Presses:
    """Differences of presses to the released skin, and their places.

    Attributes:
        differences: (n, M) in the units of the board, of which no two need be alike.
        places: (n, 2) [m], in the coordinates of the skin's robot.
    """

    differences: Array
    places: Array

    def __post_init__(self) -> None:
        self.differences.setflags(write=False)
        self.places.setflags(write=False)

    def __len__(self) -> int:
        """Number of presses n."""
        return len(self.differences)

    def __getitem__(self, rows: NDArray[np.intp] | slice) -> "Presses":
        """The presses at `rows`."""
        return Presses(self.differences[rows], self.places[rows])


@dataclass(frozen=True, eq=False)
class Learnable:
    """What methods are given of a skin.

    Attributes:
        sensor: the nominal sensor.
        reference: (M,) the reference frame; the model's where only differences were measured.
        labelled: presses of the skin whose places methods learn from.
        unlabelled: (u, M) differences of all presses of the skin but those to be located.
        others: all presses of the other skins, by the names of their sets. Their places are those
            on `sensor` where electrodes of the same number lie on each other.
    """

    sensor: Sensor
    reference: Array
    labelled: Presses
    unlabelled: Array
    others: Mapping[str, Presses]


@dataclass(frozen=True, eq=False)
class TransferData:
    """The data of a scenario of the kind "transfer".

    Attributes:
        given: to methods.
        registration: presses that methods locate without knowing their places, which give the
            similarity to the robot's coordinates; none where presses are labelled.
        test: presses that methods are scored on.
    """

    given: Learnable
    registration: Presses
    test: Dataset


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of a recorded set.

    Attributes:
        test: rows that are located.
        pool: the rest, in the order in which they are labelled.
    """

    test: NDArray[np.int64]
    pool: NDArray[np.int64]

    @property
    def sha256(self) -> str:
        """SHA-256 (hex) of the rows."""
        rows = np.concatenate([self.test, [-1], self.pool])
        return hashlib.sha256(rows.astype("<i8").tobytes()).hexdigest()


def split(recording: str, n: int) -> Split:
    """The split of a recorded set of `n` presses."""
    files = sorted(file.sha256 for file in recorded_set(recording).files)
    order = generator("transfer", *files).permutation(n)
    test = min(TEST, n // 5)
    return Split(order[:test], order[test:])


def load_transfer(scenario: TransferScenario, limit: int | None = None) -> TransferData:
    """The data of `scenario`, with the first `limit` presses to be located, or all.

    Raises:
        InputError: a set with touches of several contacts, or with fewer presses than are needed;
            the test split is closed (see `guard`).
        DataUnavailableError, DataCorruptError: as for `read_recording`.
    """
    check_open("test")
    if scenario.same_skin:
        raise InputError(f"Scenario {scenario.name!r}: {scenario.same_skin}")
    presses, reference, samples = _presses_of(scenario.recording)
    rows = split(scenario.recording, len(presses))
    needed = max(scenario.labelled, REGISTRATION)
    if len(rows.pool) < needed:
        raise InputError(
            f"Scenario {scenario.name!r} needs {needed} presses to learn from, and the recorded "
            f"set {scenario.recording!r} has {len(rows.pool)} beside those that are located."
        )
    test = rows.test[:limit]
    named = [f"{scenario.recording} press {row}" for row in test]
    about = {"sample": np.arange(len(test)), "phantom": named, "cluster": named}
    columns = samples.iloc[test].drop(columns=["split", *about], errors="ignore")
    table = pd.concat([pd.DataFrame(about), columns.reset_index(drop=True)], axis=1)
    sensor = scenario.nominal_sensor
    return TransferData(
        Learnable(
            sensor,
            reference,
            labelled=presses[rows.pool[: scenario.labelled]],
            unlabelled=presses.differences[np.sort(rows.pool)],
            others={other: _placed(other, sensor) for other in scenario.others},
        ),
        registration=presses[rows.pool[: 0 if scenario.labelled else REGISTRATION]],
        test=Dataset(
            scenario=scenario.name,
            split="test",
            sensor=sensor,
            voltages=reference + presses.differences[test],
            references=np.tile(reference, (len(test), 1)),
            samples=table,
            truth="position",
            data_hash=scenario.data_hash("test"),
        ),
    )


def _placed(recording: str, sensor: Sensor) -> Presses:
    """All presses of another skin, with their places on `sensor`."""
    own = RecordedScenario(name="other", recording=recording).nominal_sensor
    onto = None
    if own.pattern.describe() == sensor.pattern.describe():
        from_, to = _electrodes(own), _electrodes(sensor)
        onto = fit_similarity(from_, to)
        apart = np.inf if onto is None else np.hypot(*(onto(from_) - to).T).max()
    # Farther off, an electrode is nearer to a neighbour's place.
    if onto is None or apart > sensor.outline.perimeter / sensor.n_electrodes / 2:
        raise InputError(
            f"The electrodes of {recording!r} are not those of {sensor.name!r}: the other skins "
            "need as many, in the same places, driven in the same pattern."
        )
    presses = _presses_of(recording)[0]
    return Presses(presses.differences, onto(presses.places))


def _electrodes(sensor: Sensor) -> Array:
    """Centres (E, 2) of the electrodes [m]."""
    middles = np.array([electrode.centre for electrode in sensor.electrodes])
    return sensor.outline.point(middles)


def _presses_of(recording: str) -> tuple[Presses, Array, pd.DataFrame]:
    """All presses of a set, its reference frame (M,) and the rows of its samples."""
    return _presses(recording, tuple(file.sha256 for file in recorded_set(recording).files))


@lru_cache(maxsize=32)  # a skin is one of the others of all the others
def _presses(recording: str, files: tuple[str, ...]) -> tuple[Presses, Array, pd.DataFrame]:
    """`_presses_of`, read again when one of the `files` has changed."""
    del files
    found = read_recording(recording)
    if "contacts" in found.samples:
        raise InputError(
            f"The recorded set {recording!r} has touches of several contacts, and one place is "
            "learned for each: leave them out."
        )
    differences = np.asarray(found.voltages - found.reference, dtype=np.float64)
    places = found.samples[["x_m", "y_m"]].to_numpy(np.float64)
    return Presses(differences, places), np.asarray(found.reference, np.float64), found.samples
