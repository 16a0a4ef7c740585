"""Interfaces of what runs in a cell: the task, its plan and its data, of methods and operators."""

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.run.timing import Conditions
from eitbench.benchmark.rundir.cells import Cell, Values
from eitbench.benchmark.rundir.run_arrays import Truth
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.messages import Reply
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.recordings import is_recording
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import Suite

NAN = float("nan")


class Ask(Protocol):
    """Sends a request to the worker of a cell; raises `WorkerLostError` if that costs it."""

    def __call__(self, *request: object, limit: float, what: str) -> Reply:
        """Return the answer, which may take `limit` seconds; `what` was asked for is said."""


@dataclass(frozen=True, eq=False)
class CellPlan:
    """One cell of a run, apart from its data.

    Attributes:
        cell: of the name `TRUTH` for what the other cells of its scenario are compared with.
        parameters: constructor parameters of a method; empty on track "default".
        spent: cost of selecting them, see `Selection`; empty where they were not selected.
        suite: declares the limits.
        plugin: the file that registers the method or operator, None for one that is installed.
        batch: samples asked for at once; a run keeps to the number it was started with.
        source: the publication that it follows.
    """

    cell: Cell
    track: str
    parameters: dict[str, Any]
    spent: dict[str, Any]
    suite: Suite
    plugin: Path | None
    batch: int
    source: str = ""


@dataclass(frozen=True, eq=False)
class CellData(ABC):
    """The data of a scenario, for the cells of one kind of run.

    Attributes:
        batch: samples that are asked for at once.
    """

    batch: ClassVar[int]

    scenario: Scenario
    test: Dataset

    @classmethod
    @abstractmethod
    def load(
        cls, scenario: Scenario, suite: Suite, limit: int | None, *, jobs: int, progress: bool
    ) -> Self:
        """Simulate, find or download the data.

        Raises:
            DataUnavailableError, DataCorruptError: recorded data cannot be had or are damaged.
        """

    @classmethod
    @abstractmethod
    def known(cls) -> Mapping[str, type[Any]]:
        """Return what can run by name, but for plugin files: theirs are known in workers alone."""

    @abstractmethod
    def task(self, plan: CellPlan, store: RunStore) -> "CellTask":
        """Return the task of the cell of `plan`."""

    @abstractmethod
    def truth(self) -> Truth:
        """Return the truth that is stored beside the answers."""

    @property
    def input_hashes(self) -> list[str]:
        """SHA-256 (hex) of the input of each test sample."""
        return self.test.frame_hashes

    def preparation(self, plan: CellPlan) -> CellPlan | None:
        """Return the cell that the cell of `plan` is compared with, and has to wait for, if any."""
        return None

    def weights(self, name: str) -> str:
        """Return the SHA-256 (hex) of the weights that `name` would load; "" without any."""
        known = self.known()  # of plugins a run remembers the file
        return known[name].weights_hash(self.test.sensor) if name in known else ""

    def unusable(self, name: str) -> str:
        """Return the reason why `name` cannot run here, as a sentence; "" if it can."""
        known = self.known()
        return known[name].unusable(self.test.sensor) if name in known else ""

    def selection(self, name: str, code: str) -> dict[str, Any] | None:
        """Return the record of the parameters selected for `name` with this `code`, if any."""
        return None


@dataclass(frozen=True, eq=False)
class CellTask(ABC):
    """A method, an operator or a model that runs in a cell: its requests and its stored answers.

    Attributes:
        plan: the cell.
        store: the run directory.
        unknown: values of the cell's own figures where nothing is known, by name.
        reports_prior_knowledge: true if its service reports it at the end.
    """

    unknown: ClassVar[Mapping[str, Any]] = {}
    reports_prior_knowledge: ClassVar[bool] = False

    plan: CellPlan
    store: RunStore
    data: CellData

    @property
    def sizes(self) -> Mapping[str, int]:
        """Number of samples of each split, in the order they run."""
        return {"test": len(self.data.test)}

    @property
    def readable(self) -> tuple[Path, ...]:
        """Files and folders of the user that its service has to read."""
        scenario = self.data.scenario
        named = [os.environ.get(name) for name in ("EITBENCH_DATA", "EITBENCH_EIDORS")]
        named += [getattr(scenario, name, None) for name in ("sensor", "recording")]
        return tuple(Path(place) for place in (self.plan.plugin, *named) if place)

    @property
    def recordings(self) -> tuple[Path, ...]:
        """Recordings of the user's own that the scenario names."""
        scenario = self.data.scenario
        named = (getattr(scenario, "recording", ""), *getattr(scenario, "others", ()))
        return tuple(Path(name) for name in named if is_recording(name))

    @abstractmethod
    def service(self) -> object:
        """Return the object that answers in the worker; see `set_up` below."""

    @abstractmethod
    def request(self, split: str, rows: slice) -> tuple[object, ...]:
        """Return the request for some samples of a split."""

    @abstractmethod
    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """Return the stored arrays of `n` samples without an answer."""

    @abstractmethod
    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.str_]]:
        """Return the stored arrays of an answer, and what is wrong with each sample (k,).

        That is "" of valid ones, see `not_finite`.
        """

    def warm(self, ask: Ask, beside: Conditions) -> dict[str, float]:
        """Return times of the warm task that count, measured on valid samples of the test split."""
        return {}

    def set_up(self, value: object) -> dict[str, Any]:
        """Return figures of the cell from the answer of its service's `set_up`."""
        return {}

    def prior_knowledge(self, value: object) -> dict[str, Any]:
        """Return figures of the cell from the answer of its service's `prior_knowledge`."""
        return {}

    def figures(self, stored: "StoredSamples") -> tuple[pd.DataFrame, dict[str, Any]]:
        """Return figures of every test sample, and of the cell as a whole."""
        return pd.DataFrame(), {}


def not_finite(finite: NDArray[np.bool_], what: str = "values that are") -> NDArray[np.str_]:
    """What is wrong with samples (k,) of which some are not `finite`; "" of the others."""
    return np.where(finite, "", f"returned {what} not finite")


class StoredSamples:
    """All stored samples of one split of a cell, in the order of the data set.

    Attributes:
        values: arrays (n, ...).
        status, message: n texts; status "" where nothing is stored.
    """

    def __init__(self, task: CellTask, split: str = "test") -> None:
        n = task.sizes[split]
        self.values = task.blank(n)
        self.status = np.full(n, "", dtype=object)
        self.message = np.full(n, "", dtype=object)
        for batch in task.store.batches(task.plan.cell, split):
            rows = slice(batch.start, batch.stop)
            self.status[rows] = batch.status
            self.message[rows] = batch.message
            for name, array in self.values.items():
                array[rows] = batch.values[name]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask (n,) of the samples that have a valid answer."""
        return np.asarray(self.status == "ok")
