"""Trials within a limit, with a clock of our own; and a whole choice for a tiny sensor."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.choice import candidates as candidates_module
from eitbench.benchmark.choice import measure
from eitbench.benchmark.choice.decision import Pick, read_choice
from eitbench.benchmark.choice.measure import (
    MethodTrial,
    choose,
    decide,
    parameters_of,
    within_limit,
)
from eitbench.benchmark.run.runner import RunInterruptedError, start_run
from eitbench.benchmark.tuning import selection
from eitbench.benchmark.tuning.selection import Selection, Trial, TuningBudget
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.suites.suite import load_suite

TINY = """
name = "tiny"
image_shape = [12, 12]
conductivity_range = [0.05, 1.0]
[outline]
rectangle_mm = [100, 100]
[electrodes]
count = 8
width_mm = 8
start_mm = 12.5
[pattern]
offset = 3
"""


@pytest.mark.parametrize(
    ("limit", "tried", "left"),
    [
        (0, "", "abc"),
        (1, "a", "bc"),  # b would begin when the time is over
        (3, "ab", "c"),
        (4, "abc", "c"),  # c begins and is stopped
        (6, "abc", ""),
    ],
)
def test_methods_are_tried_while_there_is_time(limit: int, tried: str, left: str) -> None:
    """They take 1, 2 and 3 seconds by our clock."""
    now, begun = 0, []

    def attempt(name: str) -> bool:
        nonlocal now
        begun.append(name)
        now = min(now + 1 + "abc".index(name), max(limit, now))
        return sum(1 + "abc".index(other) for other in begun) <= limit

    assert within_limit("abc", lambda: now < limit, attempt) == list(left)
    assert begun == list(tried)


def trial(method: str, frame_ms: float, seed: int, **shifts: float) -> MethodTrial:
    """A trial with errors of 10 mm and a shift by scenario, noise of 1 mm, in 20 sessions."""
    rng = np.random.default_rng(seed)
    samples = pd.concat(
        pd.DataFrame(
            {
                "scenario": scenario,
                "sample": np.arange(60),
                "cluster": np.repeat(np.arange(20), 3),
                "localisation_mm": 10 + shifts.get(scenario, 0.0) + rng.normal(size=60),
                "score": 5.0,
                "bounded": 0.7,
            }
        )
        for scenario in ("frames", "touches", "drift")
    )
    whole = {"frame_ms_p95": frame_ms, "coverage": 1.0}
    cells = pd.DataFrame([whole] * 3, index=["frames", "touches", "drift"])
    return MethodTrial(method, {}, "none", samples, cells)


ABOUT: dict[str, Any] = {
    "asked": "set", "drift": "simulated", "sensor_sha256": "", "time_limit_s": 60,
    "not_tried": (), "unusable": {},
}  # fmt: skip


def test_the_deadline_excludes_and_drift_has_a_best_of_its_own() -> None:
    trials = [
        trial("slow", 150.0, 0, frames=-5, touches=0, drift=-5),
        trial("sharp", 20.0, 1, frames=-2, touches=0, drift=4),
        trial("steady", 10.0, 2, frames=0, touches=6, drift=6),
    ]
    choice = decide(trials, "frames", 10.0, **ABOUT)
    assert (choice.best, choice.best_with_drift) == (Pick(method="sharp"), Pick(method="steady"))
    assert [row.method for row in choice.tried] == ["slow", "sharp", "steady"]
    assert [row.in_time for row in choice.tried] == [False, True, True]
    assert choice.row("sharp").place.value == pytest.approx(8, abs=0.5)
    assert choice.row("sharp").drift.low < 14 < choice.row("sharp").drift.high
    assert choice.presses == 60
    # Presses with what drift adds to simulated touches; no less than nothing.
    assert choice.row("sharp").with_drift.value == pytest.approx(8 + 4, abs=0.6)
    assert choice.row("slow").with_drift == choice.row("slow").place
    # Where drift was recorded, the presses with it.
    recorded = decide(trials, "frames", 10.0, **(ABOUT | {"drift": "recorded"}))
    assert recorded.row("sharp").with_drift == recorded.row("sharp").drift
    assert recorded.best_with_drift == Pick(method="sharp")
    # Where there are no presses, simulated touches after drift.
    simulated = decide(trials, "touches", 10.0, **ABOUT)
    assert (simulated.best, simulated.best_with_drift) == (
        Pick(method="sharp"),
        Pick(method="sharp"),
    )
    assert simulated.row("sharp").with_drift == simulated.row("sharp").drift
    # At 5 frames/s there is time for the slow one; at 200 for none.
    assert decide(trials, "frames", 5.0, **ABOUT).best == Pick(method="slow")
    assert decide(trials, "frames", 200.0, **ABOUT).best is None


def test_with_drift_the_best_stays_where_no_other_is_told_from_it() -> None:
    trials = [
        trial("sharp", 20.0, 1, frames=-2, touches=-2, drift=0),
        trial("steady", 10.0, 2, frames=0, touches=0, drift=0),
    ]
    choice = decide(trials, "touches", 10.0, **ABOUT)
    assert choice.best == Pick(method="sharp")
    assert choice.best_with_drift == Pick(method="sharp", not_told_from=("steady",))


@pytest.mark.slow
def test_a_method_that_fails_as_a_whole_costs_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY)

    def refused(scenario: Any, method: str, *rest: Any) -> Any:
        if method == "noser":
            raise InputError("Parameter 'weigth' is unknown.")
        return {}, "none"

    monkeypatch.setattr(measure, "parameters_of", refused)
    where = str(tmp_path / "tiny.toml")
    names = ("noser", "back-projection")
    choice = choose(where, tmp_path / "out", methods=names, time_limit_s=90)
    assert [row.method for row in choice.tried] == ["back-projection"]
    assert choice.unusable == {"noser": "Parameter 'weigth' is unknown."}
    assert choice.not_tried == ()
    with pytest.raises(EitbenchError, match=r"No method could be measured: Parameter 'weigth'"):
        choose(where, tmp_path / "other", methods=["noser"], time_limit_s=90)


@pytest.mark.parametrize(
    ("figures", "ended_by", "chosen_by"),
    [
        ([1.0, None, None], "space", "tuning"),  # others were given up
        ([1.0, None, None], "seconds", "tuning"),
        ([1.0], "seconds", "default"),
        ([None, 2.0, None], "seconds", "tuning"),  # the defaults fail
        ([None, None], "space", "no figure"),
        ([1.0, 2.0], "seconds", "tuning"),
    ],
)
def test_parameters_are_called_tuned_where_something_was_compared(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, figures: list[float | None],
    ended_by: Any, chosen_by: str,
) -> None:  # fmt: skip
    trials = tuple(Trial({"w": k}, figure) for k, figure in enumerate(figures))
    known = [trial for trial in trials if trial.figure is not None]
    best = known[-1] if known else Trial({}, None)
    selection = Selection(best.parameters, best.figure, trials, TuningBudget(), ended_by)
    monkeypatch.setattr(measure, "recorded_selection", lambda *_: None)
    monkeypatch.setattr(measure, "choose_by_chance", lambda _: False)
    monkeypatch.setattr(measure, "load", lambda *_, **__: None)
    monkeypatch.setattr(measure, "make_plan", lambda *_, **__: None)
    monkeypatch.setattr(measure, "tune", lambda *_, **__: [("small", "noser", selection)])
    suite = load_suite("quick")
    found = measure.parameters_of(suite.scenarios[0], "noser", suite, TuningBudget(), tmp_path)
    assert found == ({} if chosen_by == "default" else best.parameters, chosen_by)


@pytest.mark.slow
def test_what_was_measured_before_an_interruption_is_decided_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY)
    run = start_run

    def interrupted(plan: Any, out: Path, **options: Any) -> Any:
        if plan.methods == ("noser",):
            raise RunInterruptedError("Interrupted", str(out))
        return run(plan, out, **options)

    monkeypatch.setattr(measure, "start_run", interrupted)
    names = ("back-projection", "noser")
    choice = choose(str(tmp_path / "tiny.toml"), tmp_path / "out", methods=names, time_limit_s=90)
    assert [row.method for row in choice.tried] == ["back-projection"]
    assert choice.not_tried == ("noser",)

    def stopped(_: Any, method: str, *__: Any) -> Any:
        if method == "noser":
            raise KeyboardInterrupt
        return {}, "default"

    with monkeypatch.context() as patch:
        patch.setattr(measure, "parameters_of", stopped)
        in_tuning = tmp_path / "tuning"
        choice = choose(str(tmp_path / "tiny.toml"), in_tuning, methods=names, time_limit_s=90)
    assert [row.method for row in choice.tried] == ["back-projection"]
    with pytest.raises(RunInterruptedError):
        choose(str(tmp_path / "tiny.toml"), tmp_path / "none", methods=("noser",), time_limit_s=90)


def test_a_method_that_made_no_image_is_never_the_best() -> None:
    trials = [
        trial("failed", np.nan, 0, touches=-9, drift=-9, frames=-9),
        trial("fair", 1.0, 1, touches=0, drift=0, frames=0),
    ]
    choice = decide(trials, "touches", 10.0, **ABOUT)
    assert choice.best == choice.best_with_drift == Pick(method="fair")
    assert choice.row("failed").frame_ms is None


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The path of a tiny sensor, which is touched twelve times."""
    monkeypatch.setattr(candidates_module, "SIMULATED", 12)
    monkeypatch.setattr(candidates_module, "FRAMES", 3)
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return str(path)


