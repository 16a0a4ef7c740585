"""The density of phantoms is that of the generator that draws them."""

import math

import numpy as np
import pytest

from eitbench.benchmark import InputError
from eitbench.benchmark.ceiling.prior import PERIODS, FamilyPrior
from eitbench.scenarios import sensor
from eitbench.scenarios.phantoms.families import FAMILIES, DeclaredFamily, Family
from eitbench.scenarios.phantoms.phantom import draw, rasterise

SENSOR = sensor("foam16")
KNOWN = [
    pytest.param(FAMILIES[name], number, id=f"{name}-{FAMILIES[name].shapes[number].name}")
    for name in (
        *("circle", "two-circles", "l-shape", "triangle", "rectangle", "ring", "ellipse", "star"),
        *("conductive", "soft-press"),
    )
    for number in range(len(FAMILIES[name].shapes))
]
FOUR = FAMILIES["four-contacts"]


@pytest.mark.parametrize(("family", "number"), KNOWN)
def test_the_density_integrates_to_one(family: Family, number: int) -> None:
    prior, rng = FamilyPrior.of(family, SENSOR)[number], np.random.default_rng(3)
    parameters = prior.parameters
    turns = ~np.isfinite(parameters.high)
    period = PERIODS.get(family.shapes[number].name, 2 * math.pi)
    spans = np.where(turns, period, parameters.span)
    vectors = np.where(turns, 0, parameters.low) + spans * rng.random((3000, len(spans)))
    centre = prior.centre(prior.draw(20, rng))
    vectors = prior.unwrapped(vectors, centre)
    counted = prior.standing(vectors, centre)
    counted[counted] = parameters.possible(vectors[counted])
    density = np.where(counted, np.exp(prior.log_density(vectors)), 0) * spans.prod()
    error = density.std() / math.sqrt(len(density))
    assert error < 0.07
    assert density.mean() == pytest.approx(1, abs=4 * error)


@pytest.mark.parametrize("name", ["three-contacts", "four-contacts"])
def test_the_share_of_places_of_several_contacts_is_what_counting_says(name: str) -> None:
    """Their density is too uneven for a mean of it; its factor 1 / Z is checked on its own."""
    (prior,) = FamilyPrior.of(FAMILIES[name], SENSOR)
    rng = np.random.default_rng(6)
    parameters = prior.parameters
    off = []
    for vector in prior.draw(8, rng):
        vectors = np.tile(vector, (10_000, 1))
        parameters.parts(vectors)[..., :2] = rng.random((10_000, parameters.family.count, 2))
        counted = prior.fitting(vectors).mean()
        constant = math.log(parameters.copies) - np.log(parameters.span).sum()
        off.append(constant - prior.log_density(vector[None])[0] - math.log(counted))
    assert abs(np.mean(off)) < 0.05
    assert np.abs(off).max() < 0.2


def test_the_share_of_places_of_a_disc_is_what_geometry_says() -> None:
    """A disc of radius r fits into (1 - 2 r)^2 of a square of side 1."""
    (prior,) = FamilyPrior.of(FAMILIES["circle"], SENSOR)
    radius = np.array([0.1, 0.15, 0.2])
    vectors = np.stack([0 * radius + 0.5, 0 * radius + 0.5, radius, 0 * radius + 0.5], axis=1)
    density = prior.log_density(vectors)
    found = density - density[0]
    expected = -2 * (np.log(1 - 2 * radius) - np.log(1 - 2 * radius[0]))
    np.testing.assert_allclose(found, expected, atol=0.03)


@pytest.mark.parametrize(("family", "number"), [*KNOWN, pytest.param(FOUR, 0, id="four-contacts")])
def test_arranged_vectors_stand_for_the_same_phantoms(family: Family, number: int) -> None:
    """About any centre; and what stands is not changed by arranging it."""
    prior, rng = FamilyPrior.of(family, SENSOR)[number], np.random.default_rng(4)
    for _ in range(20):
        phantom = draw(prior.parameters.family, SENSOR, rng)
        vector = prior.parameters.of_phantom(phantom)
        (centre,) = prior.draw(1, rng)
        arranged = prior.arranged(vector[None], centre)
        assert prior.standing(arranged, centre).all()
        np.testing.assert_allclose(prior.arranged(arranged, centre), arranged)
        assert prior.fitting(arranged).all()
        image = prior.parameters.image(arranged[0]) * SENSOR.background
        differ = ~np.isclose(image, rasterise(phantom, SENSOR), rtol=1e-12)
        # An ellipse is painted as a polygon; rounding of a turn may move a pixel.
        assert differ.sum() <= (12 if family.name == "ellipse" else 1)


