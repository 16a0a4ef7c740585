"""What runs in the cells of a run: how it is asked and scored, whatever kind it is of."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.run.outcome import StoredBatches
from eitbench.benchmark.rundir.arrays_file import Truth
from eitbench.benchmark.rundir.cells import Cell, Values
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.worker import Reply
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import Suite

NAN = float("nan")

Ask = Callable[[str, slice], Reply]


@dataclass(frozen=True, eq=False)
class CellPlan:
    """What a cell is, apart from its data.

    Attributes:
        parameters: constructor parameters of a method; empty on track "default".
        spent: what choosing them cost, see `choices`; empty where they were not chosen.
        plugin: the file that registers the method or operator, None for one that is installed.
        batch: samples asked for at once; a run keeps to the number it was started with.
    """

    cell: Cell
    track: str
    parameters: dict[str, Any]
    spent: dict[str, Any]
    suite: str
    plugin: Path | None
    fit_limit_s: float
    frame_limit_s: float
    memory_limit_mb: float
    batch: int


class CellTask(ABC):
    """What runs in a cell: how it is asked in its worker, and what of its answers is kept.

    Attributes:
        plan: the cell.
        store: where answers are kept.
        unknown: the cell's own figures as they stand where nothing is known, by name.
        tells: whether its service says at the end what it was told.
    """

    unknown: ClassVar[Mapping[str, Any]] = {}
    tells: ClassVar[bool] = False

    def __init__(self, plan: CellPlan, store: RunStore) -> None:
        self.plan = plan
        self.store = store

    @property
    @abstractmethod
    def sizes(self) -> Mapping[str, int]:
        """Number of samples of each split, in the order in which they are run."""

    @abstractmethod
    def service(self) -> object:
        """What answers in the worker; its `set_up` gives figures of the cell."""

    @abstractmethod
    def request(self, split: str, rows: slice) -> tuple[object, ...]:
        """The question about some samples of a split."""

    @abstractmethod
    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """The arrays that are kept of `n` samples where nothing was answered."""

    @abstractmethod
    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.bool_]]:
        """The arrays that are kept of an answer, and which samples (k,) are valid."""

    def warm(self, ask: Ask) -> dict[str, float]:
        """Times of a task that runs for a while, measured on valid samples of the test split."""
        return {}

    def prior_knowledge(self, value: Any) -> dict[str, Any]:
        """Figures of the cell from what its service's `prior_knowledge` answers at the end."""
        return {}

    def valid_samples(self) -> NDArray[np.intp]:
        """Positions of the test samples that have a valid answer."""
        kept = self.store.batches(self.plan.cell, "test")
        return np.array(
            [b.start + k for b in kept for k, status in enumerate(b.status) if status == "ok"],
            dtype=np.intp,
        )


class ScoredTask(CellTask):
    """A method or an operator: its answers get rows.

    Attributes:
        test: the test split.
        labels: columns of its rows beside its name.
    """

    def __init__(self, plan: CellPlan, store: RunStore, test: Dataset) -> None:
        super().__init__(plan, store)
        self.test = test
        self.labels: dict[str, str] = {}

    @property
    @abstractmethod
    def input_hashes(self) -> list[str]:
        """SHA-256 (hex) of what it is given of each test sample."""

    @abstractmethod
    def figures(self, kept: StoredBatches) -> tuple[pd.DataFrame, dict[str, Any]]:
        """Figures of every test sample, and of the cell as a whole."""


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
        """Simulate, find or download what is needed.

        Raises:
            DataUnavailableError, DataCorruptError: recorded data cannot be had or are damaged.
        """

    @abstractmethod
    def task(self, plan: CellPlan, store: RunStore) -> ScoredTask:
        """What runs in the cell of `plan`."""

    @abstractmethod
    def truth(self) -> Truth:
        """What is kept of the scenario beside the answers."""

    def preparation(self, plan: CellPlan, store: RunStore) -> CellTask | None:
        """What has to run before the cells of the scenario, if anything; `plan` is one of them."""
        return None

    def weights(self, name: str) -> str:
        """SHA-256 (hex) of the trained weights that `name` would load; "" where there are none."""
        return ""

    def unusable(self, name: str) -> str:
        """Why `name` cannot run here, as a sentence; "" if it can."""
        return ""

    def choice(self, name: str) -> dict[str, Any] | None:
        """The record of the parameters chosen for `name`, see `choices`; None if there is none."""
        return None
