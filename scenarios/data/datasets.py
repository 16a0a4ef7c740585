"""Data sets: the samples of a scenario's split, ready for methods and metrics."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Literal, NamedTuple, cast, get_args

import joblib
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.simulation import (
    CleanFrames,
    clean_frames,
    phantom,
)
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.guard import check_open
from eitbench.scenarios.imperfections.imperfections import TOUCH_INTERVAL_S
from eitbench.scenarios.imperfections.noise import (
    distance_of_touch,
    measured,
    session_snr_db,
    snr_of_touch,
)
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.phantoms.phantom import Phantom, rasterise
from eitbench.scenarios.progress import with_bar
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import (
    TOUCHES,
    RecordedScenario,
    Scenario,
    SimulatedScenario,
    Split,
    TransferScenario,
)
from eitbench.scenarios.suites.suite import scenario_by_name

SNR_COLUMNS = ("snr_db", "touch_snr_db", "model_distance_db")
"""SNR of a frame, of what a touch changes in it, and distance of the model from that [dB]."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """The first n samples of one split of one scenario; its arrays are read-only.

    Attributes:
        scenario, split: names of its origin.
        sensor: the nominal sensor.
        voltages: (n, M) frames: [V/A] if simulated, in the board's own units if recorded.
        references: (n, M) the reference frame of each frame, measured like it. Frames of one
            session share theirs.
        samples: one row per frame. `sample` is its number in the split, `phantom` names the
            object, `cluster` what it shares with others: only frames of different clusters are
            independent. Simulated: `session`, `family`, `shape`, `snr_db` and `touch_snr_db` of
            the frame and of what changed in it since the reference frame: the touch and what has
            drifted (NaN if clean), `model_distance_db` (see
            `distance_of_touch`; before any calibration; NaN outside the test split), `inclusions`
            and what was drawn (NaN where a family has no such value).
            Recorded: columns of the set, such as `x_m`, `y_m`, `depth_mm`.
        truth: kind of truth that is known of each frame.
        data_hash: SHA-256 of all declared parameters.
        inverse_crime: true if the test split comes from the mesh that methods invert with; None
            for recorded data.
        phantoms: the simulated phantoms.
        classes: (n, H, W) int8 truth of recorded sets that know it: 0 background, -1 resistive,
            +1 conductive.
    """

    scenario: str
    split: Split
    sensor: Sensor
    voltages: Array
    references: Array
    samples: pd.DataFrame
    truth: Literal["conductivity", "position", "classes", "none"]
    data_hash: str
    inverse_crime: bool | None = None
    phantoms: tuple[Phantom, ...] = ()
    classes: NDArray[np.int8] | None = None

    def __post_init__(self) -> None:
        for array in (self.voltages, self.references, self.classes):
            if array is not None:
                array.setflags(write=False)

    def __len__(self) -> int:
        """Number of samples n."""
        return len(self.voltages)

    def first(self, n: int) -> "Dataset":
        """Return the first `n` samples; the hash stays that of all declared parameters."""
        return replace(
            self,
            voltages=self.voltages[:n],
            references=self.references[:n],
            samples=self.samples.iloc[:n],
            phantoms=self.phantoms[:n],
            classes=None if self.classes is None else self.classes[:n],
        )

    @cached_property
    def conductivity(self) -> Array | None:
        """True conductivity (n, H, W) [S/m] on the sensor's image grid; None for recorded data."""
        if self.truth != "conductivity":
            return None
        images = np.empty((len(self), *self.sensor.image_shape))
        for image, drawn in zip(images, self.phantoms, strict=True):
            image[:] = rasterise(drawn, self.sensor)
        images.setflags(write=False)
        return images

    @cached_property
    def frame_hashes(self) -> list[str]:
        """SHA-256 (hex) of every frame together with its reference frame."""
        return [
            hashlib.sha256(frame.tobytes() + reference.tobytes()).hexdigest()
            for frame, reference in zip(self.voltages, self.references, strict=True)
        ]


