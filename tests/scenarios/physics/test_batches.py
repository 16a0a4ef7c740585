"""Several images at once: voltages and gradients as one by one, whatever is beside them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.elements import electrode_terms, stiffness
from eitbench.scenarios.physics.forward import ForwardModel, signed_voltages
from eitbench.scenarios.physics.mesh import triangle_mesh
from eitbench.scenarios.sensors.outlines import Disc, Outline, rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Array = NDArray[np.float64]


def on_pixels(outline: Outline, electrodes: int, shape: tuple[int, int]) -> ForwardModel:
    width = outline.perimeter / electrodes / 2
    ring = even_electrodes(outline, electrodes, width, 1e-3)
    pattern = offset_pattern(electrodes, 1)
    return ForwardModel(Sensor("small", outline, ring, pattern, image_shape=shape))


def on_triangles() -> ForwardModel:
    foam = replace(sensor("foam16"), image_shape=(12, 12))
    return ForwardModel(foam, triangle_mesh(foam))


def magnitudes() -> ForwardModel:
    foam = replace(sensor("foam16"), image_shape=(20, 20))
    return ForwardModel(replace(foam, pattern=replace(foam.pattern, magnitudes=True)))


MODELS: dict[str, Callable[[], ForwardModel]] = {
    "4 electrodes": lambda: on_pixels(rectangle(0.1, 0.1), 4, (9, 9)),
    "13 electrodes": lambda: on_pixels(rectangle(0.13, 0.06), 13, (12, 26)),
    "32 electrodes, round": lambda: on_pixels(Disc(0.05), 32, (24, 24)),
    "one part": lambda: on_pixels(rectangle(0.1, 0.1), 4, (4, 4)),
    "magnitudes": magnitudes,
    "triangles": on_triangles,
}


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> ForwardModel:
    return MODELS[request.param]()


def images(model: ForwardModel, count: int) -> Array:
    rough = np.random.default_rng(3).standard_normal((count, *model.sensor.image_shape))
    return np.exp(0.5 * rough)


def solved(model: ForwardModel, sigma: Array, weights: Array) -> tuple[Array, Array, Array]:
    voltages, fields = model.voltages_and_fields(sigma)
    return voltages, fields, model.pullback(fields, weights)


def test_an_image_in_a_batch_is_solved_as_on_its_own(model: ForwardModel) -> None:
    sigma = images(model, 11)
    weights = np.random.default_rng(4).standard_normal((11, model.sensor.n_measurements))
    together = solved(model, sigma, weights)
    assert np.array_equal(model.voltages(sigma), together[0])
    for k in range(len(sigma)):
        alone = solved(model, sigma[k : k + 1], weights[k : k + 1])
        for one, batch in zip(alone, together, strict=True):
            assert np.linalg.norm(batch[k] - one[0]) < 1e-11 * np.linalg.norm(one)


@pytest.mark.parametrize("count", [2, 3, 8, 9, 16])
def test_what_is_beside_an_image_changes_no_bit(model: ForwardModel, count: int) -> None:
    sigma = images(model, 17)
    weights = np.random.default_rng(4).standard_normal((17, model.sensor.n_measurements))
    every = solved(model, sigma, weights)
    some = np.random.default_rng(count).permutation(17)[:count]
    for one, other in zip(solved(model, sigma[some], weights[some]), every, strict=True):
        assert np.array_equal(one, other[some])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 1.0])
def test_what_images_share_is_solved_once_with_the_same_bits(
    model: ForwardModel, share: float
) -> None:
    """Eight images or fewer are solved in one go, so that nothing is saved from others."""
    sigma = images(model, 19)
    height, width = model.sensor.image_shape
    y, x = np.mgrid[:height, :width]
    # They differ in a corner, as large as the share says.
    alike = np.maximum(y / height, x / width) >= np.sqrt(share)
    sigma[:, alike] = sigma[0, alike]
    # What is alike in all but the first images is not shared.
    sigma[5:, height // 2, : width // 2] = sigma[5, height // 2, : width // 2]
    weights = np.random.default_rng(4).standard_normal((19, model.sensor.n_measurements))
    every = solved(model, sigma, weights)
    for of in (slice(0, 8), slice(8, 16), slice(16, 19)):
        few = solved(model, sigma[of], weights[of])
        for one, other in zip(few, every, strict=True):
            assert np.array_equal(one, other[of])
        assert np.array_equal(model.voltages(sigma[of]), model.voltages(sigma)[of])


def test_batches_against_a_dense_solver(model: ForwardModel) -> None:
    """The whole system as one matrix, solved by LAPACK."""
    mesh, of = model.mesh, model.sensor
    terms = electrode_terms(mesh, of.electrodes, of.outline.perimeter)
    sigma = images(model, 3)
    found = model.voltages(sigma)
    for image, voltages in zip(sigma, found, strict=True):
        inside = np.where(of.mask, image, of.background).ravel()
        values = inside if mesh.pixel_shares is None else mesh.pixel_shares @ inside
        matrix = terms.mass.toarray()
        for local, value, nodes in zip(stiffness(mesh), values, mesh.elements, strict=True):
            matrix[np.ix_(nodes, nodes)] += value * local
        conductance = np.diag(terms.conductance)
        conductance -= terms.coupling.T @ np.linalg.solve(matrix, terms.coupling)
        expected = signed_voltages(
            of.pattern.table, np.asarray(np.linalg.pinv(conductance, rcond=1e-12), float)
        )
        if of.pattern.magnitudes:
            expected = np.abs(expected)
        assert np.linalg.norm(voltages - expected) < 1e-9 * np.linalg.norm(expected)


def test_gradients_of_a_batch_are_those_of_the_jacobian(model: ForwardModel) -> None:
    sigma = images(model, 3)
    weights = np.random.default_rng(4).standard_normal((3, model.sensor.n_measurements))
    _, _, gradients = solved(model, sigma, weights)
    for image, g, gradient in zip(sigma, weights, gradients, strict=True):
        expected = np.tensordot(g, model.jacobian(image), 1)
        assert np.linalg.norm(gradient - expected) < 1e-11 * np.linalg.norm(expected)


@pytest.mark.parametrize("fails", [0, 5, 7, 8, 10])
def test_the_first_image_that_cannot_be_solved_is_named(fails: int) -> None:
    model = on_pixels(rectangle(0.1, 0.1), 16, (12, 12))
    sigma = images(model, 11)
    sigma[fails, :6], sigma[fails, 6:] = 1e300, 1e-300
    sigma[10] = sigma[fails]
    for solve in (model.voltages, model.voltages_and_fields):
        with pytest.raises(InputError, match=f"image {fails} cannot be solved"):
            solve(sigma)


def test_batches_have_the_shape_of_their_images() -> None:
    model = on_pixels(rectangle(0.1, 0.1), 4, (9, 9))
    sigma = images(model, 6)
    assert np.array_equal(
        model.voltages(sigma.reshape(2, 3, 9, 9)), model.voltages(sigma).reshape(2, 3, -1)
    )
