"""The safeguard: the exact model decides between learned images and those of NOSER."""

import numpy as np
import pytest
from tests.support.small_sensors import clean_problem, foam

from eitbench.methods import Problem, create
from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.safeguard import REGULARISATION, Safeguard
from eitbench.methods.problem import no_split
from eitbench.scenarios import load, sensor
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.suites.suite import load_suite

SAFEGUARDED = ("coarse-to-fine", "latent-flow")


def frames(problem: Problem) -> tuple[Images, Array]:
    """Images (3, H, W), over the background, of touches, and noisy differences (3, M)."""
    images = np.ones((3, *problem.mask.shape), np.float32)
    for k, depth in enumerate((0.2, 0.4, 0.6)):
        images[k, 3:7, 2 + 2 * k : 6 + 2 * k] -= depth
    voltages = problem.model.voltages(images.astype(np.float64) * problem.background)
    noisy = add_noise(voltages, 50.0, np.random.default_rng(0))
    return images, noisy - problem.background_voltages


def noser(problem: Problem, difference: Array) -> Array:
    method = Noser(REGULARISATION, "clausius-mossotti")
    method.fit(problem)
    return np.asarray(method.of_difference(difference) / problem.background)


def misfit(problem: Problem, image: Array, difference: Array) -> float:
    voltages = problem.model.voltages(image * problem.background)
    return float(np.linalg.norm(difference - (voltages - problem.background_voltages)))


def test_what_explains_a_frame_worse_gives_way_to_noser_frame_by_frame() -> None:
    problem = clean_problem(foam((12, 14)))
    true, difference = frames(problem)
    learned = np.stack([true[0], true[0], true[2]])  # the second is the first one's
    taken = Safeguard(problem)(learned, difference)
    np.testing.assert_array_equal(taken[[0, 2]], learned[[0, 2]])
    np.testing.assert_allclose(taken[1], noser(problem, difference)[1], rtol=1e-6)


def test_novelty_is_the_ratio_of_the_misfits() -> None:
    problem = clean_problem(foam((12, 14)))
    true, difference = frames(problem)
    found = Safeguard(problem).novelty(true[::-1], difference)
    classical = noser(problem, difference)
    for k in range(3):
        worse = misfit(problem, true[2 - k].astype(np.float64), difference[k])
        first = misfit(problem, classical[k].astype(np.float32).astype(np.float64), difference[k])
        assert found[k] == pytest.approx(worse / first, rel=1e-6)
    assert found[1] < 1 < found[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", SAFEGUARDED)
def test_learned_images_are_kept_on_touches_like_those_learned_from(name: str) -> None:
    (scenario,) = (s for s in load_suite("noise").scenarios if s.name == "noise-40db")
    data = load(scenario, "validation", 40)
    problem = Problem(scenario.nominal_sensor, data.references[0], no_split)
    guarded, alone = (create(name, safeguard=of) for of in (True, False))
    for method in (guarded, alone):
        method.fit(problem)
    images = guarded.reconstruct(data.voltages)
    np.testing.assert_array_equal(images, alone.reconstruct(data.voltages))
    assert guarded.novelty(data.voltages).max() < 1


@pytest.mark.slow
@pytest.mark.parametrize("name", SAFEGUARDED)
@pytest.mark.usefixtures("recorded_data")
def test_images_of_a_real_skin_are_those_of_noser(name: str) -> None:
    presses, skin = read_recording("ohmc16").without_test(), sensor("ohmc16")
    problem = Problem(skin, presses.reference, no_split)
    method = create(name, gain_power=1.0)
    method.fit(problem)
    voltages = presses.voltages[:40]
    images = method.reconstruct(voltages) / skin.background
    classical = noser(problem, problem.difference(voltages, 1.0))
    low, high = skin.conductivity_range
    same = np.abs(images - classical.clip(low, high)).max(axis=(1, 2)) < 1e-6
    np.testing.assert_array_equal(same, method.novelty(voltages) > 1)
    assert same.mean() > 0.8
    if name == "latent-flow":  # its draws are about the image, but for the 40th
        mean = method.uncertainty(voltages).mean(axis=1) / skin.background
        spread = method.uncertainty(voltages).std(axis=1).max() / skin.background
        assert np.abs(mean - classical)[same].max() < 0.2 * spread
