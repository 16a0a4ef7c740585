"""The PINN that goes on from the image of `dnn`."""

import numpy as np
import pytest
from tests.support.small_sensors import clean_problem, foam, touch

from eitbench.methods.learned.cnn_pinn import CnnPinn
from eitbench.methods.learned.image_networks import Dnn
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model


def test_it_begins_as_the_image_of_dnn() -> None:
    s = sensor("foam16")
    problem = clean_problem(s)
    frame = forward_model(s).voltages(touch(s))[None]
    first, refined = Dnn(), CnnPinn(steps=1)
    for method in (first, refined):
        method.fit(problem)
    image, found = (method.reconstruct(frame)[0] for method in (first, refined))
    assert image.min() < 0.6
    np.testing.assert_allclose(found, image, atol=1e-6)
    assert refined.train_s == first.train_s
    assert CnnPinn.weights_hash(s) == Dnn.weights_hash(s) != ""


@pytest.mark.slow
def test_a_clean_frame_is_explained_better_than_by_dnn() -> None:
    s = sensor("foam16")
    model, problem = forward_model(s), clean_problem(s)
    frame = model.voltages(touch(s))
    left = []
    for method in (Dnn(), CnnPinn(steps=60)):
        method.fit(problem)
        modelled = model.voltages(method.reconstruct(frame[None])[0])
        left.append(np.linalg.norm(modelled - frame))
    assert left[1] < 0.7 * left[0]


def test_it_needs_the_weights_of_dnn() -> None:
    s = foam()
    assert CnnPinn.unusable(s) == Dnn.unusable(s) != ""
    with pytest.raises(InputError, match="'dnn' has no weights for the sensor 'foam16'"):
        CnnPinn().fit(clean_problem(s))
    with pytest.raises(InputError, match="'cnn-pinn' needs at least 1 step"):
        CnnPinn(steps=0).fit(clean_problem(s))
