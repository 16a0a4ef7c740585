"""Simulated voltages before noise: made on demand, in parallel, and cached by content.

The cache holds `simulated/<hash of the parameters>/<split>-<first sample>.safetensors`, files of up
to CHUNK samples each. A file that holds fewer samples than are asked for is completed. Phantoms and
noise are not stored: they are drawn again from their keys.
"""

import json
import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
from rich.console import Console
from rich.progress import track
from threadpoolctl import threadpool_limits

from eitbench.scenarios.array_file import read_arrays, write_arrays
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import DataCorruptError, EitbenchError
from eitbench.scenarios.guard import check_open
from eitbench.scenarios.imperfections.imperfections import TOUCH_INTERVAL_S
from eitbench.scenarios.phantoms.phantom import Phantom, draw, rasterise
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.suites.scenario import SimulatedScenario, Split

CHUNK = 32

_log = logging.getLogger(__name__)


def phantom(scenario: SimulatedScenario, split: Split, sample: int) -> Phantom:
    """Phantom number `sample` of `split`; families take turns, so any first n are balanced."""
    check_open(split)
    families = scenario.split_families(split)
    rng = generator("phantom", scenario.phantom_stream, split, sample)
    return draw(families[sample % len(families)], scenario.nominal_sensor, rng)


def clean_voltages(
    scenario: SimulatedScenario, split: Split, count: int, *, jobs: int = 1, progress: bool = False
) -> Array:
    """Voltages (count, M) [V/A] of the first `count` phantoms of `split`, without noise.

    Raises:
        InputError: the test split, where it is closed.
        EitbenchError: the cache folder is not writable or full.
    """
    check_open(split)
    chunks = _chunks(scenario, split, count)
    ready: dict[int, Array] = {}
    for chunk in chunks:
        try:
            stored = chunk.read()
        except DataCorruptError as error:
            _log.warning("%s It is made again.", error)
            continue
        if stored is not None and len(stored) >= chunk.count:
            ready[chunk.first] = stored[: chunk.count]
    missing = [chunk for chunk in chunks if chunk.first not in ready]
    steps: Iterable[tuple[_Chunk, Array]] = _simulated(scenario, split, missing, jobs)
    console = Console(stderr=True)
    # Without a terminal there is nobody to watch, and a log needs no empty lines.
    if progress and missing and console.is_terminal:
        title = f"Simulating {scenario.name}"
        steps = track(steps, title, total=len(missing), console=console)
    for chunk, voltages in steps:
        ready[chunk.first] = voltages
    empty = np.empty((0, scenario.nominal_sensor.n_measurements))
    return np.concatenate([empty, *(ready[chunk.first] for chunk in chunks)])


def clean_reference(scenario: SimulatedScenario, split: Split) -> Array:
    """Voltages (M,) [V/A] of the untouched sensor of `split`, without noise."""
    with threadpool_limits(1):
        model, imperfections = scenario.data_model(split), scenario.split_imperfections(split)
        drift = imperfections.drifted(model.sensor, -imperfections.reference_age_s)
        return model.voltages(drift * model.background)


def conductivity(scenario: SimulatedScenario, split: Split, sample: int) -> Array:
    """Conductivity [S/m] of one sample on the grid of the data, with drift and relaxation."""
    sensor = scenario.data_model(split).sensor
    imperfections = scenario.split_imperfections(split)
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
    def read(self) -> Array | None:
        found = read_arrays(self.path)
        if found is None:
            return None
        arrays, metadata = found
        if metadata != self.metadata or arrays.keys() != {"voltages"}:
            raise DataCorruptError(f"{self.path} was made from other parameters.")
        return arrays["voltages"]

    @_remedy()
    def write(self, voltages: Array) -> None:
        write_arrays(self.path, {"voltages": voltages}, self.metadata)


def _chunks(scenario: SimulatedScenario, split: Split, count: int) -> list[_Chunk]:
    parameters = scenario.clean_parameters(split)
    folder = cache_dir() / "simulated" / content_hash(parameters)
    chunks = []
    for first in range(0, count, CHUNK):
        made_from = json.dumps({**parameters, "first": first}, sort_keys=True, allow_nan=False)
        path = folder / f"{split}-{first:06d}.safetensors"
        chunks.append(_Chunk(first, min(CHUNK, count - first), path, {"parameters": made_from}))
    return chunks


def _simulated(
    scenario: SimulatedScenario, split: Split, chunks: list[_Chunk], jobs: int
) -> Iterator[tuple[_Chunk, Array]]:
    """Simulate and store `chunks`; yields each as soon as it is stored."""
    if jobs == 1 or len(chunks) < 2:
        yield from (_simulate(scenario, split, chunk) for chunk in chunks)
        return
    # One chunk a task: each is stored and shown as soon as it is done.
    pool = joblib.Parallel(
        n_jobs=min(jobs, len(chunks)), return_as="generator_unordered", batch_size=1
    )
    yield from pool(joblib.delayed(_simulate)(scenario, split, chunk) for chunk in chunks)


def _simulate(scenario: SimulatedScenario, split: Split, chunk: _Chunk) -> tuple[_Chunk, Array]:
    """Simulate the samples that the chunk's file lacks, and store all; runs in a worker process.

    Every sample is solved on its own and on one thread, so that its bits depend neither on the
    number of processes nor on the samples beside it.
    """
    stored = None
    with suppress(DataCorruptError):
        stored = chunk.read()  # again: another process may have been faster
    with threadpool_limits(1):
        model = scenario.data_model(split)
        frames = [] if stored is None else list(stored)
        for sample in range(chunk.first + len(frames), chunk.first + chunk.count):
            frames.append(model.voltages(conductivity(scenario, split, sample)))
    voltages = np.array(frames)
    if stored is None or len(stored) < len(voltages):
        chunk.write(voltages)
    return chunk, voltages[: chunk.count]
