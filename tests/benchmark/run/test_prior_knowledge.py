"""Prior knowledge: recorded reads of a problem, and the overlap with the test split."""

import copy
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.benchmark.analysis.results import describe_prior_knowledge
from eitbench.benchmark.run.prior_knowledge import (
    UNKNOWN,
    Training,
    prior_knowledge_columns,
    read_report,
    training_contents,
)
from eitbench.benchmark.tuning.selection import Selection, Trial, TuningBudget
from eitbench.benchmark.workers.messages import WorkerLostError
from eitbench.benchmark.workers.method_service import MethodService
from eitbench.methods import Problem, create
from eitbench.methods.problem import AccessRecord
from eitbench.reports.tables.boards import overlaps
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import contents
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.scenario import Scenario, SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import scenarios

SMALL = SimulatedScenario(
    name="small",
    image_shape=(16, 16),
    families=("circle", "rectangle"),
    noise=SplitNoise(train="mixture", validation="clean", test=40),
    train=6,
    validation=8,
    test=4,
)


def own(split: str, limit: int | None) -> Dataset:
    return load(SMALL, split=split, limit=limit)


def leaking(split: str, limit: int | None) -> Dataset:
    """A training stream that is the test stream, in another order and noise."""
    data = own("test", limit)
    noise = 1e-3 * np.random.default_rng(0).normal(size=data.voltages.shape)
    return replace(
        data,
        split="train",
        voltages=data.voltages[::-1] + noise,
        phantoms=data.phantoms[::-1],
        samples=data.samples.iloc[::-1],
    )


def columns(
    access: AccessRecord,
    training: Training | None,
    scenario: Scenario,
    test: Dataset,
    *,
    spent: dict[str, Any],
) -> dict[str, Any]:
    """Of a method that learned from the scenario that it is tested on."""
    return prior_knowledge_columns(access, training, scenario, scenario, test, spent=spent)


def a_problem(splits: Callable[[str, int | None], Dataset] = own) -> Problem:
    data = own("validation", 1)
    return Problem(data.sensor, data.references[0], splits)


@pytest.mark.parametrize(
    ("read", "noted"),
    [
        (lambda p: p.mask.sum() + p.background + p.sensor.n_measurements, set()),
        (lambda p: p.sensor.n_electrodes + p.sensor.outline.perimeter, set()),
        (lambda p: p.difference(p.reference[None]), {"gain"}),
        (lambda p: p.differences(own("validation", 1)), {"gain"}),
        (lambda p: p.jacobian, {"model"}),
        (lambda p: p.background_voltages, {"model"}),
        (lambda p: p.sensor.electrodes[0].contact_impedance, {"model"}),
        (lambda p: p.sensor.conductivity_range, {"conductivity_range"}),
    ],
)
def test_what_is_read_is_noted_and_nothing_else(
    read: Callable[[Problem], object], noted: set[str]
) -> None:
    problem = a_problem()
    read(problem)
    access = problem.access_record()
    assert {n for n in ("model", "gain", "conductivity_range") if getattr(access, n)} == noted
    assert access.samples == ()


def test_a_model_that_is_cached_already_is_noted_all_the_same() -> None:
    problem = a_problem()
    assert problem.gain > 0
    assert not problem.access_record().model
    assert forward_model(problem.sensor) is forward_model(own("validation", 1).sensor)
    assert problem.access_record().model


def test_the_sensor_is_as_good_as_the_one_it_stands_for() -> None:
    plain, problem = own("validation", 1).sensor, a_problem()
    assert problem.sensor == plain
    assert plain == problem.sensor
    assert problem.sensor.describe() == plain.describe()
    assert not problem.access_record().conductivity_range
    assert replace(problem.sensor, image_shape=(8, 8)) == replace(plain, image_shape=(8, 8))
    assert copy.deepcopy(problem.sensor) == plain
    assert problem.access_record().conductivity_range


def test_the_most_samples_that_were_given_count() -> None:
    problem = a_problem()
    problem.training(2)
    problem.training(5)
    problem.training(1)
    problem.validation()
    given = {g.split: (g.samples, g.scenario, g.data_hash) for g in problem.access_record().samples}
    assert given == {
        "train": (5, "small", SMALL.data_hash("train")),
        "validation": (8, "small", SMALL.data_hash("validation")),
    }


def test_content_is_what_lies_on_the_sensor() -> None:
    data = own("test", None)
    other = load(SMALL.model_copy(update={"noise": SplitNoise(test="clean")}), split="test")
    assert not np.array_equal(data.voltages, other.voltages)
    shown = contents(data.phantoms, None)
    np.testing.assert_array_equal(shown, contents(other.phantoms, None))
    assert len(set(shown)) == len(data)
    frames = contents((), np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 3.0]]))
    assert frames[0] == frames[1] != frames[2]


