"""What trained methods state of their uncertainty, on test frames of `noise` at 50 dB."""

import numpy as np
import pytest

from eitbench.methods import Problem, create
from eitbench.methods.method import DRAWS
from eitbench.scenarios import load
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.phantoms.contacts import locate


@pytest.fixture(scope="module")
def test_frames() -> tuple[Dataset, Problem]:
    data = load("noise-50db", "test", 24)
    return data, Problem(
        data.sensor, data.references[0], lambda s, limit: load("noise-50db", s, limit)
    )


@pytest.mark.slow
def test_deviations_are_those_of_the_image_of_dnn(test_frames: tuple[Dataset, Problem]) -> None:
    data, problem = test_frames
    method, dnn = create("dnn-heteroscedastic"), create("dnn")
    method.fit(problem)
    dnn.fit(problem)
    squares, ratios = [], []
    assert data.conductivity is not None
    for k in range(len(data)):
        problem.reference, frame = data.references[k], data.voltages[k : k + 1]
        (image,), (deviation,) = method.reconstruct(frame), method.uncertainty(frame)
        np.testing.assert_allclose(image, dnn.reconstruct(frame)[0], atol=1e-6)
        error = np.abs(image - data.conductivity[k])
        squares.append(error.mean() / deviation.mean())
        unsure = deviation > np.quantile(deviation, 0.9)
        ratios.append(error[unsure].mean() / error[~unsure].mean())
    # A normal error is 0.8 deviations large; tails are longer.
    assert 0.4 < np.mean(squares) < 1.2
    assert np.median(ratios) > 5


@pytest.mark.slow
def test_the_flow_knows_how_sure_places_are(test_frames: tuple[Dataset, Problem]) -> None:
    """Of 24 places, all but a few lie among those drawn; NOSER's draws show none."""
    data, problem = test_frames
    method = create("latent-flow")
    method.fit(problem)
    inside, radii = [], []
    assert data.conductivity is not None
    for k in range(len(data)):
        problem.reference, frame = data.references[k], data.voltages[k : k + 1]
        (draws,) = method.uncertainty(frame)
        assert draws.shape == (DRAWS, *data.sensor.image_shape)
        places = locate(draws - 1, data.sensor)
        (true,) = locate(data.conductivity[k : k + 1] - 1, data.sensor)
        distances = np.hypot(*(np.vstack([places, true]) - places.mean(axis=0)).T)
        inside.append((distances < distances[-1]).sum() < 38)
        radii.append(np.sort(distances[:-1])[37])
    assert np.mean(inside) > 0.8
    assert np.median(radii) < 0.015  # of a sensor of 0.1 m
