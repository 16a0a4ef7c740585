"""A class of a notebook is run as a method of `eitbench run`, and its errors are told."""

import re
from pathlib import Path

import numpy as np
import pytest

from eitbench import InputError, Method, evaluate, methods
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.run.runner import Plan, RunInterruptedError
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import EitbenchError

TINY = Path(__file__).parents[1] / "benchmark" / "data" / "tiny.toml"
LEVEL = 0.5


def level(images: Array) -> Array:
    return images * LEVEL


class HalfLevel(Method):
    """Half of the background everywhere."""

    def fit(self, problem: methods.Problem) -> None:
        self.problem = problem

    def reconstruct(self, voltages: Array) -> Array:
        return level(np.ones((len(voltages), *self.problem.mask.shape)))


class Broken(HalfLevel):
    """Raises."""

    def reconstruct(self, voltages: Array) -> Array:
        return voltages / self.no_such_thing  # type: ignore[attr-defined, no-any-return]


@pytest.fixture(autouse=True)
def own_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())


@pytest.mark.slow
def test_a_class_and_a_name_become_a_leaderboard(tmp_path: Path) -> None:
    """The class is of a notebook: it and what it uses are nowhere to be imported from."""
    for thing in (level, HalfLevel):
        thing.__module__ = "__main__"
    board = evaluate([HalfLevel, "noser"], TINY, limit=2, out=tmp_path / "run")
    assert board["method"].tolist() == ["noser", "half-level"]
    assert board["rank"].tolist() == [1, 2]
    assert board["n"].tolist() == [2, 2]
    assert (board["score"] > 0).all()
    images = read_run(tmp_path / "run").estimates("tiny", "half-level", [0, 1])
    assert images is not None
    assert set(np.unique(images)) <= {np.float32(0.5), np.float32(1)}


@pytest.mark.slow
def test_what_it_raises_is_told_with_its_frames() -> None:
    with pytest.warns(UserWarning, match=re.escape("return voltages / self.no_such_thing")):
        board = evaluate(Broken, TINY, limit=1)
    assert board["coverage"].tolist() == [0.0]


def test_nobody_is_sent_to_a_folder_that_is_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(plan: Plan, run: Path, *, jobs: int) -> None:
        raise RunInterruptedError("The run was interrupted.", f"eitbench run --resume {run}")

    monkeypatch.setattr("eitbench.notebook.start_run", interrupted)
    with pytest.raises(EitbenchError, match=re.escape(f"--resume {tmp_path}")):
        evaluate("noser", TINY, out=tmp_path)
    with pytest.raises(EitbenchError, match="Nothing is kept: give `out`") as told:
        evaluate("noser", TINY)
    assert "resume" not in str(told.value)


def test_what_is_wrong_is_said_before_anything_is_run() -> None:
    with pytest.raises(InputError, match="Unknown method 'nosr': did you mean 'noser'"):
        evaluate("nosr", TINY)
    with pytest.raises(InputError, match="Give the class HalfLevel, not an object of it"):
        evaluate(HalfLevel(), TINY)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Name at least one method"):
        evaluate([], TINY)
    with pytest.raises(InputError, match="Unknown scenario in suite 'tiny': 'none'"):
        evaluate("noser", TINY, scenarios="none")
    with pytest.raises(InputError, match="cannot be made with"):
        evaluate("noser", TINY, parameters={"noser": {"wait": 1}})
