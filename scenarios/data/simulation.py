"""Simulated voltages before noise: made on demand, in parallel, and cached by content.

The cache holds `simulated/<hash of the parameters>/<split>-<first sample>.safetensors`, files of up
to CHUNK samples each. A file that holds fewer samples than are asked for is completed. Phantoms and
noise are not stored: they are drawn again from their keys.
"""

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import joblib
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError
from eitbench.scenarios.guard import check_open
from eitbench.scenarios.imperfections.imperfections import TOUCH_INTERVAL_S
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.phantoms.phantom import Phantom, draw, rasterise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.progress import with_bar
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario, Split

CHUNK = 10 * TOUCHES

_log = logging.getLogger(__name__)


def phantom(scenario: SimulatedScenario, split: Split, sample: int) -> Phantom:
    """Phantom number `sample` of `split`, designed or drawn.

    Families that are drawn take turns, so that any first n are balanced.
    """
    check_open(split)
    designed = scenario.designed(split, sample)
    if designed is not None:
        return designed
    families = scenario.split_families(split)
    rng = generator("phantom", scenario.phantom_stream, split, sample, key=scenario.key(split))
    return draw(families[sample % len(families)], scenario.nominal_sensor, rng)


class CleanFrames(NamedTuple):
    """Frames (n, M) [V/A] without noise, and for each that of its untouched sensor (n, M) [V/A]."""

    voltages: Array
    untouched: Array


def clean_frames(
    scenario: SimulatedScenario, split: Split, count: int, *, jobs: int = 1, progress: bool = False
) -> CleanFrames:
    """Frames of the first `count` phantoms of `split`, without noise.

    Raises:
        InputError: the test split, where it is closed.
        EitbenchError: the cache folder is not writable or full.
    """
    check_open(split)
    chunks = _chunks(scenario, split, count)
    ready: dict[int, CleanFrames] = {}
    for chunk in chunks:
        try:
            stored = chunk.read()
        except DataCorruptError as error:
            _log.warning("%s It is made again.", error)
            continue
        if stored is not None and len(stored.voltages) >= chunk.count:
            ready[chunk.first] = CleanFrames(*(array[: chunk.count] for array in stored))
    missing = [chunk for chunk in chunks if chunk.first not in ready]
    steps = _simulated(scenario, split, missing, jobs)
    for chunk, frames in with_bar(
        steps, f"Simulating {scenario.name}", len(missing), show=progress
    ):
        ready[chunk.first] = frames
    empty = np.empty((0, scenario.nominal_sensor.n_measurements))
    found = [ready[chunk.first] for chunk in chunks]
    return CleanFrames(
        np.concatenate([empty, *(frames.voltages for frames in found)]),
        np.concatenate([empty, *(frames.untouched for frames in found)]),
    )


def nominal_samples(
    scenario: SimulatedScenario, samples: range, *, jobs: int = 1
) -> tuple[NDArray[np.float32], Array]:
    """Any `samples` of the training split on the nominal sensor; the cache has no part in it.

    They may lie beyond those that the scenario declares. Frames are solved in batches: they may
    differ from stored ones by rounding.

    Returns:
        Conductivities (n, H, W) [S/m], and frames (n, M) [V/A] without noise.
    """
    check_open("train")
    sensor = scenario.nominal_sensor
    parts = [samples[first : first + CHUNK] for first in range(0, len(samples), CHUNK)]
    pool = worker_pool(jobs, return_as="generator")
    images = np.empty((len(samples), *sensor.image_shape), dtype=np.float32)
    voltages = np.empty((len(samples), sensor.n_measurements))
    first = 0
    for of_part in pool(joblib.delayed(_nominal_part)(scenario, part) for part in parts):
        rows = slice(first, first := first + len(of_part[0]))
        images[rows], voltages[rows] = of_part
    return images, voltages


def _nominal_part(scenario: SimulatedScenario, samples: range) -> tuple[NDArray[np.float32], Array]:
    """See `nominal_samples`; runs in a worker process, on one thread."""
    sensor = scenario.nominal_sensor
    with threadpool_limits(1):
        images = np.array([rasterise(phantom(scenario, "train", k), sensor) for k in samples])
        return images.astype(np.float32), forward_model(sensor).voltages(images)


