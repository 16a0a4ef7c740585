"""Data sets: the samples of a scenario's split, ready for methods and metrics."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, cast, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.simulation import clean_reference, clean_voltages, phantom
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.guard import check_open
from eitbench.scenarios.imperfections.noise import measured_frames, measured_reference, touch_snr_db
from eitbench.scenarios.phantoms.phantom import Phantom, rasterise
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import RecordedScenario, SimulatedScenario, Split
from eitbench.scenarios.suites.suite import scenario_by_name


@dataclass(frozen=True, eq=False)
class Dataset:
    """The first n samples of one split of one scenario; its arrays are read-only.

    Attributes:
        scenario, split: names of its origin.
        sensor: the nominal sensor.
        voltages: (n, M) frames: [V/A] if simulated, in the board's own units if recorded.
        reference: (M,) the reference frame, measured like the others.
        samples: one row per frame. `sample` is its number in the split, `phantom` names the
            object: frames of the same object are not independent. Simulated: `family`,
            `shape`, `snr_db` and `touch_snr_db` of the frame and of what the touch changes in it
            (NaN if clean), `inclusions` and what was drawn (NaN where a family has no such value).
            Recorded: columns of the set, such as `x_m`, `y_m`, `depth_mm`.
        truth: kind of truth that is known of each frame.
        data_hash: SHA-256 of all declared parameters.
        inverse_crime: true if the mesh of the data is no finer than the one methods invert with;
            None for recorded data.
        phantoms: the simulated phantoms.
        classes: (n, H, W) int8 truth of recorded sets that know it: 0 background, -1 resistive,
            +1 conductive.
    """

    scenario: str
    split: Split
    sensor: Sensor
    voltages: Array
    reference: Array
    samples: pd.DataFrame
    truth: Literal["conductivity", "position", "classes", "none"]
    data_hash: str
    inverse_crime: bool | None = None
    phantoms: tuple[Phantom, ...] = ()
    classes: NDArray[np.int8] | None = None

    def __post_init__(self) -> None:
        for array in (self.voltages, self.reference, self.classes):
            if array is not None:
                array.setflags(write=False)

    def __len__(self) -> int:
        """Number of samples n."""
        return len(self.voltages)

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
        """SHA-256 (hex) of every frame together with the reference frame."""
        reference = self.reference.tobytes()
        return [hashlib.sha256(frame.tobytes() + reference).hexdigest() for frame in self.voltages]


def load(
    scenario: str | SimulatedScenario | RecordedScenario,
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
        jobs: number of processes to simulate with.
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
    if isinstance(scenario, RecordedScenario):
        data = _recorded(scenario, cast("Split", split), limit, progress)
    else:
        data = _simulated(scenario, cast("Split", split), limit, jobs, progress)
        if split != "test":
            return data  # of the nominal sensor
    if not scenario.calibrated:
        return data
    # Imported here: it is a small inverse problem, which few scenarios pose.
    from eitbench.scenarios.imperfections.calibration import calibrate

    found = calibrate(data.sensor, data.reference[None])
    return replace(data, voltages=found.corrected(data.voltages), reference=found.nominal)


def _simulated(
    scenario: SimulatedScenario, split: Split, limit: int | None, jobs: int, progress: bool
) -> Dataset:
    size: int = getattr(scenario, split)
    if size == 0:
        raise InputError(f"Scenario {scenario.name!r} declares no {split} samples.")
    count = size if limit is None else min(limit, size)
    clean = clean_voltages(scenario, split, count, jobs=jobs, progress=progress)
    voltages, snr, touch_snr, reference = _measured(scenario, split, clean)
    phantoms = tuple(phantom(scenario, split, sample) for sample in range(count))
    declared = {
        "sample": np.arange(count),
        "phantom": [f"{scenario.phantom_stream} {split} {sample}" for sample in range(count)],
        "family": [p.family for p in phantoms],
        "shape": [p.shape for p in phantoms],
        "snr_db": snr,
        "touch_snr_db": touch_snr,
        "inclusions": [len(p.inclusions) for p in phantoms],
    }
    drawn = pd.DataFrame([p.parameters for p in phantoms])
    return Dataset(
        scenario=scenario.name,
        split=split,
        sensor=scenario.nominal_sensor,
        voltages=voltages,
        reference=reference,
        samples=pd.concat([pd.DataFrame(declared), drawn], axis=1),
        truth="conductivity",
        data_hash=scenario.data_hash(split),
        inverse_crime=scenario.inverse_crime,
        phantoms=phantoms,
    )


def _measured(
    scenario: SimulatedScenario, split: Split, clean: Array
) -> tuple[Array, Array, Array, Array]:
    """Frames (n, M) as the board of `split` sends them, and the reference frame (M,) last.

    Between them the SNR (n,) of each frame and that of its touch [dB].
    """
    board, pattern = scenario.split_imperfections(split), scenario.nominal_sensor.pattern
    untouched = clean_reference(scenario, split)
    analogue = board.analogue(clean, untouched, pattern)
    noisy, snr = measured_frames(
        analogue, scenario.split_noise(split), scenario=scenario.name, split=split
    )
    voltages = board.received(board.digital(noisy, untouched, pattern))
    # The reference frame is the same for all splits, unless the sensor of the test split has
    # imperfections: these are unknown to the other splits.
    times = np.array([-board.reference_age_s])
    (before,) = board.analogue(untouched[None], untouched, pattern, times)
    touch_snr = touch_snr_db(clean - untouched, clean, snr)
    noise = scenario.split_noise("test" if scenario.imperfections is None else split)
    noisy = measured_reference(before, noise, scenario=scenario.name)
    (reference,) = board.digital(noisy[None], untouched, pattern)
    return voltages, snr, touch_snr, reference


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
    from eitbench.scenarios.recordings.fetch import read_recording

    recorded = scenario.recorded_set
    recording = read_recording(scenario.recording, progress=progress)
    rows = np.flatnonzero(recording.samples["split"] == split)[:limit]
    if len(rows) == 0:
        raise InputError(f"Recorded scenario {scenario.name!r} has no {split} samples.")
    samples = recording.samples.iloc[rows].drop(columns=["split", "sample"], errors="ignore")
    samples = samples.reset_index(drop=True)
    samples.insert(0, "sample", np.arange(len(rows)))
    measured = next((name for name in _OBJECT_COLUMNS if name in samples), "sample")
    samples.insert(1, "phantom", [f"{recorded.name} {what}" for what in samples[measured]])
    return Dataset(
        scenario=scenario.name,
        split=split,
        sensor=scenario.nominal_sensor,
        voltages=np.array(recording.voltages[rows], dtype=np.float64),
        reference=np.array(recording.reference, dtype=np.float64),
        samples=samples,
        truth=recorded.truth,
        data_hash=scenario.data_hash(split),
        classes=None if recording.classes is None else recording.classes[rows],
    )