def test_training_on_the_test_stream_is_counted() -> None:
    """Whatever the noise and the order, and however few of them."""
    problem = a_problem(leaking)
    test = own("test", None)
    problem.training()
    assert columns(problem.access_record(), None, SMALL, test, spent={})["overlap"] == 4
    few = own("test", 3)
    assert columns(problem.access_record(), None, SMALL, few, spent={})["overlap"] == 3


def test_a_method_that_learns_from_the_test_stream_is_counted() -> None:
    """As in a worker: what the method asks for itself is what is compared."""
    data = own("test", None)
    service = MethodService(data.sensor, data.references[0], leaking, "linear-learned", {})
    service.fitted({})
    access, training = read_report(service.prior_knowledge().value)
    assert [given.split for given in access.samples] == ["train"]
    found = columns(access, training, SMALL, data, spent={})
    assert found["overlap"] == len(data)
    row = {"method": "linear-learned", "n": 4, "data_n": 4, "prior_knowledge": "", "overlap": 4.0}
    said = overlaps([row])
    assert said == ["4 of 4 test samples were in the training set of linear-learned"]


def test_an_honest_training_split_overlaps_nowhere() -> None:
    problem = a_problem()
    problem.training()
    problem.validation()
    found = columns(problem.access_record(), None, SMALL, own("test", None), spent={})
    assert found["overlap"] == 0
    assert (
        describe_prior_knowledge(found["prior_knowledge"])
        == "learned from 6 training samples; learned from 8 validation samples; "
        "trained on the families of the test phantoms"
    )


def test_knowledge_by_tuning_is_reported() -> None:
    trials = tuple(Trial({"weight": float(k)}, 1.0) for k in range(12))
    choice = Selection({"weight": 0.0}, 1.0, trials, TuningBudget(), "seconds")
    problem, test = a_problem(), own("test", None)
    create("noser").fit(problem)
    found = columns(problem.access_record(), None, SMALL, test, spent=choice.describe()["spent"])
    assert describe_prior_knowledge(found["prior_knowledge"]) == (
        "knows the nominal contact impedance; knows the conductivity range; "
        "learned the noise level from tuning; tuned with 12 trials"
    )
    spent = choice.describe()["spent"] | {"edges": ["weight"]}
    edge = columns(problem.access_record(), None, SMALL, test, spent=spent)["prior_knowledge"]
    assert describe_prior_knowledge(edge).endswith(
        "tuned with 12 trials (weight at the edge of the search range)"
    )
    assert "tuning" not in describe_prior_knowledge(
        columns(problem.access_record(), None, SMALL, test, spent={})["prior_knowledge"]
    )


def test_noise_is_known_from_data_that_have_it() -> None:
    same = SMALL.model_copy(update={"noise": SplitNoise(train=40, validation=30, test=40)})
    problem = a_problem(lambda split, limit: load(same, split=split, limit=limit))
    problem.training()
    problem.validation()
    found = columns(problem.access_record(), None, same, load(same, split="test"), spent={})
    assert json.loads(found["prior_knowledge"])["noise"] == ["train"]


def test_what_is_given_is_that_of_the_familiar_scenario() -> None:
    """Of which frames are to be novel: a method has not seen what they show, nor their noise."""
    novel = SMALL.model_copy(update={"families": ("ring",), "noise": SplitNoise(test=30)})
    problem, test = a_problem(), load(novel, split="test")
    problem.training()
    problem.validation()
    access, spent = problem.access_record(), {"trials": 12}
    text = prior_knowledge_columns(access, None, novel, SMALL, test, spent=spent)
    found = json.loads(text["prior_knowledge"])
    assert (found["families"], found["noise"]) == ("other", [])
    own_noise = SMALL.model_copy(update={"noise": SplitNoise(train=30, test=30)})
    text = prior_knowledge_columns(access, None, novel, own_noise, test, spent=spent)
    assert json.loads(text["prior_knowledge"])["noise"] == ["train", "tuning"]


def test_weights_are_held_against_the_data_they_come_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    notes = Training("small", SMALL.data_hash("train"), 6, "3")
    problem, test = a_problem(), own("test", None)
    train = load(SMALL, split="train")
    found = columns(problem.access_record(), notes, SMALL, test, spent={})
    assert found["overlap"] == 0
    assert describe_prior_knowledge(found["prior_knowledge"]) == (
        "weights trained once with seed 3 on 6 samples; "
        "trained on the families of the test phantoms"
    )
    endless = columns(
        problem.access_record(), replace(notes, unlimited=True), SMALL, test, spent={}
    )
    assert "on 6 samples of unlimited simulation;" in describe_prior_knowledge(
        endless["prior_knowledge"]
    )
    unseen = SMALL.model_copy(update={"families": ("ring",), "training_families": SMALL.families})
    theirs = replace(notes, train_data=unseen.data_hash("train"))
    other = columns(problem.access_record(), theirs, unseen, test, spent={})["prior_knowledge"]
    assert describe_prior_knowledge(other).endswith("; trained on other families of phantoms")
    # What is tested on what it was trained on.
    assert columns(problem.access_record(), notes, SMALL, train, spent={})["overlap"] == 6
    # Weights of an own suite, in another one, once a run of the own suite has told their contents.
    other_suite = SMALL.model_copy(update={"name": "other", "families": ("ring",)})
    assert columns(problem.access_record(), notes, other_suite, train, spent={})["overlap"] == 6
    # Nothing is known of data that are not here.
    elsewhere = replace(notes, train_data="0" * 64)
    assert np.isnan(columns(problem.access_record(), elsewhere, SMALL, test, spent={})["overlap"])


