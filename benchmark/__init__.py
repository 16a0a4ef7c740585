"""Evaluation: metrics, runs, their directory, tuning, checks and analyses."""

from eitbench.scenarios.arrays import nearest_pixels
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError, unknown_name
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.progress import with_bar
from eitbench.scenarios.similarity import Similarity
from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json
from eitbench.scenarios.storage.files import writing

__all__ = [
    "DataCorruptError",
    "EitbenchError",
    "InputError",
    "Similarity",
    "atomic_write",
    "atomic_write_json",
    "nearest_pixels",
    "unknown_name",
    "with_bar",
    "worker_pool",
    "writing",
]
