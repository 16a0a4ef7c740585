"""Tuning: its budget, its workers, its interruptions, and what no tuning code can reach."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import optuna
import pytest
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.benchmark.rundir.plan import make_plan
from eitbench.benchmark.tuning import tuner as tuning
from eitbench.benchmark.tuning.selection import (
    FRAMES,
    Selection,
    Trial,
    TuningBudget,
    validation_key,
)
from eitbench.benchmark.tuning.sweep import SearchSpace
from eitbench.benchmark.tuning.trials import (
    BudgetSpentError,
    Clock,
    TrialFailedError,
    Validation,
    frame_figures,
)
from eitbench.benchmark.tuning.tuner import TuningTask, select, tune
from eitbench.benchmark.workers.messages import Failure, WorkerLostError
from eitbench.hardware.recording.exchange import write_recording
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import clean_frames, phantom
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.guard import closed_test_split, is_closed
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.files.pairs import from_pairs
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.scenario import (
    RecordedScenario,
    Scenario,
    SimulatedScenario,
    SplitNoise,
)
from eitbench.scenarios.suites.suite import Suite, load_suite

DATA = Path(__file__).parents[1] / "data"
PLUGIN, SMALL_SUITE = DATA / "tuned_methods.py", DATA / "small.toml"
(SMALL,) = load_suite(SMALL_SUITE).scenarios
assert isinstance(SMALL, SimulatedScenario)


def suite(*scenarios: Scenario, fit_limit_s: float = 60.0) -> Suite:
    return Suite(
        name="mine", title="Mine", methods=("noser",), scenarios=scenarios, fit_limit_s=fit_limit_s
    )


@pytest.mark.slow
def test_a_trial_that_hangs_dies_or_reaches_for_the_test_split_costs_itself_only(
    tmp_path: Path,
) -> None:
    limited = suite(SMALL, fit_limit_s=5.0).model_copy(update={"memory_limit_mb": 800.0})
    plan = make_plan(limited, methods=["hostile"], plugins=[PLUGIN])
    ((scenario, method, choice),) = tune(plan, tmp_path)
    assert (scenario, method, choice.ended_by) == ("small", "hostile", "space")
    assert choice.parameters == {"way": "fine"}
    trials = {trial.parameters["way"]: trial for trial in choice.trials}
    assert {way for way, trial in trials.items() if trial.status == "ok"} == {"fine"}
    for way in ("load", "phantom", "voltages", "late"):
        assert "The test split is closed" in trials[way].message
    assert "longer than 5 s" in trials["hang"].message
    assert trials["hang"].seconds >= 5
    assert "exit code 3" in trials["die"].message
    assert "took more than 800 MB of memory" in trials["grow"].message
    (file,) = tmp_path.glob("*.json")
    spent = json.loads(file.read_text())["choices"]["hostile"]["spent"]
    assert (spent["trials"], spent["failed"]) == (8, 7)
    assert not list((tmp_path / "journals").iterdir())


def test_journals_of_other_tunings_that_were_stopped_stay(tmp_path: Path) -> None:
    other = tmp_path / "journals" / "other.log"
    other.parent.mkdir()
    other.write_text("a trial\n")
    budget = TuningBudget(trials=2)
    tune_all = tune(make_plan(suite(SMALL), methods=["noser"]), tmp_path, budget=budget)
    assert len(list(tune_all)) == 1
    assert list(other.parent.iterdir()) == [other]
    assert other.read_text() == "a trial\n"


FAILS = """
from dataclasses import dataclass
from typing import ClassVar
from eitbench.methods import Method, register
@register("fails")
@dataclass
class Fails(Method):
    search: ClassVar = {"weight": (1.0, 2.0)}
    weight: float = 1.0
    def fit(self, problem):
        raise RuntimeError("it cannot work")
    def reconstruct(self, voltages):
        raise AssertionError
