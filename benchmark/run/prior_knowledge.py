"""Prior knowledge of a method, as it was measured, and its overlap with the test split."""

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, InstanceOf, StringConstraints, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from eitbench.benchmark.tuning.selection import validation_scenario
from eitbench.benchmark.workers.messages import array_in, parsed
from eitbench.methods.problem import AccessRecord, SamplesRead
from eitbench.methods.weights.weight_files import packaged_weights
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import Contents, contents
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.suites.scenario import Scenario, SimulatedScenario
from eitbench.scenarios.suites.suite import learned_from, scenarios

NAN = float("nan")


_REPORTING = "the report of its prior knowledge"


@dataclass(frozen=True)
class Training:
    """The training behind the weights that a method loads, see `Method.trained_on`."""

    scenario: str
    train_data: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}\z")]
    train_samples: Annotated[int, Field(ge=1, le=10**9)]
    seed: Annotated[str, StringConstraints(pattern=r"^[0-9]{0,20}\z")] = ""
    unlimited: bool = False


UNKNOWN = Training("", "", 0)
"""Of weights whose `trained_on` says something that cannot be."""


@dataclass(frozen=True)
class _SamplesRead:
    split: Literal["train", "validation"]
    scenario: str
    data_hash: str
    samples: Annotated[int, Field(ge=0)]
    contents: InstanceOf[np.ndarray]


@dataclass(frozen=True)
class _Access:
    model: bool
    gain: bool
    conductivity_range: bool
    samples: list[_SamplesRead]


@dataclass(frozen=True)
class _Report:
    access: _Access
    trained_on: dict[str, Any]


class _Real(TypedDict):
    """Numbers of real presses that a method of places has read."""

    real: dict[Literal["labelled", "unlabelled", "other-skin"], Annotated[int, Field(ge=0)]]


_REPORT, _TRAINING, _REAL = TypeAdapter(_Report), TypeAdapter(Training), TypeAdapter(_Real)


def read_report(value: object) -> tuple[AccessRecord, Training | None]:
    """Return a method's record of access, and the training of the weights that it loads, if any.

    Raises:
        WorkerLostError: `value` is no answer of `MethodService.prior_knowledge`.
    """
    report: _Report = parsed(_REPORT, value, _REPORTING)
    for given in report.access.samples:
        array_in(given.contents, np.uint64, (given.samples,), _REPORTING)
    samples = tuple(SamplesRead(**vars(given)) for given in report.access.samples)
    access = AccessRecord(**{**vars(report.access), "samples": samples})
    if not report.trained_on:
        return access, None
    try:
        return access, _TRAINING.validate_python(report.trained_on)
    except ValidationError:
        return access, UNKNOWN


