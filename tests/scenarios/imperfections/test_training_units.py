"""Units that training data are of: drawn around the nominal sensor, and of no other split."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.imperfections.faults import dead_electrodes
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.imperfections.training_units import TrainingImperfections
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

PATTERN = sensor("foam16").pattern
NOMINAL = SimulatedScenario(
    name="units", image_shape=(12, 12), families=("circle",), train=12, validation=6, test=6
)
UNITS = TrainingImperfections(electrode_shift_m=0.001, drift=0.01, gain=0.01, dead_share=0.5)
RANDOMISED = NOMINAL.model_copy(update={"training_imperfections": UNITS})


def test_severities_and_faults_are_drawn_as_declared() -> None:
    declared = TrainingImperfections(severity=1.5, gain=0.01, dead_share=0.3, saturated_share=0.1)
    units = [declared.of_session(k, PATTERN) for k in range(4000)]
    severity = np.array([unit.severity for unit in units])
    assert 0 <= severity.min() < 0.01
    assert 2.99 < severity.max() <= 3
    assert severity.mean() == pytest.approx(1.5, abs=0.05)
    dead = np.array([len(unit.dead) for unit in units])
    assert np.mean(dead > 0) == pytest.approx(0.3, abs=0.03)
    assert np.mean(dead == 2) == pytest.approx(0.1, abs=0.02)
    found = [k for unit in units for k in unit.dead]
    assert set(found) == set(range(16))
    assert all(len(set(unit.dead)) == len(unit.dead) for unit in units)
    saturated = [unit.saturated for unit in units if unit.saturated is not None]
    assert len(saturated) == pytest.approx(400, abs=60)
    assert set(saturated) == set(range(16))
    assert declared.of_session(7, PATTERN) == units[7]


def test_no_unit_is_in_two_splits() -> None:
    first, last = 0, 10**9 // 2 - 1
    drawn = {
        split: {
            scenario.split_imperfections(split, session).unit
            for unit in (first, last)
            for scenario in (
                RANDOMISED.model_copy(
                    update={
                        "imperfections": Imperfections(unit=unit, drift=0.01),
                        "training_imperfections": TrainingImperfections(unit=unit),
                    }
                ),
            )
            for session in range(3000)
        }
        for split in ("train", "validation", "test")
    }
    assert not drawn["train"] & (drawn["validation"] | drawn["test"])
    assert not drawn["validation"] & drawn["test"]
    with pytest.raises(ValidationError):
        Imperfections(unit=10**9)


def test_training_data_are_of_units_with_faults_and_all_else_is_as_it_was() -> None:
    for split in ("validation", "test"):
        assert RANDOMISED.data_hash(split) == NOMINAL.data_hash(split)
        found, expected = load(RANDOMISED, split), load(NOMINAL, split)
        np.testing.assert_array_equal(found.voltages, expected.voltages)
    assert RANDOMISED.data_hash("train") != NOMINAL.data_hash("train")
    seen, nominal = load(RANDOMISED, "train"), load(NOMINAL, "train")
    assert seen.phantoms == nominal.phantoms
    assert len(np.unique(seen.references, axis=0)) == len(seen) / TOUCHES
    modelled = nominal.references[0]
    for k in range(0, len(seen), TOUCHES):
        unit = RANDOMISED.split_imperfections("train", k // TOUCHES)
        dead = dead_electrodes(seen.references[k], modelled, RANDOMISED.nominal_sensor.pattern)
        assert set(np.flatnonzero(dead).tolist()) == set(unit.dead)
        size = np.abs(seen.references[k] / modelled - 1)[~_spoiled(unit.dead)]
        assert 0 < np.median(size) < 0.2
    few = load(RANDOMISED, "train", 4)
    np.testing.assert_array_equal(few.voltages, seen.voltages[:4])


def _spoiled(dead: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.asarray(np.isin(RANDOMISED.nominal_sensor.pattern.table, dead).any(axis=1))


@pytest.mark.parametrize(
    "changed",
    [
        {"drift": 0.02},
        {"gain": 0.02},
        {"dead_share": 0.4},
        {"saturated_share": 0.1},
        {"severity": 0.5},
        {"unit": 5},
    ],
)
def test_every_declared_parameter_changes_the_hash_of_training_data(
    changed: dict[str, float],
) -> None:
    other = RANDOMISED.model_copy(
        update={"training_imperfections": UNITS.model_copy(update=changed)}
    )
    assert other.data_hash("train") != RANDOMISED.data_hash("train")
    assert other.data_hash("test") == RANDOMISED.data_hash("test")


def test_scenarios_without_such_units_keep_their_hashes() -> None:
    """Those of generator 2, before units of training data could be declared."""
    known = {
        "paper": "9d8c70e579770bf554e5dbf94ecf9b685e526c4f3805fd05b3bae215c8722825",
        "presses": "eac4cc0565d7db3168dd1fd23ec11a3590a937a5e45b844159a100b532416de6",
        "sim2real-gain": "d25a2a9432b0df75e80bb27155657c53ddcbd3f25e26a2bb37e3e77209719652",
    }
    for name, train_data in known.items():
        assert scenario_by_name(name).data_hash("train") == train_data


@pytest.mark.parametrize(("count", "refused"), [(4, True), (5, True), (6, True), (7, False)])
def test_units_that_would_measure_nothing_are_refused(
    tmp_path: Path, count: int, refused: bool
) -> None:
    """Values of neighbours have four electrodes: of 7 some have neither of any two."""
    text = f"""name = "few"
[outline]
polygon_mm = [[0, 0], [100, 0], [100, 100], [0, 100]]
[electrodes]
count = {count}
width_mm = [10]
contact_impedance = [1e-3]
[pattern]
offset = 1
"""
    (tmp_path / "few.toml").write_text(text)
    fields = NOMINAL.model_dump() | {
        "sensor": str(tmp_path / "few.toml"), "training_imperfections": {"dead_share": 0.5},
    }  # fmt: skip
    sentence = pytest.raises(ValidationError, match="`dead_share` may draw two electrodes")
    with sentence if refused else nullcontext():
        SimulatedScenario.model_validate(fields)


@pytest.mark.parametrize(
    ("declared", "sentence"),
    [
        ({"dead_share": 1.5}, "less than or equal to 1"),
        ({"saturated_share": -0.1}, "greater than or equal to 0"),
        ({"dead": [16]}, "`dead` names one of the electrodes 0 to 15"),
        ({"saturated": 16}, "`saturated` names one of the channels 0 to 15"),
        ({"dead": [3], "dead_share": 0.2}, "the same in all units .* or drawn for each"),
        ({"saturated": 0, "saturated_share": 0.2}, "the same in all units .* or drawn for each"),
    ],
)
def test_impossible_units_are_refused(declared: dict[str, object], sentence: str) -> None:
    fields = NOMINAL.model_dump() | {"training_imperfections": declared}
    with pytest.raises(ValidationError, match=sentence):
        SimulatedScenario.model_validate(fields)