def load(
    scenario: str | Scenario,
    split: str = "test",
    limit: int | None = None,
    *,
    jobs: int = 1,
    progress: bool = False,
) -> Dataset:
    """The first `limit` samples of a scenario's split, simulated or fetched if need be.

    Args:
        scenario: one of the packaged suites' scenarios by name, or a scenario of your own.
        split: "train", "validation" or "test"; recorded scenarios have no "train".
        limit: number of samples; all by default.
        jobs: number of processes to simulate and calibrate with.
        progress: show a progress bar on stderr.

    Raises:
        InputError: unknown scenario or split, a limit or number of jobs that is no whole number of
            at least 1, or the test split where it is closed (see `guard`).
        DataUnavailableError: recorded data is neither here nor within reach.
        DataCorruptError: recorded data is not what its checksum promises.
        EitbenchError: the cache folder is not writable or full.
    """
    for what, count in (("limit", 1 if limit is None else limit), ("number of jobs", jobs)):
        whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not (whole and count >= 1):
            raise InputError(f"The {what} is a whole number of at least 1, got {count!r}.")
    if isinstance(scenario, str):
        scenario = scenario_by_name(scenario)
    if split not in get_args(Split):
        raise unknown_name("split", split, get_args(Split))
    check_open(split)
    if isinstance(scenario, TransferScenario):
        raise InputError(
            f"Scenario {scenario.name!r} has no splits of its own: load the recorded set "
            f"{scenario.recording!r}."
        )
    if isinstance(scenario, RecordedScenario):
        data = _recorded(scenario, cast("Split", split), limit, progress)
    else:
        data = _simulated(scenario, cast("Split", split), limit, jobs, progress)
        if split == "train" or (split == "validation" and scenario.ladder):
            return data  # of the nominal sensor, or of units with their faults
    return _calibrated(data, jobs, progress) if scenario.calibrated else data


def _calibrated(data: Dataset, jobs: int, progress: bool) -> Dataset:
    """The data, corrected session by session by what each reference frame shows."""
    sessions = same_reference(data.references)
    pool = worker_pool(min(jobs, len(sessions)), return_as="generator", batch_size=1)
    steps = pool(
        joblib.delayed(_corrected)(data.sensor, data.voltages[rows], data.references[rows.start])
        for rows in sessions
    )
    voltages, references = np.empty_like(data.voltages), np.empty_like(data.voltages)
    title = f"Calibrating {data.scenario}"
    corrected = with_bar(steps, title, len(sessions), show=progress)
    for rows, found in zip(sessions, corrected, strict=True):
        voltages[rows], references[rows] = found
    return replace(data, voltages=voltages, references=references)


def _corrected(sensor: Sensor, voltages: Array, reference: Array) -> tuple[Array, Array]:
    """Frames (n, M) and reference frame (M,) as the nominal sensor would have given them.

    It is found on one thread, so that its bits do not depend on how many there are.
    """
    # Imported here: it is a small inverse problem, which few scenarios pose.
    from eitbench.scenarios.imperfections.calibration import calibrate

    with threadpool_limits(1):
        found = calibrate(sensor, reference[None])
        return found.corrected(voltages), found.nominal


def same_reference(references: Array) -> list[slice]:
    """The runs of rows of `references` (n, M) that are equal, such as those of one session."""
    changes = 1 + np.flatnonzero((references[1:] != references[:-1]).any(axis=1))
    ends = [0, *changes.tolist(), len(references)]
    return [slice(start, stop) for start, stop in pairwise(ends) if stop > start]


def _simulated(
    scenario: SimulatedScenario, split: Split, limit: int | None, jobs: int, progress: bool
) -> Dataset:
    size: int = getattr(scenario, split)
    if size == 0:
        raise InputError(f"Scenario {scenario.name!r} declares no {split} samples.")
    count = size if limit is None else min(limit, size)
    simulated = partial(clean_frames, split=split, count=count, jobs=jobs, progress=progress)
    modelled = simulated(scenario.without_imperfections) if split == "test" else None
    seen = _measured(scenario, split, simulated(scenario), modelled)
    phantoms = tuple(phantom(scenario, split, sample) for sample in range(count))
    names = [f"{scenario.phantom_stream} {split} {sample}" for sample in range(count)]
    session = np.arange(count) // TOUCHES
    together = [f"{scenario.name} {split} session {k}" for k in session.tolist()]
    declared = {
        "sample": np.arange(count),
        "phantom": names,
        "cluster": together if scenario.sessions_differ(split) else names,
        "session": session,
        "family": [p.family for p in phantoms],
        "shape": [p.shape for p in phantoms],
        "snr_db": seen.snr_db,
        "touch_snr_db": seen.touch_snr_db,
        "model_distance_db": seen.model_distance_db,
        "inclusions": [len(p.inclusions) for p in phantoms],
    }
    drawn = pd.DataFrame([p.parameters for p in phantoms])
    return Dataset(
        scenario=scenario.name,
        split=split,
        sensor=scenario.nominal_sensor,
        voltages=seen.voltages,
        references=seen.references,
        samples=pd.concat([pd.DataFrame(declared), drawn], axis=1),
        truth="conductivity",
        data_hash=scenario.data_hash(split),
        inverse_crime=scenario.inverse_crime,
        phantoms=phantoms,
    )