def conductivity(scenario: SimulatedScenario, split: Split, sample: int) -> Array:
    """Conductivity [S/m] of one sample on the grid of the data, with drift and relaxation.

    One clock runs over the whole split. What is left of the last touch is of the sample before,
    as if it had been on this unit, also where a session begins.
    """
    session = sample // TOUCHES
    sensor = scenario.data_model(split, session).sensor
    imperfections = scenario.split_imperfections(split, session)
    touch = rasterise(phantom(scenario, split, sample), sensor)
    last = None
    if imperfections.relaxation and sample:
        last = rasterise(phantom(scenario, split, sample - 1), sensor) / sensor.background
    drift = imperfections.drifted(sensor, TOUCH_INTERVAL_S * sample)
    return drift * imperfections.remaining(touch, last)


@contextmanager
def _remedy() -> Iterator[None]:
    """What to do, added to the error of a cache that cannot be read or written."""
    try:
        yield
    except DataCorruptError:
        raise
    except EitbenchError as error:
        raise EitbenchError(
            f"{error} Make room in the cache or give access there, or set EITBENCH_CACHE to "
            "another folder."
        ) from error


@dataclass(frozen=True)
class _Chunk:
    """Samples first .. first + count - 1, and the file that stores any number of them."""

    first: int
    count: int
    path: Path
    metadata: Mapping[str, str]

    @_remedy()
    def read(self) -> CleanFrames | None:
        found = read_arrays(self.path)
        if found is None:
            return None
        arrays, metadata = found
        if metadata != self.metadata or arrays.keys() != set(CleanFrames._fields):
            raise DataCorruptError(f"{self.path} was made from other parameters.")
        return CleanFrames(**arrays)

    @_remedy()
    def write(self, frames: CleanFrames) -> None:
        write_arrays(self.path, frames._asdict(), self.metadata)


def split_folder(split: Split) -> Path:
    """Return the cache of the simulated data of a split.

    Each has a folder of its own, so that workers can be kept from that of the test split.
    """
    return cache_dir() / "simulated" / split


def _chunks(scenario: SimulatedScenario, split: Split, count: int) -> list[_Chunk]:
    folder = split_folder(split) / content_hash(scenario.clean_parameters(split))
    chunks = []
    for first in range(0, count, CHUNK):
        made_from = {"parameters": _made_from(scenario, split, first)}
        path = folder / f"{split}-{first:06d}.safetensors"
        chunks.append(_Chunk(first, min(CHUNK, count - first), path, made_from))
    return chunks


def _made_from(scenario: SimulatedScenario, split: Split, first: int) -> str:
    parameters = {**scenario.clean_parameters(split), "first": first}
    return json.dumps(parameters, sort_keys=True, allow_nan=False)


def _simulated(
    scenario: SimulatedScenario, split: Split, chunks: list[_Chunk], jobs: int
) -> Iterator[tuple[_Chunk, CleanFrames]]:
    """Simulate and store `chunks`; yields each as soon as it is stored."""
    if jobs == 1 or len(chunks) < 2:
        yield from (_simulate(scenario, split, chunk) for chunk in chunks)
        return
    # One chunk a task: each is stored and shown as soon as it is done.
    pool = worker_pool(min(jobs, len(chunks)), return_as="generator_unordered", batch_size=1)
    yield from pool(joblib.delayed(_simulate)(scenario, split, chunk) for chunk in chunks)


def _simulate(
    scenario: SimulatedScenario, split: Split, chunk: _Chunk
) -> tuple[_Chunk, CleanFrames]:
    """Simulate the samples that the chunk's file lacks, and store all; runs in a worker process.

    Every sample is solved on its own and on one thread, so that its bits depend neither on the
    number of processes nor on the samples beside it.
    """
    stored = None
    with suppress(DataCorruptError):
        stored = chunk.read()  # again: another process may have been faster
    voltages, untouched = ([], []) if stored is None else map(list, stored)
    units_differ = bool(scenario.split_imperfections(split).of_voltages())
    with threadpool_limits(1):
        for sample in range(chunk.first + len(voltages), chunk.first + chunk.count):
            session = sample // TOUCHES
            model = scenario.data_model(split, session)
            if not untouched or (sample % TOUCHES == 0 and units_differ):
                imperfections = scenario.split_imperfections(split, session)
                drift = imperfections.drifted(model.sensor, -imperfections.reference_age_s)
                untouched.append(model.voltages(drift * model.background))
            else:
                untouched.append(untouched[-1])
            voltages.append(model.voltages(conductivity(scenario, split, sample)))
    frames = CleanFrames(np.array(voltages), np.array(untouched))
    if stored is None or len(stored.voltages) < len(voltages):
        if _made_from(scenario, split, chunk.first) != chunk.metadata["parameters"]:
            raise InputError(
                f"The sensor file {scenario.sensor} was changed while its frames were simulated: "
                "run it again."
            )
        chunk.write(frames)
    return chunk, CleanFrames(*(array[: chunk.count] for array in frames))
