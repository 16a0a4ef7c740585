"""One gain a measurement from the reference frame: on a board with known gains, and a real skin."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.methods import Problem, create
from eitbench.methods.classical.normalised_noser import gains_of_reference
from eitbench.methods.training.samples import no_split
from eitbench.scenarios import sensor
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity

Array = NDArray[np.float64]
SENSOR = replace(sensor("foam16"), image_shape=(32, 32))
MODEL = forward_model(SENSOR)
FRAME = MODEL.voltages(MODEL.background)


def images(method: str, gains: Array, **parameters: float) -> Array:
    """Changes (n, H, W) that a method finds where a board has `gains` (M,)."""
    rng = np.random.default_rng(0)
    true = np.zeros((6, *SENSOR.image_shape))
    for image, (row, column) in zip(true, rng.integers(8, 22, (6, 2)), strict=True):
        image[row : row + 4, column : column + 4] = -0.1 * SENSOR.background
    changes = np.einsum("mhw,nhw->nm", MODEL.jacobian(MODEL.background), true)
    problem = Problem(SENSOR, gains * FRAME, no_split)
    fitted = create(method, **parameters)
    fitted.fit(problem)
    return np.asarray(fitted.reconstruct(gains * (FRAME + changes)) - problem.background)


def test_known_gains_are_found_and_leave_the_images_as_they_were() -> None:
    gains = np.exp(0.5 * np.random.default_rng(1).standard_normal(len(FRAME)))
    found = gains_of_reference(Problem(SENSOR, gains * FRAME, no_split))
    np.testing.assert_allclose(found, gains / np.median(gains), rtol=1e-6)
    # Next to no regularisation: gains and noise weights cancel where there is no noise.
    none = images("normalised-noser", np.ones_like(gains), weight=1e-6)
    own = images("normalised-noser", gains, weight=1e-6)
    plain = images("noser", gains, weight=1e-6)
    size = np.linalg.norm(none)
    assert np.linalg.norm(own - none) < 0.2 * size
    assert np.linalg.norm(plain - none) > size


def test_without_gains_it_is_noser() -> None:
    ones = np.ones(len(FRAME))
    np.testing.assert_allclose(
        images("normalised-noser", ones, weight=0.1, exponent=0.5),
        images("noser", ones, weight=0.1),
        atol=1e-9,
    )


def test_a_measurement_near_zero_has_no_unbounded_gain() -> None:
    factors = np.ones(len(FRAME))
    factors[3], factors[5] = 0.0, 100.0
    gains = gains_of_reference(Problem(SENSOR, factors * FRAME, no_split))
    assert (gains[3], gains[5]) == (pytest.approx(0.1), pytest.approx(10.0))


@pytest.mark.parametrize(("recording", "least"), [("ohmc16", 0.8), ("superpose500", 0.7)])
def test_presses_of_a_real_skin_are_found_nearer(
    recording: str, least: float, recorded_data: Path
) -> None:
    """Registered on validation presses, with one weight for both methods; test presses judge."""
    frames = read_recording(recording)
    skin = replace(sensor(recording), image_shape=(32, 32))
    places = frames.samples[["x_m", "y_m"]].to_numpy()
    known = (frames.samples["split"] == "validation").to_numpy()
    problem = Problem(skin, frames.reference, no_split)
    error = {}
    for name in ("noser", "normalised-noser"):
        method = create(name, weight=3.0)
        method.fit(problem)
        found = locate(np.asarray(method.reconstruct(frames.voltages)) - skin.background, skin)
        register = fit_similarity(found[known], places[known])
        assert register is not None
        error[name] = float(np.nanmedian(np.hypot(*(register(found) - places)[~known].T)))
    assert error["normalised-noser"] < least * error["noser"]