"""


@pytest.mark.slow
def test_nothing_is_chosen_where_no_trial_gave_a_figure(
    tmp_path: Path, eitbench: Callable[..., tuple[int, str, str]]
) -> None:
    (tmp_path / "fails.py").write_text(FAILS)
    words = ("tune", SMALL_SUITE, "--plugin", tmp_path / "fails.py")
    out = tmp_path / "out"
    code, said, _ = eitbench(*words, "--methods", "fails", "--trials", "2", "--out", out)
    assert code == 0
    assert (
        "fails  nothing selected, as no trial gave a figure: RuntimeError: it cannot work" in said
    )
    assert not list(out.glob("*.json"))
    code, _, err = eitbench(*words, "--seconds", "inf", "--out", out)
    assert code == 2
    assert "A budget is a finite number of seconds, got inf." in err


def test_the_choice_is_the_best_of_what_is_known(tmp_path: Path) -> None:
    """A constant image of the untouched sensor is the best constant; its figure is known."""
    plan = make_plan(suite(SMALL), methods=["constant"], plugins=[PLUGIN])
    ((_, _, choice),) = tune(plan, tmp_path)
    assert choice.parameters == {"factor": 1.0}
    seen = SMALL.model_copy(update={"noise": SplitNoise(validation=40, test=40)})
    data = load(seen, split="validation", limit=FRAMES)
    best = frame_figures(data, np.ones((8, 16, 16), np.float32))
    assert choice.figure == pytest.approx(best.mean(), abs=1e-12)
    assert choice.trials[0].parameters == {"factor": 1.4}
    assert all(t.seconds > 0 for t in choice.trials)


SPACE = SearchSpace.of({"a": range(6), "b": range(6)}, {"a": 0, "b": 0})


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """The trials of studies of a known landscape, as they are evaluated."""
    done: list[dict[str, Any]] = []

    def run_trial(
        trial: optuna.Trial, parameters: dict[str, Any], _: Sequence[object], left: float
    ) -> Trial:
        if {"a": -1} in done:
            done.remove({"a": -1})
            raise KeyboardInterrupt
        done.append(parameters)
        figure = -float((parameters["a"] - 3) ** 2 + (parameters["b"] - 4) ** 2)
        for frame in range(FRAMES):
            trial.report(figure + 0.01 * frame, frame)
        if trial.should_prune():
            return Trial(parameters, None, "pruned", 2.0)
        return Trial(parameters, figure, "ok", 2.0)

    data = SimpleNamespace(truth="conductivity", classes=None)
    no_worker = SimpleNamespace(data=data, close=lambda: None)
    monkeypatch.setattr(tuning, "Validation", lambda *_: no_worker)
    monkeypatch.setattr(tuning, "_search_space", lambda *_: SPACE)
    monkeypatch.setattr(tuning, "run_trial", run_trial)
    return done


def the_choice(budget: TuningBudget, journals: Path) -> Selection:
    choice = select(TuningTask((SMALL,), "noser", None, "", suite(SMALL), budget), journals)
    assert choice is not None
    return choice


def test_the_budget_of_trials_is_spent_and_what_is_clearly_worse_is_pruned(
    asked: list[dict[str, Any]], tmp_path: Path
) -> None:
    choice = the_choice(TuningBudget(), tmp_path)
    assert choice.ended_by == "trials"
    assert len(asked) == len(choice.trials) == 16
    assert choice.parameters == {"a": 3, "b": 4}
    pruned = [trial for trial in choice.trials if trial.status == "pruned"]
    assert pruned
    assert all(trial.figure is None for trial in pruned)
    assert choice.figure == max(t.figure for t in choice.trials if t.figure is not None)


def test_the_budget_of_seconds_ends_a_study_and_is_recorded(
    asked: list[dict[str, Any]], tmp_path: Path
) -> None:
    choice = the_choice(TuningBudget(seconds=9.0), tmp_path)
    assert choice.ended_by == "seconds"
    assert len(asked) == 5
    assert choice.describe()["spent"]["seconds"] == 10.0


def test_a_trial_that_the_rest_of_the_time_ends_is_tried_again(
    asked: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says nothing of its parameters: with more time the choice is as if nothing had been."""
    whole = the_choice(TuningBudget(), tmp_path / "whole")
    complete: Callable[..., Trial] = tuning.run_trial  # type: ignore[attr-defined]

    def limited(*given: Any) -> Trial:
        if given[-1] < 2:
            raise BudgetSpentError
        return complete(*given)

    monkeypatch.setattr(tuning, "run_trial", limited)
    asked.clear()
    first = the_choice(TuningBudget(seconds=9.0), tmp_path)
    assert (first.ended_by, len(first.trials)) == ("seconds", 4)
    assert first.describe()["spent"]["failed"] == 0
    again = the_choice(TuningBudget(), tmp_path)
    assert again.parameters == whole.parameters
    assert [trial.parameters for trial in again.trials] == [t.parameters for t in whole.trials]


