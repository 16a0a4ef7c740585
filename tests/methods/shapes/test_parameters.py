"""Shapes as vectors of parameters: their images, derivatives and prior."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.families import PUBLISHED_FAMILIES
from tests.support.small_sensors import foam

from eitbench.methods.shapes.parameters import AREAS, ROUND, Parameters
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.phantoms.phantom import Patch, Phantom, draw, rasterise

Array = NDArray[np.float64]
SENSOR = foam((48, 40))
SHAPES = (*PUBLISHED_FAMILIES, "star", "three-contacts")


def drawn(name: str, count: int) -> tuple[Parameters, list[Phantom]]:
    rng = np.random.default_rng(1)
    return Parameters(FAMILIES[name], SENSOR), [
        draw(FAMILIES[name], SENSOR, rng) for _ in range(count)
    ]


def test_several_shapes_with_ratios_are_those_of_phantoms() -> None:
    """Each has its own, and a column of its own."""
    small = {"outer": (0.1, 0.2), "inner_ratio": (0.4, 0.65)}
    shapes = tuple(replace(shape, sizes=small) for shape in FAMILIES["ring"].shapes)
    family = replace(FAMILIES["ring"], name="two-rings", shapes=shapes, count=2)
    parameters, rng = Parameters(family, SENSOR), np.random.default_rng(1)
    for phantom in (draw(family, SENSOR, rng) for _ in range(20)):
        assert phantom.parameters["inner_1_ratio"] != phantom.parameters["inner_2_ratio"]
        image = parameters.image(parameters.of_phantom(phantom))
        truth = rasterise(phantom, SENSOR) / SENSOR.background
        assert np.abs(image - truth).max() < 1e-9


@pytest.mark.parametrize("name", SHAPES)
def test_sharp_images_are_those_of_phantoms(name: str) -> None:
    """The phantoms' own rasteriser asks for every pixel whether its centre lies inside."""
    parameters, phantoms = drawn(name, 20)
    for phantom in phantoms:
        image = parameters.image(parameters.of_phantom(phantom))
        truth = rasterise(phantom, SENSOR) / SENSOR.background
        assert np.abs(image - truth).max() < 1e-9


@pytest.mark.parametrize(("name", "sizes"), [("circle", 1), ("ring", 2), ("ellipse", 2)])
def test_a_soft_edge_keeps_the_area(name: str, sizes: int) -> None:
    """With level e the logarithm of the image is the share of each pixel inside."""
    parameters, (phantom, *_) = drawn(name, 1)
    vector = parameters.of_phantom(phantom)
    vector[-1] = math.e
    image = parameters.image(vector, 1.0)
    area = AREAS[name](*vector[-1 - sizes : -1]) * parameters.side**2
    width, height = SENSOR.pixel_size
    assert np.log(image).sum() * width * height == pytest.approx(area, rel=0.01)
    assert ((image > 1.0001) & (image < math.e - 0.0001)).any()


@pytest.mark.parametrize("name", [*SHAPES, "ellipse"])
def test_rims_are_those_of_the_regions_of_phantoms(name: str) -> None:
    parameters, phantoms = drawn(name, 5)
    vectors = np.array([parameters.of_phantom(phantom) for phantom in phantoms])
    for phantom, rims in zip(phantoms, parameters.rims(vectors), strict=True):
        for inclusion, rim in zip(phantom.inclusions, rims, strict=True):
            assert isinstance(inclusion, Patch)
            there = inclusion.region.rim()
            if name in ROUND or parameters.family.count > 1:  # discs: at whatever angle
                rim, there = (np.hypot(*(of - of.mean(axis=0)).T) for of in (rim, there))
            np.testing.assert_allclose(rim, there, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", PUBLISHED_FAMILIES)
def test_the_derivative_predicts_a_small_change_of_the_image(name: str) -> None:
    parameters, phantoms = drawn(name, 3)
    rng = np.random.default_rng(2)
    for phantom in phantoms:
        vector = parameters.of_phantom(phantom)
        change = 0.2 * rng.standard_normal(len(vector))
        ahead = parameters.image(vector + change * parameters.step, 2.0)
        behind = parameters.image(vector - change * parameters.step, 2.0)
        predicted = 2 * np.tensordot(change, parameters.derivative(vector, 2.0), axes=1)
        missed = np.linalg.norm(ahead - behind - predicted) / np.linalg.norm(predicted)
        assert missed < 0.15


@pytest.mark.parametrize("name", [*SHAPES, "ellipse"])
def test_coordinates_hold_the_strength_of_dipoles(name: str) -> None:
    """Area times (x - 1) / (x + 1), with the area as it is drawn; they lead back to the vectors."""
    parameters, phantoms = drawn(name, 10)
    vectors = np.array([parameters.of_phantom(phantom) for phantom in phantoms])
    straight, log_volume = parameters.straightened(vectors)
    assert parameters.bent(straight) == pytest.approx(vectors, rel=1e-12)
    pixel = math.prod(SENSOR.pixel_size) / parameters.side**2
    images = parameters.images(vectors)
    drawn_strength = ((images - 1) / (images + 1)).sum(axis=(1, 2)) * pixel
    last = straight.reshape(10, parameters.family.count, -1)[..., -1]
    assert last.sum(axis=1) == pytest.approx(drawn_strength, abs=5 * pixel)

    for vector, volume in zip(vectors, log_volume, strict=True):
        tiny = 1e-6 * np.eye(len(vector))
        ahead, behind = (parameters.straightened(vector + s * tiny)[0] for s in (1, -1))
        determinant = np.linalg.slogdet((ahead - behind) / 2e-6)[1]
        assert volume == pytest.approx(-determinant, abs=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_drawn_phantoms_are_possible_and_shifted_ones_are_not(name: str) -> None:
    parameters, phantoms = drawn(name, 10)
    vectors = np.array([parameters.of_phantom(phantom) for phantom in phantoms])
    assert parameters.possible(vectors).all()
    outside = vectors.copy()
    outside[:, 0] = 0.01  # centred beside the left side
    assert not parameters.possible(outside).any()
    beyond = vectors.copy()
    beyond[:, -1] = 0.95  # less contrast than any of the family
    assert not parameters.within(beyond).any()


def test_contacts_must_lie_apart() -> None:
    parameters = Parameters(FAMILIES["two-circles"], SENSOR)
    apart = np.array([0.3, 0.5, 0.1, 0.5, 0.7, 0.5, 0.1, 0.5])
    near = np.array([0.41, 0.5, 0.1, 0.5, 0.6, 0.5, 0.1, 0.5])
    assert parameters.possible(np.array([apart, near])).tolist() == [True, False]


def test_copies_have_the_same_image() -> None:
    rectangle = Parameters(FAMILIES["rectangle"], SENSOR)
    x, y, angle, width, height, level = vector = np.array([0.5, 0.4, 0.3, 0.4, 0.2, 0.5])
    turned = [
        [x, y, angle + math.pi, width, height, level],
        [x, y, angle + math.pi / 2, height, width, level],
        [x, y, angle - math.pi / 2, height, width, level],
    ]
    assert rectangle.copies == 1 + len(turned)
    image = rectangle.image(vector, 1.0)
    for other in turned:
        assert np.abs(rectangle.image(np.array(other), 1.0) - image).max() < 1e-9
    assert Parameters(FAMILIES["two-circles"], SENSOR).copies == 2
    assert Parameters(FAMILIES["ring"], SENSOR).copies == 1
