"""A plugin whose methods answer with what must not enter a run."""

import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.method_service import MethodService
from eitbench.methods import Method, Problem, register
from eitbench.scenarios.suites.suite import load_suite

Array = np.ndarray[Any, np.dtype[np.float64]]
TINY = load_suite(Path(__file__).with_name("tiny.toml")).scenarios[0]
TRAINED = {"scenario": "tiny", "train_data": TINY.data_hash("train"), "train_samples": "4"}
FORGED = {"method": "noser", "scenario": "other", "n": 10**9, "coverage": 2.0, "machine": "\ud800"}


def lying(name: str, lie: Callable[[Method], object]) -> None:
    """Register a method that sees nothing, and tells a lie once it is fitted."""

    class Lying(Method):
        def fit(self, problem: Problem) -> None:
            self.image = np.full(problem.mask.shape, problem.background)
            lie(self)

        def reconstruct(self, voltages: Array) -> Array:
            return np.repeat(self.image[None], len(voltages), axis=0)

    register(name)(Lying)


def says(**attributes: Any) -> Callable[[Method], object]:
    return lambda method: vars(method).update(attributes)


class RunsCode:
    """When it is unpickled, it leaves a file."""

    def __str__(self) -> str:
        return "text"

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (os.environ["LIES"],)


def forges_columns(method: Method) -> None:
    """Answer set-up with columns of the cell's row that are not a method's to tell."""
    set_up = MethodService.set_up

    def forged(self: MethodService) -> Reply:
        reply = set_up(self)
        reply.value.update(FORGED)
        return reply

    MethodService.set_up = forged  # type: ignore[method-assign]


def sends(content: bytes) -> Callable[[Method], object]:
    """Write `content` to the pipe, before any answer."""

    def send(method: Method) -> None:
        frame: Any = sys._getframe()
        while "connection" not in frame.f_locals:
            frame = frame.f_back
        os.write(frame.f_locals["connection"].fileno(), content)

    return send


PICKLED = bytes(ForkingPickler.dumps(RunsCode()))

lying("surrogates", says(differs="\ud800", train_s=math.inf))
lying("long-text", says(differs=60 * 2**20 * "\ud800"))
lying("endless-training", says(trained_on={**TRAINED, "train_samples": "2000000000"}))
lying("training-runs-code", says(trained_on={**TRAINED, "seed": RunsCode()}))
lying("forges-columns", forges_columns)
lying("sends-an-object", sends(len(PICKLED).to_bytes(4) + PICKLED))
lying("sends-a-huge-message", sends(b"\xff\xff\xff\xff" + (2**62).to_bytes(8) + b"half"))


@register("odd-parameters")
@dataclass
class OddParameters(Method):
    """Its parameters are not for JSON, and much too long."""

    surrogate: str = "\ud800"
    long: str = 10**6 * "x"
    objects: Any = (math.nan, {("a", "b"): RunsCode})

    def fit(self, problem: Problem) -> None:
        self.image = np.full(problem.mask.shape, problem.background)

    def reconstruct(self, voltages: Array) -> Array:
        return np.repeat(self.image[None], len(voltages), axis=0)


def rewrites_others(method: Method) -> None:
    """Give the rows of another method, which are stored already, another memory."""
    log = Path("/proc/self/fd/1").readlink()
    path = log.parents[1] / "parts" / "tiny" / "noser" / "methods.parquet"
    path.write_bytes(pd.read_parquet(path).assign(memory_mb=12345.0).to_parquet())


lying("rewrites-others", rewrites_others)