def test_time_that_is_up_is_no_failure_of_the_method() -> None:
    class Slow:
        def ask(self, *_: object, **__: object) -> None:
            raise WorkerLostError(Failure("timeout", "set-up took longer than 0.5 s"))

    clock = Clock(10.0)
    clock.spent = 9.5
    with pytest.raises(BudgetSpentError):
        clock.ask(Slow(), "fit", limit=600.0, what="set-up")  # type: ignore[arg-type]
    clock.spent = 0.0
    with pytest.raises(TrialFailedError, match="longer than"):
        clock.ask(Slow(), "fit", limit=5.0, what="set-up")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "after",
    [7, *(pytest.param(trials, marks=pytest.mark.slow) for trials in (0, 1, 15))],
)
def test_a_study_that_was_stopped_goes_on_where_it_stood(
    after: int, asked: list[dict[str, Any]], tmp_path: Path
) -> None:
    expected = the_choice(TuningBudget(), tmp_path / "whole")
    asked.clear()
    if after:
        the_choice(TuningBudget(trials=after), tmp_path / "cut")
    asked.append({"a": -1})
    with pytest.raises(KeyboardInterrupt):
        the_choice(TuningBudget(), tmp_path / "cut")
    (journal,) = (tmp_path / "cut").glob("*.log")
    with journal.open("a") as file:  # as a killed process leaves it: half a line, and its lock
        file.write('{"op_code": 4, "wor')
    journal.with_name(journal.name + ".lock").symlink_to(journal)
    assert the_choice(TuningBudget(), tmp_path / "cut") == expected
    assert len(asked) == 16