@pytest.mark.parametrize(
    "lie",
    [
        {"train_samples": "-1"},
        {"train_samples": "many"},
        {"train_samples": "9" * 4000},
        {"train_data": "../" * 8},
        {"seed": "x" * 500},
        {"scenario": None},
    ],
)
def test_training_that_cannot_be_is_not_known(lie: dict[str, Any]) -> None:
    access = asdict(a_problem().access_record())
    honest = {"scenario": "small", "train_data": SMALL.data_hash("train"), "train_samples": "6"}
    _, training = read_report({"access": access, "trained_on": honest})
    assert training == Training("small", SMALL.data_hash("train"), 6)
    _, training = read_report({"access": access, "trained_on": honest | lie})
    assert training == UNKNOWN
    test = own("test", None)
    found = columns(a_problem().access_record(), training, SMALL, test, spent={})
    assert np.isnan(found["overlap"])
    assert describe_prior_knowledge(found["prior_knowledge"])


def test_more_training_samples_than_a_scenario_has_are_not_drawn() -> None:
    many = Training("small", SMALL.data_hash("train"), SMALL.train + 1)
    found = columns(a_problem().access_record(), many, SMALL, own("test", None), spent={})
    assert np.isnan(found["overlap"])


@pytest.mark.parametrize(
    "lie",
    [
        {"model": 3},
        {"samples": [{}]},
        {"samples": [{"split": "test", "samples": 0, "contents": np.empty(0, np.uint64)}]},
        {"samples": [{"split": "train", "samples": 9, "contents": np.empty(0, np.uint64)}]},
    ],
)
def test_a_record_of_access_that_cannot_be_is_no_answer(lie: dict[str, Any]) -> None:
    access = asdict(a_problem().access_record())
    named = {"scenario": "small", "data_hash": ""}
    lie = {k: [s | named for s in v] if k == "samples" else v for k, v in lie.items()}
    with pytest.raises(WorkerLostError, match="is no answer"):
        read_report({"access": access | lie, "trained_on": {}})


def test_contents_of_a_training_set_are_found_out_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    asked = SMALL, 6, SMALL.data_hash("train")
    first = training_contents(*asked)
    assert set(first) == set(contents(load(SMALL, split="train").phantoms, None))
    (kept,) = (tmp_path / "contents").iterdir()
    monkeypatch.setattr("eitbench.benchmark.run.prior_knowledge.phantom", None)  # not drawn again
    np.testing.assert_array_equal(training_contents(*asked), first)
    kept.write_bytes(b"damaged")
    monkeypatch.undo()
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    np.testing.assert_array_equal(training_contents(*asked), first)


@pytest.mark.parametrize(
    ("name", "suite", "count"),
    [
        ("dnn", "paper", 24_000),
        ("learned-gn-large", "paper", 240_000),
        ("latent-flow", "presses", 24_000),
    ],
)
def test_packaged_weights_come_with_the_contents_of_their_training_data(
    name: str, suite: str, count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that a run need not draw so many phantoms to compare them."""
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path))
    scenario = scenarios()[suite]
    assert isinstance(scenario, SimulatedScenario)
    data = load(suite, split="validation", limit=2)
    method = create(name)
    method.fit(Problem(data.sensor, data.references[0], own))
    assert int(method.trained_on["train_samples"]) == count
    assert int(method.trained_on["unlimited"]) == (count > scenario.train)
    packaged = training_contents(scenario, count, method.trained_on["train_data"])
    assert not (tmp_path / "contents").exists()
    drawn = (phantom(scenario, "train", sample) for sample in (0, 1, count - 1))
    assert np.isin(contents(tuple(drawn), None), packaged).all()


@pytest.mark.parametrize(
    "damaged",
    ["{", "[]", "1.5", "null", '"x"', "{}", '{"model": 1}', '\ufeff{"model": true}'],
)
def test_a_damaged_account_is_refused(damaged: str) -> None:
    with pytest.raises(ValueError, match="validation error"):
        describe_prior_knowledge(damaged)
