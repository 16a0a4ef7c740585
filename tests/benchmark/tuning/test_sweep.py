"""Search of a study: the sweep, TPE after it, and interruptions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState

from eitbench.benchmark.tuning.sweep import (
    INTERRUPTED,
    Point,
    SearchSpace,
    SweepSampler,
    figures,
    next_in_sweep,
)

SPACE = SearchSpace.of(
    {"kind": ("b", "a"), "weight": (1.0, 0.1, 10.0), "steps": range(4)},
    {"kind": "a", "weight": 1.0, "steps": 2},
)


@pytest.fixture(autouse=True)
def _quiet() -> None:
    optuna.logging.set_verbosity(optuna.logging.WARNING)


def coordinate_search(
    search: Mapping[str, Sequence[int]], start: Mapping[str, int], landscape: Mapping[Point, float]
) -> list[Point]:
    """The textbook's loop, as a reference: what it tries, in order."""
    best = dict(start)
    tried = [tuple(best.values())]
    improved = True
    while improved:
        improved = False
        for name, values in search.items():
            for value in values:
                candidate = tuple({**best, name: value}.values())
                if candidate not in tried:
                    tried.append(candidate)
                    if landscape[candidate] > landscape[tuple(best.values())]:
                        best[name], improved = value, True
    return tried


def test_the_sweep_is_coordinate_search_on_any_landscape() -> None:
    rng = np.random.default_rng(0)
    points = list(np.ndindex(2, 3, 4))
    for k in range(50):
        # Of every second one many points are equals.
        figures = rng.normal(size=len(points)) if k % 2 else rng.integers(3, size=len(points))
        landscape = dict(zip(points, figures.tolist(), strict=True))
        tried: dict[Point, float] = {}
        while (point := next_in_sweep(SPACE, tried)) is not None:
            tried[point] = landscape[point]
        search = {"a": range(2), "b": range(3), "c": range(4)}
        start = dict(zip(search, SPACE.start, strict=True))
        assert list(tried) == coordinate_search(search, start, landscape)


def test_numbers_have_an_order_and_names_have_none() -> None:
    assert SPACE.values == {"kind": ("b", "a"), "weight": (0.1, 1.0, 10.0), "steps": (0, 1, 2, 3)}
    assert SPACE.parameters(SPACE.start) == {"kind": "a", "weight": 1.0, "steps": 2}
    kinds = [type(d).__name__.removesuffix("Distribution") for d in SPACE.distributions().values()]
    assert kinds == ["Categorical", "Int", "Int"]
    # A default that is no candidate belongs to the space.
    space = SearchSpace.of({"weight": (1, 3)}, {"weight": 2})
    assert space.values == {"weight": (1, 2, 3)}
    assert space.start == (1,)


def a_study(key: str) -> optuna.Study:
    return optuna.create_study(direction="maximize", sampler=SweepSampler(SPACE, key))


def landscape(point: Point) -> float:
    return -float((point[1] - 2) ** 2 + (point[2] - 1) ** 2 + 3 * (point[0] == 1))


def go_on(study: optuna.Study, count: int) -> list[Point]:
    asked = []
    for _ in range(count):
        trial = study.ask(SPACE.distributions())
        asked.append(tuple(trial.params[name] for name in SPACE.values))
        study.tell(trial, landscape(asked[-1]))
    return asked


def test_nothing_is_tried_twice_until_all_is_tried() -> None:
    asked = go_on(a_study("one"), SPACE.size)
    assert sorted(asked) == sorted(np.ndindex(2, 3, 4))


def test_what_follows_the_sweep_depends_on_the_key_alone() -> None:
    first = go_on(a_study("one"), 16)
    assert first == go_on(a_study("one"), 16)
    assert any(first != go_on(a_study(key), 16) for key in ("two", "three", "four"))


def test_an_interrupted_trial_changes_nothing_that_follows() -> None:
    expected = go_on(a_study("one"), 16)
    for stopped_after in (0, 5, 12, 14):
        study = a_study("one")
        asked = go_on(study, stopped_after)
        lost = study.ask(SPACE.distributions())
        lost.set_user_attr(INTERRUPTED, True)
        study.tell(lost, state=TrialState.FAIL)
        assert asked + go_on(study, 16 - stopped_after) == expected


def test_what_failed_or_was_pruned_cannot_win() -> None:
    study = a_study("one")
    states: list[Any] = [(TrialState.FAIL, None), (TrialState.PRUNED, None), (None, -9.0)]
    for state, value in states:
        study.tell(study.ask(SPACE.distributions()), value, state=state)
    assert list(figures(study, SPACE).values()) == [-np.inf, -np.inf, -9.0]
