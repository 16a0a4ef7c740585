"""`dnn` with the errors that it made on validation samples."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.workers.method_service import learning_splits
from eitbench.methods import Problem, create
from eitbench.methods.learned import conformal
from eitbench.methods.learned.conformal import DnnConformal, widening
from eitbench.scenarios import InputError, load
from eitbench.scenarios.suites.suite import scenario_by_name


def test_errors_are_widened_to_the_share_that_is_asked_for() -> None:
    """Frames of normal errors of which each has a width of its own, about 1.5 times as stated."""
    rng = np.random.default_rng(8)
    widths = rng.uniform(1.3, 1.7, (400, 1))
    errors = widths * rng.standard_normal((400, 500))
    end = np.full(errors.shape, 1.96)
    factor = widening(errors, -end, end, 0.01)
    assert factor == pytest.approx(1.5, abs=0.1)
    assert np.mean(np.abs(errors) < factor * end) == pytest.approx(0.95, abs=0.01)
    assert widening(errors / 10, -end, end, 0.01) == 1
    more, ends = (np.append(values, 0 * values, axis=1) for values in (errors, end))
    assert widening(more, -ends, ends, 0.01) == factor  # pixels without an error do not count


def test_pixels_that_count_only_once_they_are_widened_do_not_widen_further() -> None:
    """A sixth of the pixels err nine times as far as stated, and span enough once widened."""
    rng = np.random.default_rng(8)
    errors = 1.5 * rng.standard_normal((400, 500))
    end = np.full(errors.shape, 1.96)
    alone = widening(errors, -end, end, 0.01)
    errors = np.append(errors, np.full((400, 100), 0.0088), axis=1)
    end = np.append(end, np.full((400, 100), 0.001), axis=1)
    assert widening(errors, -end, end, 0.01) == alone == pytest.approx(1.5, abs=0.1)


def test_its_images_are_those_of_dnn_with_the_same_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(conformal, "FRAMES", 24)
    monkeypatch.setattr(conformal, "HELD_OUT", 12)
    scenario = scenario_by_name("quick")
    test = load(scenario, "validation", 2)
    problem = Problem(test.sensor, test.references[0], partial(load, scenario))
    parameters = {"gain_power": 0.5, "amplification": 2.0}
    images = []
    for name in ("dnn", "dnn-conformal"):
        method = create(name, **parameters)
        method.fit(problem)
        images.append(method.reconstruct(test.voltages))
    assert np.array_equal(images[0], images[1])


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["noise-50db", "noise-30db"])
def test_intervals_hold_what_they_promise_on_test_frames(scenario: str) -> None:
    """Pixels of contacts and of their surroundings; two binomial errors of 48 frames are 6 %."""
    test = load(scenario, "test", 48)
    problem = Problem(test.sensor, test.references[0], lambda s, limit: load(scenario, s, limit))
    method = DnnConformal()
    method.fit(problem)
    shares, half = [], []
    assert test.conductivity is not None
    for k in range(len(test)):
        problem.reference = test.references[k]
        (draws,) = method.uncertainty(test.voltages[k : k + 1])
        truth, drawn = test.conductivity[k], np.sort(draws, axis=0)
        counted = np.maximum(drawn[-1], truth) - np.minimum(drawn[0], truth) > 0.01
        shares.append(((drawn[0] <= truth) & (truth <= drawn[-1]))[counted].mean())
        half.append(((drawn[9] <= truth) & (truth <= drawn[29]))[counted].mean())
    assert np.mean(shares) == pytest.approx(0.95, abs=0.04)
    assert np.mean(half) == pytest.approx(0.5, abs=0.1)


def test_a_set_up_that_fails_leaves_the_reference_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    def few(*_: object) -> None:
        raise InputError("too few")

    monkeypatch.setattr(conformal, "FrameNovelty", few)
    monkeypatch.setattr(conformal, "FRAMES", 8)
    monkeypatch.setattr(conformal, "HELD_OUT", 4)
    scenario = scenario_by_name("quick")
    data = load(scenario, "validation", 12)
    problem = Problem(data.sensor, data.references[0], partial(load, scenario))
    before = problem.reference.copy()
    with pytest.raises(InputError, match="too few"):
        create("dnn-conformal").fit(problem)
    assert np.array_equal(problem.reference, before)


@pytest.mark.slow
def test_on_a_recorded_skin_errors_are_those_of_simulated_presses(recorded_data: Path) -> None:
    skin = scenario_by_name("ohmc16")
    test = load(skin, "test", 2)
    problem = Problem(test.sensor, test.references[0], partial(learning_splits, skin))
    method = create("dnn-conformal")
    method.fit(problem)
    assert [read.split for read in problem.access_record().samples] == ["validation", "train"]
    assert 0.0 < method.uncertainty(test.voltages)[:, :, test.sensor.mask].std(axis=1).max() < 1.0
