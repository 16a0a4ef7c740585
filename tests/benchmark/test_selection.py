"""Choices on the validation split: the search, its records, and what it never sees."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.benchmark import selection
from eitbench.benchmark.selection import (
    BUDGET,
    Choice,
    choose,
    coordinate_search,
    record,
    selected_parameters,
    validation_key,
)
from eitbench.methods import methods
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.scenario import Scenario, SimulatedScenario, SplitNoise
from eitbench.scenarios.suites import load_suite, suites

SMALL = SimulatedScenario(
    name="small",
    image_shape=(16, 16),
    families=("circle", "rectangle"),
    noise=SplitNoise(train="mixture", validation="mixture", test=40),
    train=4,
    validation=8,
    test=4,
)


def test_search_finds_the_best_value_of_each_parameter() -> None:
    search = {"a": (1, 2, 3), "b": (10, 20)}
    choice = coordinate_search(
        search, {"a": 1, "b": 10}, lambda p: -((p["a"] - 2) ** 2) - abs(p["b"] - 20)
    )
    assert choice.parameters == {"a": 2, "b": 20}
    assert choice.figure == 0
    assert choice.figure == max(t.figure for t in choice.trials if t.figure is not None)


def test_search_keeps_to_its_budget_and_asks_nothing_twice() -> None:
    asked = []

    def evaluate(p: dict[str, Any]) -> float:
        asked.append(json.dumps(p, sort_keys=True))
        return float(p["a"] + p["b"])

    coordinate_search({"a": range(10), "b": range(10)}, {"a": 0, "b": 0}, evaluate, budget=BUDGET)
    assert len(asked) == len(set(asked)) == BUDGET


def test_a_failed_trial_cannot_win() -> None:
    choice = coordinate_search({"a": (1, 2)}, {"a": 1}, lambda p: None if p["a"] == 2 else -9.0)
    assert choice.parameters == {"a": 1}
    assert [t.figure for t in choice.trials] == [-9.0, None]


def test_only_the_validation_split_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = []

    def spy(scenario: Scenario, split: str, limit: int | None = None) -> Dataset:
        loaded.append(split)
        return load(scenario, split=split, limit=limit)

    monkeypatch.setattr(selection, "load", spy)
    choice = choose(SMALL, "tikhonov")
    assert choice is not None
    assert set(loaded) == {"validation"}
    assert 10 < len(choice.trials) <= BUDGET


def test_a_choice_is_made_at_the_noise_of_the_test_split(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def spy(scenario: SimulatedScenario, split: str, limit: int | None = None) -> Dataset:
        seen.append(scenario.noise.validation)
        return load(scenario, split=split, limit=limit)

    monkeypatch.setattr(selection, "load", spy)
    choose(SMALL, "back-projection")
    assert seen == [40.0]


def test_choices_are_found_by_the_data_they_were_made_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    assert selected_parameters(SMALL, "noser") is None
    record(SMALL, {"noser": Choice({"weight": 0.5}, 1.0, ())}, tmp_path / "selected")
    record(SMALL, {"tv": Choice({"weight": 0.7}, 1.0, ())}, tmp_path / "selected")
    assert selected_parameters(SMALL, "noser") == {"weight": 0.5}
    same = SMALL.model_copy(update={"name": "renamed", "phantoms": "small", "test": 3})
    assert selected_parameters(same, "tv") == {"weight": 0.7}
    for change in (
        {"noise": SplitNoise(test=50)},
        {"mesh_refinement": 2},
        {"families": ("circle",)},
        {"image_shape": (18, 18)},
    ):
        other = SMALL.model_copy(update=change)
        assert validation_key(other) != validation_key(SMALL)
        assert selected_parameters(other, "noser") is None


def test_every_packaged_simulated_scenario_has_choices_from_the_search_space() -> None:
    chosen = 0
    loaded = [load_suite(name) for name in suites()]
    listed = [
        (scenario, name)
        for suite in loaded
        if suite.ranks == "methods"
        for scenario in suite.scenarios
        if scenario.kind == "simulated"
        for name in suite.names
    ]
    for scenario, name in listed:
        if (cls := methods()[name]).search:
            parameters = selected_parameters(scenario, name)
            assert parameters is not None, f"{scenario.name}: eitbench tune has not seen {name}"
            assert set(parameters) == set(cls.search)
            for key, value in parameters.items():
                assert value in cls.search[key]
            chosen += 1
    assert chosen >= 8 * 12


def test_packaged_choices_record_their_rule_and_every_trial() -> None:
    files = sorted(selection.PACKAGED.glob("*.json"))
    assert files
    for file in files:
        content = json.loads(file.read_text())
        assert file.stem == content["validation_key"][:16]
        assert "validation" in content["rule"]
        for choice in content["choices"].values():
            figures = [t["figure"] for t in choice["trials"] if t["figure"] is not None]
            assert choice["figure"] == max(figures)
            assert len(choice["trials"]) <= BUDGET


def test_default_methods_of_all_suites_exist() -> None:
    for name in suites():
        assert set(load_suite(name).methods or ()) <= set(methods())


def test_ranked_figure_prefers_the_better_image() -> None:
    data = load(SMALL, split="validation")
    assert data.conductivity is not None
    truth = data.conductivity
    good = selection.ranked_figure(data, truth + 0.01)
    bad = selection.ranked_figure(data, np.ones_like(truth))
    assert good is not None
    assert bad is not None
    assert good > bad


def test_a_method_that_fails_on_some_frames_cannot_win() -> None:
    data = load(SMALL, split="validation")
    assert data.conductivity is not None
    estimates = data.conductivity.copy()
    estimates[0] = np.nan
    assert selection.ranked_figure(data, estimates) is None


def test_a_damaged_file_of_choices_is_named_and_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    path = record(SMALL, {"noser": Choice({"weight": 0.5}, 1.0, ())}, tmp_path / "selected")
    path.write_text(path.read_text()[:40])
    assert selected_parameters(SMALL, "noser") is None
    assert str(path) in caplog.text


def test_a_search_over_a_parameter_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    plugin = tmp_path / "odd.py"
    plugin.write_text(
        "from eitbench.methods import Method, register\n"
        "@register('odd-search')\n"
        "class Odd(Method):\n"
        "    search = {'strength': (1, 2)}\n"
        "    def fit(self, problem): ...\n"
        "    def reconstruct(self, voltages): ...\n"
    )
    with pytest.raises(InputError, match="'odd-search' lets 'strength' be chosen"):
        list(selection.tune([SMALL], ["odd-search"], tmp_path, plugins=[plugin]))


def test_tuning_leaves_out_data_that_cannot_be_had(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    away = SMALL.model_copy(update={"name": "away", "image_shape": (18, 18)})

    def spy(scenario: Scenario, split: str, limit: int | None = None) -> Dataset:
        if scenario.name == "away":
            raise DataUnavailableError("It is not on this machine.")
        return load(scenario, split=split, limit=limit)

    monkeypatch.setattr(selection, "load", spy)
    done = selection.tune([away, SMALL], ["back-projection"], tmp_path)
    assert [scenario for scenario, _, _ in done] == ["small"]
    assert "'away' is left out" in caplog.text
    with pytest.raises(DataUnavailableError, match="nothing to tune on"):
        list(selection.tune([away], ["back-projection"], tmp_path))


def test_a_calibrated_scenario_shares_the_choices_of_the_nominal_one() -> None:
    """Else a ladder would compare tuned with default parameters and call it calibration."""
    declared = {s.name: s for s in load_suite("sim2real").scenarios}
    for name in ("ohmc16", "ktc2023", "hydrogel-rectangle", "sim2real-emulated"):
        assert validation_key(declared[name]) == validation_key(declared[f"{name}-calibrated"])
    assert selected_parameters(declared["ohmc16-calibrated"], "noser") is not None
    # The whole ladder is tuned alike, as a user would: on the nominal sensor, with noise.
    rungs = [s for s in declared.values() if isinstance(s, SimulatedScenario)]
    assert len({validation_key(rung) for rung in rungs}) == 1
    assert selected_parameters(rungs[0], "noser") is not None