def test_the_shapes_of_a_family_are_drawn_as_often_as_said() -> None:
    priors, rng = FamilyPrior.of(FAMILIES["conductive"], SENSOR), np.random.default_rng(5)
    drawn = [draw(FAMILIES["conductive"], SENSOR, rng).shape for _ in range(1000)]
    for prior in priors:
        (shape,) = prior.parameters.family.shapes
        # Four standard deviations of a binomial distribution.
        assert drawn.count(shape.name) / 1000 == pytest.approx(prior.share, abs=0.063)


def test_angles_are_those_nearest_to_a_centre() -> None:
    (prior,) = FamilyPrior.of(FAMILIES["rectangle"], SENSOR)
    vectors = np.tile([0.5, 0.5, 0.0, 0.3, 0.2, 0.5], (4, 1))
    vectors[:, 2] = [0.1, math.pi - 0.1, 0.2, math.pi - 0.2]
    arranged = prior.arranged(vectors, prior.centre(vectors))
    assert np.ptp(arranged[:, 2]) == pytest.approx(0.4)
    np.testing.assert_array_equal(arranged[:, 3:5], vectors[:, 3:5])


def test_phantoms_that_are_alike_have_vectors_that_are_close() -> None:
    """A square whose longer side is now one and now the other; contacts above each other."""
    (square,) = FamilyPrior.of(FAMILIES["rectangle"], SENSOR)
    vectors = np.array([[0.5, 0.5, 0.1, 0.21, 0.2, 0.5], [0.5, 0.5, 0.12, 0.2, 0.21, 0.5]])
    vectors[1, 2:5] = 0.12 + math.pi / 2, 0.21, 0.2
    assert np.ptp(square.arranged(vectors, square.centre(vectors)), axis=0).max() < 0.021
    (four,) = FamilyPrior.of(FOUR, SENSOR)
    contacts = np.array([[0.30, 0.2, 0.05, 0.5], [0.31, 0.8, 0.08, 0.3],
                         [0.70, 0.8, 0.06, 0.4], [0.71, 0.2, 0.07, 0.6]])  # fmt: skip
    moved = contacts + np.array([[0.012], [-0.012], [0.012], [-0.012]]) * [1, 0, 0, 0]
    moved = moved[np.argsort(moved[:, 0])]
    vectors = np.stack([contacts.ravel(), moved.ravel()])
    assert np.ptp(vectors, axis=0).max() > 0.5
    assert np.ptp(four.arranged(vectors, four.centre(vectors)), axis=0).max() < 0.0121


def test_a_value_that_does_not_vary_is_refused() -> None:
    fixed = DeclaredFamily(
        name="fixed", shape="circle", sizes={"radius": (0.1, 0.2)}, conductivity=(0.5, 0.5)
    )
    with pytest.raises(InputError, match="ranges that have a width"):
        FamilyPrior.of(fixed.family(), SENSOR)


def test_a_family_of_many_inclusions_is_refused() -> None:
    many = DeclaredFamily(
        name="many",
        shape="circle",
        sizes={"radius": (0.02, 0.04)},
        conductivity=(0.2, 0.5),
        count=6,
    )
    with pytest.raises(InputError, match="at most 5 inclusions, not 6"):
        FamilyPrior.of(many.family(), SENSOR)


@pytest.mark.parametrize(("family", "number"), [*KNOWN, pytest.param(FOUR, 0, id="four-contacts")])
def test_the_density_is_that_of_the_phantom(family: Family, number: int) -> None:
    """All vectors of a phantom have the same."""
    prior, rng = FamilyPrior.of(family, SENSOR)[number], np.random.default_rng(6)
    vectors, centres = prior.draw(20, rng), prior.draw(5, rng)
    density = prior.log_density(vectors)
    assert np.ptp(density) > 0 or not prior._sized.any()
    for centre in centres:
        arranged = prior.arranged(vectors, centre)
        np.testing.assert_allclose(prior.log_density(arranged), density, atol=1e-9)


def test_a_family_without_parameters_is_refused() -> None:
    with pytest.raises(InputError, match=r"family 'tank-1': .* drawn from a range"):
        FamilyPrior.of(FAMILIES["tank-1"], SENSOR)