def test_parameters_on_record_come_first_then_trials_then_defaults(
    tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite, _ = candidates_module.scenarios_of(tiny, 60.0)
    scenario, budget = suite.scenarios[0], TuningBudget(seconds=1.0)
    scored = Trial({"weight": 0.1}, -5.0)
    found = Selection({"weight": 0.1}, -5.0, (scored,), budget, "seconds")
    monkeypatch.setattr(measure, "tune", lambda *_, **__: iter([("touches", "noser", found)]))

    def chosen() -> tuple[dict[str, Any], str]:
        return parameters_of(scenario, "noser", suite, budget, tmp_path)

    assert chosen() == ({}, "default")  # one trial, that of the defaults, compares nothing
    found = Selection({"weight": 0.1}, -5.0, (scored, scored), budget, "trials")
    assert chosen() == ({"weight": 0.1}, "tuning")
    monkeypatch.setattr(measure, "tune", lambda *_, **__: iter([]))
    assert chosen() == ({}, "none")
    with monkeypatch.context() as patch:
        patch.setattr(measure, "choose_by_chance", lambda data: True)
        assert chosen() == ({}, "few presses")
    recorded = Selection({"weight": 0.7}, -4.0, (scored,), budget, "trials")
    monkeypatch.setattr(selection, "user_selections", lambda: tmp_path)
    selection.record(scenario, {"noser": recorded}, tmp_path)
    assert chosen() == ({"weight": 0.7}, "record")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"frame_rate": 0.0}, "frame rate is a number of frames/s above 0, got 0"),
        ({"frame_rate": -1.0}, "above 0, got -1"),
        ({"time_limit_s": 0.0}, "time limit is a number of seconds above 0, got 0"),
        ({"time_limit_s": float("inf")}, "above 0, got inf"),
        ({"methods": ["nose"]}, "did you mean 'noser'"),
        ({"methods": ["linear-touch"]}, "never chosen: it learns from thousands"),
        ({"methods": ["dnn"]}, "No method can be used on sensor"),
    ],
)
def test_what_cannot_be_is_one_sentence_and_leaves_nothing(
    tiny: str, tmp_path: Path, options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as error:
        choose(tiny, tmp_path / "out", **options)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_an_unknown_name_and_a_sensor_without_room_are_named(tiny: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(InputError, match="did you mean 'ohmc16'"):
        choose("omc16", out)
    small = tmp_path / "small.toml"
    small.write_text(TINY.replace("[12, 12]", "[5, 5]"))
    with pytest.raises(InputError, match="choose a finer grid"):
        choose(str(small), out)
    (out / "mine").mkdir(parents=True)
    with pytest.raises(InputError, match="not an empty folder"):
        choose(tiny, out)


def test_a_limit_that_is_over_before_the_first_method_is_an_error(
    tiny: str, tmp_path: Path
) -> None:
    times = iter([0.0, 100.0])
    with pytest.raises(EitbenchError, match="No method was finished within 60 s"):
        choose(tiny, tmp_path / "out", time_limit_s=60.0, clock=lambda: next(times))


@pytest.mark.slow
def test_a_choice_for_a_tiny_sensor(
    tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third method is left out as our clock says that the time is over."""

    def budget(seconds: float) -> TuningBudget:
        return TuningBudget(trials=2, seconds=600.0)

    monkeypatch.setattr(measure, "TuningBudget", budget)
    times = iter([0.0, 0.0, 0.0, 0.0, 0.0, 1e9])
    choice = choose(
        tiny,
        tmp_path / "out",
        methods=["greit", "noser", "back-projection"],
        time_limit_s=3600.0,
        clock=lambda: next(times),
    )
    assert {row.method: row.chosen_by for row in choice.tried} == {
        "back-projection": "tuning", "noser": "tuning"
    }  # fmt: skip
    assert choice.not_tried == ("greit",)
    assert choice.decided_on == "touches"
    assert choice.best is not None
    assert choice.presses == 12
    for row in choice.tried:
        assert 0 < row.place.low <= row.place.value <= row.place.high < 150
        assert row.coverage == 1
    path = tmp_path / "choice.json"
    path.write_text(choice.model_dump_json())
    name, parameters = read_choice(path, sensor_by_name(tiny))
    assert name == choice.best.method
    assert parameters["noser"].keys() >= {"weight"}


@pytest.mark.slow
def test_labelled_presses_decide(
    recorded_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("SIMULATED", 6), ("MOST_PRESSES", 20)):
        monkeypatch.setattr(candidates_module, name, value)
    choice = choose("ohmc8", tmp_path / "out", methods=["noser"], time_limit_s=3600.0)
    assert (choice.decided_on, choice.presses) == ("frames", 20)
    (row,) = choice.tried
    assert row.chosen_by == "tuning"
    assert row.place != row.touches
