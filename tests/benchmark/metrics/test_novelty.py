"""Figures of novelty: the area under the ROC curve, and the residual of the exact model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from eitbench.benchmark.metrics.novelty import (
    FALSE_ALARMS,
    auroc_and_caught,
    frame_scores,
    residuals,
)
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.phantoms.families import DeclaredFamily
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise

DISC = DeclaredFamily(name="disc", shape="circle", sizes={"radius": (0.1, 0.2)})
SCENARIO = SimulatedScenario(
    name="r", image_shape=(20, 20), families=(DISC,), train=0, validation=0, test=4
)


def scores(n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    novel = rng.random(n) < 0.4
    return np.round(rng.standard_normal(n) + novel, 1), novel  # with ties


def test_auroc_is_the_statistic_of_mann_and_whitney() -> None:
    values, novel = scores()
    auroc, _ = auroc_and_caught(np.ones((1, 60)), values, novel)[0]
    u = stats.mannwhitneyu(values[novel], values[~novel]).statistic
    assert auroc == pytest.approx(u / (novel.sum() * (~novel).sum()))
    pairs = np.sign(values[novel][:, None] - values[~novel])
    assert auroc == pytest.approx((pairs.mean() + 1) / 2)


def test_a_draw_counts_frames_as_often_as_they_are_drawn() -> None:
    values, novel = scores()
    counts = np.random.default_rng(6).integers(0, 4, size=(20, 60)).astype(float)
    found = auroc_and_caught(counts, values, novel)
    for of, (auroc, caught) in zip(counts, found, strict=True):
        rows = np.repeat(np.arange(60), of.astype(int))
        v, is_novel = values[rows], novel[rows]
        u = stats.mannwhitneyu(v[is_novel], v[~is_novel]).statistic
        assert auroc == pytest.approx(u / (is_novel.sum() * (~is_novel).sum()))
        familiar = np.sort(v[~is_novel])
        limit = familiar[int(np.ceil((1 - FALSE_ALARMS) * len(familiar) - 1e-9)) - 1]
        assert (familiar > limit).mean() <= FALSE_ALARMS
        assert caught == pytest.approx((v[is_novel] > limit).mean())


def test_frames_without_an_answer_are_the_most_novel_ones() -> None:
    novel = np.arange(40) >= 20
    values = np.ones(40)
    assert auroc_and_caught(np.ones((1, 40)), values, novel)[0] == pytest.approx([0.5, 0.0])
    values[novel] = np.nan
    assert auroc_and_caught(np.ones((1, 40)), values, novel)[0] == pytest.approx([1.0, 1.0])
    values = np.where(novel, 1.0, np.nan)  # it refuses what it should know
    assert auroc_and_caught(np.ones((1, 40)), values, novel)[0] == pytest.approx([0.0, 0.0])


def known(data: Dataset) -> np.ndarray:
    assert data.conductivity is not None
    return np.array(data.conductivity)


def test_the_true_image_leaves_no_residual_of_frames_of_the_model() -> None:
    data = load(SCENARIO, "test")
    found = residuals(data, known(data).astype(np.float64))
    assert max(found["residual"]) < 1e-12
    assert max(found["relative_residual"]) < 1e-9


def test_the_untouched_image_leaves_all_of_the_touch() -> None:
    data = load(SCENARIO, "test")
    found = residuals(data, np.ones_like(known(data)))
    touch = np.linalg.norm(data.voltages - data.references, axis=1)
    np.testing.assert_allclose(found["relative_residual"], 1, rtol=1e-9)
    size = np.linalg.norm(data.references, axis=1)
    np.testing.assert_allclose(found["residual"], touch / size, rtol=1e-9)


def test_residuals_do_not_depend_on_the_units_of_a_board() -> None:
    data = load(SCENARIO.model_copy(update={"noise": SplitNoise(test=40.0)}), "test")
    scaled = replace(data, voltages=1e3 * data.voltages, references=1e3 * data.references)
    image = known(data)
    for name, values in residuals(data, image).items():
        np.testing.assert_allclose(residuals(scaled, image)[name], values, rtol=1e-9)
        assert (values > 0).all()


def test_what_is_out_of_range_counts_as_its_end_whatever_the_background() -> None:
    data = load(SCENARIO, "test")
    grey = replace(data, sensor=replace(data.sensor, background=0.4))
    low, high = grey.sensor.conductivity_range
    model = forward_model(grey.sensor)
    untouched = model.voltages(model.background)
    for beyond, limit in ((10.0, high), (-3.0, low), (0.0, low)):
        image, within = np.float32(0.4) * known(data), 0.4 * known(data).astype(np.float64)
        image[:, 5:9, 5:9], within[:, 5:9, 5:9] = beyond, 0.4 * limit
        found = residuals(grey, image)["residual"]
        for n, reference in enumerate(grey.references):
            gain = reference @ untouched / (untouched @ untouched)
            explained = reference + gain * (model.voltages(within[n]) - untouched)
            right = np.linalg.norm(grey.voltages[n] - explained) / np.linalg.norm(reference)
            assert found[n] == pytest.approx(right, rel=1e-5)  # float32


def test_an_image_that_is_not_finite_or_not_positive_is_no_error() -> None:
    data = load(SCENARIO, "test")
    images = known(data)
    images[0], images[1] = np.nan, -3.0
    found = residuals(data, images)["residual"]
    assert np.isnan(found[0])
    assert np.isfinite(found[1:]).all()


def numbers(data: Dataset) -> np.ndarray:
    """The three numbers of frames, of which one reference is 2 % off the model in every second."""
    model = forward_model(data.sensor)
    untouched = model.voltages(model.background)
    rows = []
    for frame, reference in zip(data.voltages, data.references, strict=True):
        change = frame - reference
        gain = reference @ untouched / (untouched @ untouched)
        rows.append(
            (
                np.log(np.linalg.norm(change) / np.linalg.norm(reference)),
                change @ reference / np.linalg.norm(change) / np.linalg.norm(reference),
                np.log(np.linalg.norm(reference / gain - untouched) / np.linalg.norm(untouched)),
            )
        )
    return np.array(rows)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_frame_is_as_novel_as_its_most_unusual_number(number: int) -> None:
    """A touch that is far stronger, one the other way round, and a reference of another sensor."""
    noisy = SCENARIO.model_copy(update={"noise": SplitNoise(test=50.0), "test": 12})
    familiar = load(noisy, "test")
    change, reference = familiar.voltages - familiar.references, familiar.references
    if number == 0:
        change = 40 * change
    elif number == 1:
        change = -change
    else:
        rng = np.random.default_rng(4)
        reference = reference * (1 + 0.5 * rng.random(reference.shape))
    novel = replace(familiar, voltages=reference + change, references=reference)
    usual = numbers(familiar)
    apart = np.abs(numbers(novel) - usual.mean(axis=0)) / np.maximum(usual.std(axis=0), 0.01)
    assert (apart.argmax(axis=1) == number).mean() > 0.9
    np.testing.assert_allclose(frame_scores(novel, familiar), apart.max(axis=1), rtol=1e-6)


def test_frames_that_share_a_reference_do_not_make_it_certain() -> None:
    noisy = SCENARIO.model_copy(update={"noise": SplitNoise(test=50.0), "test": 3})
    familiar = load(noisy, "test")  # a session of one reference
    assert np.ptp(familiar.references, axis=0).max() == 0
    other = replace(familiar, references=familiar.references * 1.01)
    assert np.isfinite(frame_scores(other, familiar)).all()
    usual = numbers(familiar)
    assert usual.std(axis=0)[2] < 1e-12
    off = 0.01 * familiar.references * np.cos(np.arange(familiar.references.shape[1]))
    moved = replace(
        familiar, voltages=familiar.voltages + off, references=familiar.references + off
    )
    apart = np.abs(numbers(moved) - usual.mean(axis=0)) / np.maximum(usual.std(axis=0), 0.01)
    np.testing.assert_allclose(frame_scores(moved, familiar), apart.max(axis=1), rtol=1e-6)
