"""Methods to tune: one whose figure is known, one that does what it must not."""

import os
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.methods import Method, Problem, register
from eitbench.scenarios import load
from eitbench.scenarios.data.simulation import clean_frames, phantom
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

Array = NDArray[np.float64]


@register("constant")
@dataclass
class Constant(Method):
    """The untouched sensor, times a factor."""

    search: ClassVar = {"factor": (0.5, 0.9, 1.0, 1.4)}
    factor: float = 1.4

    def fit(self, problem: Problem) -> None:
        self._problem = problem

    def reconstruct(self, voltages: Array) -> Array:
        problem = self._problem
        return np.full((len(voltages), *problem.mask.shape), self.factor * problem.background)


@register("hostile")
@dataclass
class Hostile(Constant):
    """Helps itself to the test split and to all memory, hangs and dies."""

    search: ClassVar = {"way": (
        "fine", "load", "phantom", "voltages", "late", "hang", "die", "grow",
    )}  # fmt: skip
    way: str = "fine"

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        scenario = scenario_by_name("quick")
        assert isinstance(scenario, SimulatedScenario)
        if self.way == "load":
            load("quick", split="test")
        if self.way == "phantom":
            phantom(scenario, "test", 0)
        if self.way == "voltages":
            clean_frames(scenario, "test", 1)
        if self.way == "hang":
            time.sleep(60)
        if self.way == "die":
            os._exit(3)

    def reconstruct(self, voltages: Array) -> Array:
        if self.way == "late":
            load("quick", split="test")
        if self.way == "grow":
            taken = np.ones(2**27)  # 1 GiB
            time.sleep(60 + taken[0])  # until that is seen
        return super().reconstruct(voltages)