def test_a_study_is_not_continued_with_other_limits_or_other_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A trial that took longer than the old limits may not take longer than the new ones."""
    task = TuningTask((SMALL,), "noser", None, "", suite(SMALL), TuningBudget())
    more = replace(task, suite=task.suite.model_copy(update={"fit_limit_s": 1e4}))
    names = {tuning._made_by(of, "key") for of in (task, more)}
    assert len(names) == 2
    assert tuning._made_by(task, "key") in names
    monkeypatch.setattr(tuning, "git_commit", lambda: "another")
    assert tuning._made_by(task, "key") not in names


@pytest.mark.slow
def test_one_choice_for_several_scenarios(tmp_path: Path) -> None:
    other = SMALL.model_copy(update={"name": "other", "image_shape": (18, 18)})
    plan = make_plan(suite(SMALL, other), methods=["constant"], plugins=[PLUGIN])
    ((names, _, choice),) = tune(plan, tmp_path, once=True)
    assert names == "small, other"
    assert choice.once_for == ("small", "other")
    files = [json.loads(file.read_text()) for file in tmp_path.glob("*.json")]
    assert {content["made_on"] for content in files} == {"small", "other"}
    assert files[0]["choices"] == files[1]["choices"]
    # The untouched sensor is the standard: its figure is 0 on each scenario.
    assert choice.parameters == {"factor": 1.0}
    assert choice.figure == pytest.approx(0.0, abs=1e-6)


def test_a_condition_that_methods_do_not_know_is_tuned_on_the_familiar_one(tmp_path: Path) -> None:
    novel = {"name": "novel", "families": ("ring",), "validation": 0, "familiar": "small"}
    declared = suite(SMALL, SMALL.model_copy(update=novel))
    plan = make_plan(declared, methods=["constant"], plugins=[PLUGIN], scenarios=["novel"])
    ((name, _, _),) = tune(plan, tmp_path)
    assert name == "small"


def test_scenarios_of_unlike_spread_weigh_alike() -> None:
    validation = Validation(SMALL, "noser", None, suite(SMALL), threading.Event())
    validation.standardise()
    offset, scale = validation.standard
    background = frame_figures(validation.data, np.ones((8, 16, 16), np.float32))
    assert (offset, scale) == pytest.approx((background.mean(), background.std()))


def test_errors_of_places_count_by_how_far_touches_are_apart(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(60)
    content = from_pairs(released, pressed, SKIN, "bench", places)
    write_recording(content, tmp_path / "skin.h5")
    skin = RecordedScenario(name="skin", recording=str(tmp_path / "skin.h5"))
    validation = Validation(skin, "noser", None, suite(skin), threading.Event())
    validation.standardise()
    known = places.to_numpy()[::5]  # every fifth touch is for validation
    away = np.median(np.linalg.norm(known - known.mean(axis=0), axis=1))
    assert validation.standard == pytest.approx((0.0, 1e3 * away))


def test_a_recording_that_is_renamed_keeps_its_choices(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(10)
    keys = []
    for name, frames in (("a", pressed), ("b", pressed), ("c", 2 * pressed)):
        path = tmp_path / f"{name}.h5"
        write_recording(from_pairs(released, frames, SKIN, "bench", places), path)
        keys.append(validation_key(RecordedScenario(name=name, recording=str(path))))
    assert keys[0] == keys[1] != keys[2]


def test_few_presses_choose_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A registration maps two of three presses exactly, so that their median error says nothing."""
    x = np.random.default_rng(0).uniform(size=(2, 3, 2))
    register = fit_similarity(*x)
    assert register is not None
    assert np.median(np.linalg.norm(register(x[0]) - x[1], axis=1)) < 0.01
    released, pressed, places = pressed_skin(35)  # 7 for validation
    write_recording(from_pairs(released, pressed, SKIN, "bench", places), tmp_path / "skin.h5")
    skin = RecordedScenario(name="skin", recording=str(tmp_path / "skin.h5"))
    plan = make_plan(suite(skin), methods=["noser"])
    with pytest.raises(DataUnavailableError, match="no validation samples, or too few"):
        list(tune(plan, tmp_path / "out"))
    assert "'skin' is left out: parameters that are chosen on 7 presses" in caplog.text


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        # A tuple would come back as a list, to the method and to every later run.
        ("search = {'weight': ((1, 2), (3, 4))}", r"lists \(1, 2\) for 'weight'"),
        ("search = {'weight': (float('inf'), 0.1)}", "lists inf for 'weight'"),
        ("search = {'bound': (0.1, 0.2)}", "lists nan for 'bound' in `search`, or has it by def"),
        ("search = {'ends': (0.1, 0.2)}", r"lists \(1, 2\) for 'ends' in `search`, or has it by"),
        ("search = {'weight': 0.1}", "has to be a dictionary"),
        ("search = {'weight': 'abc'}", "has to be a dictionary"),
        ("search = {1: (0.1, 0.2)}", "has to be a dictionary"),
        ("search = [('weight', (0.1, 0.2))]", "has to be a dictionary"),
        ("search = {'weight': range(20000)}", "lists more than 1000 values for 'weight'"),
    ],
)
def test_a_search_that_no_run_could_use_is_refused(
    declared: str, says: str, tmp_path: Path
) -> None:
    plugin = tmp_path / "odd.py"
    odd = "    bound: float = float('nan')\n    ends: object = (1, 2)\n"
    lines = FAILS.splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if "search:" in line)
    lines[at] = odd + f"    {declared}\n"
    plugin.write_text("".join(lines))
    plan = make_plan(suite(SMALL), methods=["fails"], plugins=[plugin])
    with pytest.raises(InputError, match=says):
        list(tune(plan, tmp_path / "out"))


def test_a_method_that_cannot_be_tuned_keeps_no_other_from_it(tmp_path: Path) -> None:
    plugin = tmp_path / "odd.py"
    plugin.write_text(FAILS.replace("weight: float", "strength: float"))
    plan = make_plan(suite(SMALL), methods=["fails", "constant"], plugins=[plugin, PLUGIN])
    tuned = tune(plan, tmp_path / "out", budget=TuningBudget(trials=2))
    assert next(tuned)[1] == "constant"
    with pytest.raises(InputError, match="'fails' lists 'weight' in `search`"):
        next(tuned)


def test_a_search_over_a_parameter_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    plugin = tmp_path / "odd.py"
    plugin.write_text(FAILS.replace("weight: float", "strength: float"))
    plan = make_plan(suite(SMALL), methods=["fails"], plugins=[plugin])
    with pytest.raises(InputError, match="'fails' lists 'weight' in `search`"):
        list(tune(plan, tmp_path / "out"))