def prior_knowledge_columns(
    access: AccessRecord,
    training: Training | None,
    scenario: Scenario,
    familiar: Scenario,
    test: Dataset,
    *,
    spent: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the prior knowledge of a method, as columns of its cell.

    `prior_knowledge` is JSON: true if it read the `model` with its contact impedance, the `gain`
    and the `conductivity_range`; `given`, the samples it learned from; `trained_on`, the data
    behind its weights; `tuned`, the cost of selecting its parameters; `noise`, the sources among
    these that show the noise level of the test split; `families`, "same" where it learned from the
    families of all test phantoms, else "other", None where it learned from none or they are not
    known. `overlap` is the number of test samples among
    those it learned from, NaN where the data behind its weights are not known here.

    Args:
        access: its record of access to the problem.
        training: that of the weights that it loads; None if it loads none.
        scenario, test: the test data.
        familiar: the scenario whose data it was given and tuned on, see `Suite.familiar`.
        spent: cost of selecting its parameters on validation data; empty without a selection.
    """
    learned = [given.contents for given in access.samples]
    noise = [
        given.split for given in access.samples if _has_test_noise(scenario, familiar, given.split)
    ]
    source, shown_in_training = None, None
    if training is not None:
        source = _source(training, scenario)
        shown_in_training = _shown(training, source)
        if shown_in_training is not None:
            learned.append(shown_in_training)
    if spent and _has_test_noise(scenario, validation_scenario(familiar), "validation"):
        noise.append("tuning")
    shown = contents(test.phantoms, test.voltages)
    overlap = float(np.isin(shown, np.concatenate(learned)).sum()) if learned else 0.0
    knowledge = {
        "model": access.model,
        "gain": access.gain,
        "conductivity_range": access.conductivity_range,
        "given": [
            {name: getattr(given, name) for name in ("split", "scenario", "samples", "data_hash")}
            for given in access.samples
        ],
        "trained_on": {name: str(said) for name, said in vars(training).items()}
        if training is not None
        else {},
        "tuned": dict(spent),
        "noise": noise,
        "families": _families(access, source, scenario, familiar),
    }
    known = training is None or shown_in_training is not None
    return {
        "prior_knowledge": json.dumps(knowledge),
        "overlap": overlap if known or overlap else NAN,
    }


def place_knowledge(value: object, *, spent: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a method of places knew of a skin, as columns of its cell.

    `prior_knowledge` has what `prior_knowledge_columns` says; `given` counts the simulated
    presses, split "train", and the real ones: "labelled", "unlabelled" and "other-skin". No press
    that is located is among them, so that `overlap` is 0.

    Args:
        value: answer of `PlaceService.prior_knowledge`.
        spent: as for `prior_knowledge_columns`.

    Raises:
        WorkerLostError: `value` is no such answer.
    """
    access, training = read_report(value)
    real = parsed(_REAL, value, _REPORTING)["real"]
    given = {of.split: of.samples for of in access.samples} | real
    knowledge = {
        "model": access.model,
        "gain": access.gain,
        "conductivity_range": access.conductivity_range,
        "given": [{"split": split, "samples": count} for split, count in given.items()],
        "trained_on": {} if training is None else {k: str(v) for k, v in vars(training).items()},
        "tuned": dict(spent),
        "noise": [],
        "families": None,
    }
    return {"prior_knowledge": json.dumps(knowledge), "overlap": 0.0}


def contents_file(data_hash: str, count: int) -> str:
    """Return the name of the file of the contents of `count` training samples."""
    return f"contents-{data_hash[:16]}-{count}.npy"


def training_contents(scenario: SimulatedScenario, count: int, data_hash: str) -> Contents:
    """Return the contents of the first `count` training samples: packaged, or computed once."""
    if (stored := _stored_contents(data_hash, count)) is not None:
        return stored
    drawn = tuple(phantom(scenario, "train", sample) for sample in range(count))
    found: Contents = np.sort(contents(drawn, None))
    buffer = BytesIO()
    np.save(buffer, found)
    with suppress(OSError):  # the next run would only have to do it again
        atomic_write(_cached_contents(data_hash, count), buffer.getvalue())
    return found


def _cached_contents(data_hash: str, count: int) -> Path:
    return cache_dir() / "contents" / contents_file(data_hash, count)


def _stored_contents(data_hash: str, count: int) -> Contents | None:
    """Contents that are packaged, or that an earlier run computed, of this or another suite."""
    packaged = packaged_weights() / contents_file(data_hash, count)
    for path in (packaged, _cached_contents(data_hash, count)):
        with suppress(OSError, ValueError, EOFError):  # one that is damaged is made again
            found: Contents = np.load(path, allow_pickle=False)
            if found.shape == (count,) and found.dtype == np.uint64:
                return found
    return None


def _source(training: Training, scenario: Scenario) -> SimulatedScenario | None:
    """Return the scenario that weights were trained on, if it is packaged or that of the run.

    Beside the weights that are shipped lie the contents of their training data, so that these stay
    known when a later generator gives the data of the same phantoms another hash.
    """
    named = scenarios().get(training.scenario)
    shipped = contents_file(training.train_data, training.train_samples)
    if isinstance(named, SimulatedScenario) and (packaged_weights() / shipped).is_file():
        return named
    for source in (named, scenario, learned_from(scenario)):
        if (
            isinstance(source, SimulatedScenario)
            and training.train_samples <= source.train
            and source.data_hash("train") == training.train_data
        ):
            return source
    return None


def _shown(training: Training, source: SimulatedScenario | None) -> Contents | None:
    """Return the contents of the training data behind weights; None if they are not known here."""
    if source is None:
        return _stored_contents(training.train_data, training.train_samples)
    return training_contents(source, training.train_samples, training.train_data)


def stated_overlap(trained_on: Mapping[str, Any], scenario: Scenario, test: Dataset) -> float:
    """Return the number of test samples among the training data that weights state.

    NaN where these are not known here, or none are stated.

    Args:
        trained_on: as in `prior_knowledge_columns`.
        scenario, test: the test data.
    """
    try:
        said = {name: trained_on[name] for name in ("scenario", "train_data")}
        training = _TRAINING.validate_python(
            said | {"train_samples": int(trained_on["train_samples"])}
        )
    except (KeyError, TypeError, ValueError):
        return NAN
    shown = _shown(training, _source(training, scenario))
    if shown is None:
        return NAN
    return float(np.isin(contents(test.phantoms, test.voltages), shown).sum())


def _families(
    access: AccessRecord,
    source: SimulatedScenario | None,
    scenario: Scenario,
    familiar: Scenario,
) -> Literal["same", "other"] | None:
    """Compare the families of phantoms that a method learned from with those of the test split."""
    if not isinstance(scenario, SimulatedScenario):
        return None
    origins = [source] if source is not None else []
    given = any(of.split == "train" for of in access.samples)
    if given and isinstance(familiar, SimulatedScenario):
        origins.append(familiar)
    learned = [family for origin in origins for family in origin.split_families("train")]
    if not learned:
        return None
    tested = scenario.split_families("test")
    return "same" if all(any(one.covers(of) for one in learned) for of in tested) else "other"


def _has_test_noise(scenario: Scenario, familiar: Scenario, split: str) -> bool:
    """True if data of a `split` of the `familiar` scenario show the noise of the test split."""
    if isinstance(scenario, SimulatedScenario) and isinstance(familiar, SimulatedScenario):
        return bool(getattr(familiar.noise, split) == scenario.noise.test)
    return split == "validation"  # the same board; what is learned of it is simulated
