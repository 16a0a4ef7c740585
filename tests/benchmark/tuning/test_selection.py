"""Records of choices, those that come with the package among them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eitbench.benchmark.tuning import selection
from eitbench.benchmark.tuning.selection import (
    PACKAGED,
    Selection,
    Trial,
    TuningBudget,
    at_edge,
    record,
    recorded_selection,
    selected_parameters,
    validation_key,
)
from eitbench.methods import methods
from eitbench.methods.learned.image_networks import NETWORKS
from eitbench.methods.registry import place_methods
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import load_suite, suites

(SMALL,) = load_suite(Path(__file__).parents[1] / "data" / "small.toml").scenarios
assert isinstance(SMALL, SimulatedScenario)


def choice(**parameters: object) -> Selection:
    trials = (Trial(parameters, 1.0), Trial({"weight": 9}, None, "failed", 2.0, "it said no"))
    return Selection(parameters, 1.0, trials, TuningBudget(), "space")


@pytest.mark.parametrize(
    ("tried", "selected", "edges"),
    [
        ((0.1, 0.3, 1.0), 0.1, ["weight"]),
        ((0.1, 0.3, 1.0), 1.0, ["weight"]),
        ((0.1, 0.3, 1.0), 0.3, []),
        ((0.0, 0.5, 1.0), 1.0, ["weight"]),
        ((0.0, 0.5, 1.0), 0.0, []),  # nothing lies below 0
        ((0.1, 1.0), 1.0, ["weight"]),
        ((True, False), True, []),
        (("conductivity", "clausius-mossotti", "other"), "other", []),
    ],
)
def test_a_value_at_the_edge_of_what_was_tried_is_told(
    tried: tuple[object, ...], selected: object, edges: list[str]
) -> None:
    trials = tuple(Trial({"weight": value}, 1.0) for value in tried)
    found = Selection({"weight": selected}, 1.0, trials, TuningBudget(), "space")
    assert at_edge(found.describe()) == edges


def test_choices_are_found_by_the_data_they_were_made_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    assert selected_parameters(SMALL, "noser") is None
    record(SMALL, {"noser": choice(weight=0.5)}, tmp_path / "selected")
    record(SMALL, {"tv": choice(weight=0.7)}, tmp_path / "selected")
    assert selected_parameters(SMALL, "noser") == {"weight": 0.5}
    same = SMALL.model_copy(update={"name": "renamed", "phantoms": "small", "test": 3})
    assert selected_parameters(same, "tv") == {"weight": 0.7}
    for change in (
        {"noise": SplitNoise(test=50)},
        {"imperfections": Imperfections(mesh="fine")},
        {"families": ("circle",)},
        {"image_shape": (18, 18)},
    ):
        other = SMALL.model_copy(update=change)
        assert validation_key(other) != validation_key(SMALL)
        assert selected_parameters(other, "noser") is None


def test_a_record_says_what_was_spent_and_why_a_trial_failed(tmp_path: Path) -> None:
    path = record(SMALL, {"noser": choice(weight=0.5)}, tmp_path)
    kept = json.loads(path.read_text())["choices"]["noser"]
    assert kept["budget"] == {"trials": 16, "seconds": 1200.0}
    spent = {"trials": 2, "pruned": 0, "failed": 1, "seconds": 2.0, "ended_by": "space"}
    assert kept["spent"] == spent
    assert kept["trials"][1]["message"] == "it said no"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: content.pop("rule"),
        lambda content: content["choices"]["noser"].pop("spent"),
        lambda content: content["choices"]["noser"].update(spent=3),
        lambda content: content["choices"]["noser"]["trials"][0].update(status="fine"),
        lambda content: content["choices"]["noser"].update(code=1),
        lambda content: content.update(choices=[]),
    ],
)
def test_a_damaged_record_is_named_and_counts_as_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
    spoil: Callable[[dict[str, Any]], object],
) -> None:  # fmt: skip
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    path = record(SMALL, {"noser": choice(weight=0.5)}, tmp_path / "selected")
    content = json.loads(path.read_text())
    spoil(content)
    path.write_text(json.dumps(content))
    assert recorded_selection(SMALL, "noser") is None
    assert f"{path} is damaged" in caplog.text
    record(SMALL, {"noser": choice(weight=0.7)}, tmp_path / "selected")
    assert selected_parameters(SMALL, "noser") == {"weight": 0.7}


def test_values_that_have_no_order_are_at_no_edge() -> None:
    tried = [{"parameters": {"of": [1, 2], "w": k}} for k in (1, 2, 3)]
    assert at_edge({"parameters": {"of": [1, 2], "w": 3}, "trials": tried}) == ["w"]
    assert at_edge({"parameters": {"w": 2}, "trials": tried}) == []


def test_a_choice_keeps_the_rule_that_it_was_made_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(selection, "RULE", "the old rule")
    record(SMALL, {"noser": choice(weight=0.5)}, tmp_path)
    monkeypatch.setattr(selection, "RULE", "the new rule")
    record(SMALL, {"tv": choice(weight=0.5)}, tmp_path)
    content = json.loads(record(SMALL, {"greit": choice(weight=0.5)}, tmp_path).read_text())
    rules = {name: of.get("rule", content["rule"]) for name, of in content["choices"].items()}
    assert rules == {"noser": "the old rule", "tv": "the new rule", "greit": "the new rule"}


# What networks learn from; they list no method that has more to tune than gains.
UNTUNED = {"tank", "imperfect", "imperfect-presses"}


@pytest.mark.slow
def test_every_packaged_simulated_scenario_has_choices_from_the_search_space() -> None:
    chosen = 0
    known = methods()
    loaded = [load_suite(name) for name in suites()]
    listed = [
        (suite.familiar(scenario), name)
        for suite in loaded
        if suite.ranks == "methods" and suite.name not in UNTUNED
        for scenario in suite.scenarios
        if scenario.kind == "simulated"
        for name in (*suite.names, "pyeit-jac", "pyeit-greit", "pyeit-bp")
    ]
    for scenario, name in listed:
        # Choices of before there were gains and amplification have none of these.
        if search := {k: v for k, v in known[name].search.items() if k not in NETWORKS}:
            parameters = selected_parameters(scenario, name)
            assert parameters is not None, f"{scenario.name}: eitbench tune has not seen {name}"
            assert set(parameters) - set(NETWORKS) == set(search)
            for key, value in parameters.items():
                assert value in known[name].search[key]
            chosen += 1
    assert chosen >= 8 * 12


def test_packaged_choices_record_their_rule_what_they_cost_and_every_trial() -> None:
    files = sorted(PACKAGED.glob("*.json"))
    assert files
    for file in files:
        content = json.loads(file.read_text())
        assert file.stem == content["validation_key"][:16]
        assert "validation" in content["rule"]
        for kept in content["choices"].values():
            trials, spent = kept["trials"], kept["spent"]
            assert kept["figure"] == max(t["figure"] for t in trials if t["figure"] is not None)
            assert all((t["figure"] is None) == (t["status"] != "ok") for t in trials)
            assert (
                spent["trials"] == len(trials) <= kept["budget"]["trials"] == TuningBudget().trials
            )


def test_methods_were_tuned_alike_on_the_same_data() -> None:
    """No method of ours was denied a parameter that another one could choose there."""
    known: dict[str, type] = {**methods(), **place_methods()}
    for file in sorted(PACKAGED.glob("*.json")):
        chosen = json.loads(file.read_text())["choices"]
        searched = {name: set(of["parameters"]) for name, of in chosen.items()}
        for key in NETWORKS:
            has = [name for name in chosen if key in getattr(known[name], "search", {})]
            with_it = [name for name in has if key in searched[name]]
            assert with_it in ([], has), f"{file.name}: {key} was searched for {with_it} alone"


def test_a_damaged_file_of_choices_is_named_and_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    path = record(SMALL, {"noser": choice(weight=0.5)}, tmp_path / "selected")
    path.write_text(path.read_text()[:40])
    assert selected_parameters(SMALL, "noser") is None
    assert str(path) in caplog.text


def test_a_calibrated_scenario_shares_the_choices_of_the_nominal_one() -> None:
    """Else a ladder would compare tuned with default parameters and call it calibration."""
    declared = {s.name: s for s in load_suite("sim2real").scenarios}
    for name in ("ohmc16", "ktc2023", "sim2real-emulated"):
        assert validation_key(declared[name]) == validation_key(declared[f"{name}-calibrated"])
    assert selected_parameters(declared["ohmc16-calibrated"], "noser") is not None
    # The whole ladder is tuned alike, as a user would: on the nominal sensor, with noise.
    rungs = [s for s in declared.values() if isinstance(s, SimulatedScenario)]
    assert len({validation_key(rung) for rung in rungs}) == 1
    assert selected_parameters(rungs[0], "noser") is not None
