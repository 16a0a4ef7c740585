"""The density of phantoms is that of the generator that draws them."""

import math

import numpy as np
import pytest

from eitbench.benchmark import InputError
from eitbench.benchmark.ceiling.prior import PERIODS, FamilyPrior
from eitbench.scenarios import sensor
from eitbench.scenarios.phantoms.families import FAMILIES, DeclaredFamily
from eitbench.scenarios.phantoms.phantom import draw, rasterise

SENSOR = sensor("foam16")
KNOWN = ("circle", "two-circles", "l-shape", "triangle", "rectangle", "ring", "ellipse", "star")


@pytest.mark.parametrize("name", KNOWN)
def test_the_density_integrates_to_one(name: str) -> None:
    prior, rng = FamilyPrior.of(FAMILIES[name], SENSOR), np.random.default_rng(3)
    parameters = prior.parameters
    turns = ~np.isfinite(parameters.high)
    period = PERIODS.get(FAMILIES[name].shapes[0].name, 2 * math.pi)
    spans = np.where(turns, period, parameters.span)
    vectors = np.where(turns, 0, parameters.low) + spans * rng.random((3000, len(spans)))
    counted = prior.standing(vectors)
    counted[counted] = parameters.possible(vectors[counted])
    density = np.where(counted, np.exp(prior.log_density(vectors)), 0) * spans.prod()
    error = density.std() / math.sqrt(len(density))
    assert error < 0.07
    assert density.mean() == pytest.approx(1, abs=4 * error)


def test_the_share_of_places_of_a_disc_is_what_geometry_says() -> None:
    """A disc of radius r fits into (1 - 2 r)^2 of a square of side 1."""
    prior = FamilyPrior.of(FAMILIES["circle"], SENSOR)
    radius = np.array([0.1, 0.15, 0.2])
    vectors = np.stack([0 * radius + 0.5, 0 * radius + 0.5, radius, 0 * radius + 0.5], axis=1)
    density = prior.log_density(vectors)
    found = density - density[0]
    expected = -2 * (np.log(1 - 2 * radius) - np.log(1 - 2 * radius[0]))
    np.testing.assert_allclose(found, expected, atol=0.03)


@pytest.mark.parametrize("name", KNOWN)
def test_folded_vectors_stand_for_the_same_phantoms(name: str) -> None:
    prior, rng = FamilyPrior.of(FAMILIES[name], SENSOR), np.random.default_rng(4)
    for _ in range(20):
        phantom = draw(FAMILIES[name], SENSOR, rng)
        vector = prior.parameters.of_phantom(phantom)
        folded = prior.folded(vector[None])
        assert prior.standing(folded).all()
        assert prior.fitting(folded[:1]).all()
        image = prior.parameters.image(folded[0]) * SENSOR.background
        differ = image != rasterise(phantom, SENSOR)
        # An ellipse is painted as a polygon; rounding of a turn may move a pixel.
        assert differ.sum() <= (12 if name == "ellipse" else 1)


def test_angles_are_unwrapped_about_their_mean() -> None:
    prior = FamilyPrior.of(FAMILIES["rectangle"], SENSOR)
    vectors = np.tile([0.5, 0.5, 0.0, 0.3, 0.2, 0.5], (4, 1))
    vectors[:, 2] = [0.1, math.pi - 0.1, 0.2, math.pi - 0.2]
    unwrapped = prior.unwrapped(vectors)
    assert np.ptp(unwrapped[:, 2]) == pytest.approx(0.4)
    np.testing.assert_allclose(prior.wrapped(unwrapped), vectors)


def test_a_value_that_does_not_vary_is_refused() -> None:
    fixed = DeclaredFamily(
        name="fixed", shape="circle", sizes={"radius": (0.1, 0.2)}, conductivity=(0.5, 0.5)
    )
    with pytest.raises(InputError, match="ranges that have a width"):
        FamilyPrior.of(fixed.family(), SENSOR)


@pytest.mark.parametrize("name", ["conductive", "soft-press", "tank-1"])
def test_a_family_without_parameters_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"not known for family '{name}'"):
        FamilyPrior.of(FAMILIES[name], SENSOR)
