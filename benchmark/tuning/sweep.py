"""Search of parameters: a sweep of one after the other, then Optuna's TPE.

Everything follows from the trials that the study holds and from its key, never from the state of a
generator, so that a study that was stopped goes on as if it had not been.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, IntDistribution
from optuna.samplers import BaseSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from eitbench.benchmark.tuning.selection import TrialStatus
from eitbench.scenarios.seeds import generator

Point = tuple[int, ...]
"""A set of parameters: the position of each one's value among those that may be chosen."""

SUGGESTIONS = 10  # of TPE for one trial, before one is drawn that was not tried yet
STATUSES: dict[TrialState, TrialStatus] = {
    TrialState.COMPLETE: "ok",
    TrialState.PRUNED: "pruned",
    TrialState.FAIL: "failed",
}
INTERRUPTED = "interrupted"
"""Noted with a trial whose process was killed: it does not count and is tried again."""


@dataclass(frozen=True)
class SearchSpace:
    """Values that each parameter may take, and the start of the search.

    Attributes:
        values: by parameter; numbers rise.
        start: the defaults.
    """

    values: Mapping[str, tuple[Any, ...]]
    start: Point

    @classmethod
    def of(cls, search: Mapping[str, Sequence[Any]], defaults: Mapping[str, Any]) -> "SearchSpace":
        """Return the space of a method that declares `search`; its defaults belong to it."""
        values = {name: _ordered((*search[name], defaults[name])) for name in search}
        return cls(values, tuple(values[name].index(defaults[name]) for name in values))

    @property
    def size(self) -> int:
        """Number of sets of parameters."""
        return math.prod(len(values) for values in self.values.values())

    def parameters(self, point: Point) -> dict[str, Any]:
        """Return the parameters at `point`."""
        pairs = zip(self.values.items(), point, strict=True)
        return {name: values[k] for (name, values), k in pairs}

    def distributions(self) -> dict[str, BaseDistribution]:
        """Return the space for Optuna: numbers have an order, other values have none."""
        return {
            name: IntDistribution(0, len(values) - 1)
            if _is_numeric(values)
            else CategoricalDistribution(range(len(values)))
            for name, values in self.values.items()
        }

    def point(self, chosen: Mapping[str, Any]) -> Point:
        """Return the point that Optuna chose."""
        return tuple(int(chosen[name]) for name in self.values)


class SweepSampler(BaseSampler):
    """Sweeps one parameter after the other until nothing improves, then asks TPE.

    What TPE draws is decided by the `key` of the study and the number of trials before.
    """

    def __init__(self, space: SearchSpace, key: str) -> None:
        self.space, self.key = space, key

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """Return all parameters: they are chosen together."""
        return self.space.distributions()

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """Return the next parameters of the sweep, then suggestions of TPE, never one twice."""
        tried = figures(study, self.space)
        point = next_in_sweep(self.space, tried)
        if point is None:
            point = self._suggested(study, trial, tried)
        return dict(zip(self.space.values, point, strict=True))

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Never asked for."""
        raise NotImplementedError(param_name)

    def _suggested(
        self, study: optuna.Study, trial: FrozenTrial, tried: Mapping[Point, float]
    ) -> Point:
        rng = generator("tuning", self.key, len(tried))
        for _ in range(SUGGESTIONS):
            tpe = TPESampler(n_startup_trials=0, multivariate=True, seed=int(rng.integers(2**31)))
            found = tpe.sample_relative(study, trial, self.space.distributions())
            point = self.space.point(found)
            if point not in tried:
                return point
        sizes = [len(values) for values in self.space.values.values()]
        while point in tried:
            point = tuple(int(k) for k in rng.integers(sizes))
        return point


def ended(study: optuna.Study, space: SearchSpace) -> list[tuple[Point, FrozenTrial]]:
    """Return every point that was tried, in order, with its trial."""
    trials = study.get_trials(deepcopy=False, states=tuple(STATUSES))
    return [(space.point(t.params), t) for t in trials if INTERRUPTED not in t.user_attrs]


def figures(study: optuna.Study, space: SearchSpace) -> dict[Point, float]:
    """Return the figure of every point that was tried, in order; -inf if failed or pruned."""
    return {
        point: -np.inf if trial.state != TrialState.COMPLETE else float(trial.values[0])
        for point, trial in ended(study, space)
    }


def next_in_sweep(space: SearchSpace, tried: Mapping[Point, float]) -> Point | None:
    """Return the next point of coordinate search after those `tried`; None at the end."""
    if space.start not in tried:
        return space.start
    best, seen, improved = space.start, {space.start}, True
    while improved:
        improved = False
        for place, values in enumerate(space.values.values()):
            for k in range(len(values)):
                point = (*best[:place], k, *best[place + 1 :])
                if point in seen:
                    continue
                if point not in tried:
                    return point
                seen.add(point)
                if tried[point] > tried[best]:
                    best, improved = point, True
    return None


def _ordered(values: Sequence[Any]) -> tuple[Any, ...]:
    """Return each value once; numbers rising."""
    different = [value for k, value in enumerate(values) if value not in values[:k]]
    return tuple(sorted(different)) if _is_numeric(different) else tuple(different)


def _is_numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