class _Measured(NamedTuple):
    """Frames (n, M) and their reference frames (n, M), as boards send them; figures (n,) [dB]."""

    voltages: Array
    references: Array
    snr_db: Array
    touch_snr_db: Array
    model_distance_db: Array


def _measured(
    scenario: SimulatedScenario, split: Split, clean: CleanFrames, modelled: CleanFrames | None
) -> _Measured:
    """What boards send of the frames `clean`; `modelled` are those of the model of methods."""
    pattern = scenario.nominal_sensor.pattern
    frames, references = np.empty_like(clean.voltages), np.empty_like(clean.voltages)
    snr_db, touch_snr_db, distance_db = (np.full(len(frames), np.nan) for _ in range(3))
    key = scenario.key(split)
    for first in range(0, len(frames), TOUCHES):
        session = first // TOUCHES
        board = scenario.split_imperfections(split, session)
        noise = scenario.split_noise(split)
        level = session_snr_db(noise, scenario=scenario.name, split=split, session=session, key=key)
        rows = slice(first, first + TOUCHES)
        touched, untouched = clean.voltages[rows], clean.untouched[first]
        times = np.arange(first, first + len(touched)) * np.float64(TOUCH_INTERVAL_S)
        analogue = board.analogue(touched, untouched, pattern, times)
        noisy = np.array(
            [
                measured(frame, level, scenario.name, split, noise, first + k, key=key)
                for k, frame in enumerate(analogue)
            ]
        )
        sent = board.digital(noisy, untouched, pattern)
        before = np.array([-board.reference_age_s])
        (at_rest,) = board.analogue(untouched[None], untouched, pattern, before)
        if modelled is not None:
            (still,) = board.digital(at_rest[None], untouched, pattern)
            seen = board.digital(analogue, untouched, pattern) - still
            touches, expected = modelled.voltages[rows], modelled.untouched[first]
            gain = expected @ still / (expected @ expected)  # which every method fits
            distance_db[rows] = distance_of_touch(gain * (touches - expected), seen)
        axes = (scenario.name, split, noise, "reference", session)
        at_rest = measured(at_rest, level, *axes, key=key)
        references[rows] = board.digital(at_rest[None], untouched, pattern)
        frames[rows] = board.received(sent, references[first], first)
        snr_db[rows] = level
        heard = ~np.isin(pattern.table, board.dead).any(axis=1)
        touch_snr_db[rows] = snr_of_touch((touched - untouched) * heard, analogue, level)
    return _Measured(frames, references, snr_db, touch_snr_db, distance_db)


# Columns of recorded sets that name the object of a frame; without, each frame has its own.
_OBJECT_COLUMNS = ("state", "target")


def _recorded(
    scenario: RecordedScenario,
    split: Split,
    limit: int | None,
    progress: bool,
) -> Dataset:
    if split == "train":
        raise InputError(
            f"Recorded scenario {scenario.name!r} has no training split: ask for 'validation' or "
            "'test', or train on a simulated scenario."
        )
    # Imported here: simulated data need no download.
    from eitbench.scenarios.recordings.fetch import no_untouched_frame, read_recording

    recorded = scenario.recorded_set
    recording = read_recording(scenario.recording, progress=progress)
    if scenario.calibrated and recording.modelled_reference:
        # The sensor would be found to be as it is described, whatever it is.
        raise no_untouched_frame(f"{scenario.recording}, which is to be calibrated,")
    rows = np.flatnonzero(recording.samples["split"] == split)[:limit]
    if len(rows) == 0:
        raise InputError(f"Recorded scenario {scenario.name!r} has no {split} samples.")
    samples = recording.samples.iloc[rows].drop(columns=["split", "sample"], errors="ignore")
    samples = samples.reset_index(drop=True)
    samples.insert(0, "sample", np.arange(len(rows)))
    of_object = next((name for name in _OBJECT_COLUMNS if name in samples), "sample")
    samples.insert(1, "phantom", [f"{recorded.name} {what}" for what in samples[of_object]])
    samples.insert(2, "cluster", samples["phantom"])
    return Dataset(
        scenario=scenario.name,
        split=split,
        sensor=scenario.nominal_sensor,
        voltages=np.array(recording.voltages[rows], dtype=np.float64),
        references=np.tile(np.asarray(recording.reference, dtype=np.float64), (len(rows), 1)),
        samples=samples,
        truth=recorded.truth,
        data_hash=scenario.data_hash(split),
        classes=None if recording.classes is None else recording.classes[rows],
    )