def test_tuning_leaves_out_data_that_cannot_be_had(
    tmp_path: Path,
    asked: list[dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    away = SMALL.model_copy(update={"name": "away", "image_shape": (18, 18)})

    def spy(scenario: Scenario, split: str, limit: int | None = None) -> Any:
        if scenario.name == "away":
            raise DataUnavailableError("It is not on this machine.")
        return load(scenario, split=split, limit=limit)

    monkeypatch.setattr("eitbench.benchmark.tuning.tuner.load", spy)
    plan = make_plan(suite(away, SMALL), methods=["noser"])
    assert [scenario for scenario, _, _ in tune(plan, tmp_path)] == ["small"]
    assert "'away' is left out" in caplog.text
    with pytest.raises(DataUnavailableError, match="nothing to tune on"):
        list(tune(make_plan(suite(away), methods=["noser"]), tmp_path))


def test_where_the_test_split_is_closed_nothing_gives_it() -> None:
    assert isinstance(SMALL, SimulatedScenario)
    with closed_test_split():
        for reach in (
            lambda: load(SMALL, split="test"),
            lambda: phantom(SMALL, "test", 0),
            lambda: clean_frames(SMALL, "test", 1),
        ):
            with pytest.raises(InputError, match="The test split is closed"):
                reach()
        assert len(load(SMALL, split="validation", limit=2)) == 2
    assert len(load(SMALL, split="test", limit=2)) == 2


@pytest.mark.usefixtures("recorded_data")
def test_recordings_have_no_test_frames_where_these_are_closed() -> None:
    whole = read_recording("ohmc16")
    with closed_test_split():
        kept = read_recording("ohmc16")
    assert set(whole.samples["split"]) == {"validation", "test"}
    assert set(kept.samples["split"]) == {"validation"}
    rows = (whole.samples["split"] == "validation").to_numpy()
    np.testing.assert_array_equal(kept.voltages, whole.voltages[rows])


# Runs in every Python process that the command starts, workers included.
AUDIT = """
import os, sys
def hook(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        name = os.path.basename(os.fsdecode(arguments[0]))
        if name.endswith((".h5", ".part")) and "-0" in name:
            with_fd = os.open(os.environ["AUDIT_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            os.write(with_fd, (name + "\\n").encode())
            os.close(with_fd)
sys.addaudithook(hook)
"""


def test_the_test_split_is_closed_in_this_process_while_methods_are_tuned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[bool] = []

    def looking(*_: object) -> None:
        closed.append(is_closed())

    monkeypatch.setattr(tuning, "select", looking)
    plan = make_plan(suite(SMALL), methods=["noser"])
    assert list(tune(plan, tmp_path)) == []
    assert closed == [True]
    assert not is_closed()


@pytest.mark.slow
def test_a_whole_tuning_opens_no_file_of_the_test_split(tmp_path: Path) -> None:
    """The cache starts empty, so that test samples would have to be simulated and stored."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(AUDIT)
    log = tmp_path / "audit.log"

    def opened_by(code: str, *arguments: str) -> list[str]:
        log.unlink(missing_ok=True)
        path = os.pathsep.join([str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")])
        own = {"PYTHONPATH": path, "AUDIT_LOG": str(log), "EITBENCH_CACHE": str(tmp_path / "cache")}
        command = [sys.executable, "-c", code, *arguments]
        subprocess.run(command, env=os.environ | own, cwd=tmp_path, check=True, timeout=250)
        return log.read_text().splitlines()

    def stored(split: str) -> list[Path]:
        return list((tmp_path / "cache").rglob(f"{split}-*.safetensors"))

    opened = opened_by(
        "from eitbench.cli import main; main()",
        *("tune", str(SMALL_SUITE), "--trials", "3", "--out", "choices"),
    )
    assert any("validation-" in name for name in opened)
    assert not any("test-" in name for name in opened)
    assert stored("validation")
    assert not stored("test")
    # Where it is loaded this shows: the test can fail.
    opened = opened_by(
        "import sys; from eitbench.scenarios import load, load_suite\n"
        "load(load_suite(sys.argv[1]).scenarios[0], split='test')",
        str(SMALL_SUITE),
    )
    assert any("test-" in name for name in opened)
    assert stored("test")
