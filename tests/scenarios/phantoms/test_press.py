"""The law of the foam: monotone, bounded, and falling off beside the indenter as stated."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.benchmark.metrics.tactile import force
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.phantoms.press import FOAM, PRESSURE_PA


def test_strain_solves_the_stated_law() -> None:
    pressure = np.linspace(0, 200e3, 50)
    strain = FOAM.strain(pressure)
    assert np.allclose(FOAM.modulus * strain / (1 - strain / FOAM.densification), pressure)


def test_conductivity_falls_strictly_with_pressure_and_stays_positive() -> None:
    ratio = FOAM.conductivity_ratio(FOAM.strain(np.linspace(0, 10e6, 1000)))
    assert ratio[0] == 1.0
    assert (np.diff(ratio) < 0).all()
    assert (ratio > 0).all()


def test_range_of_the_family_is_the_documented_one() -> None:
    pressure = FAMILIES["soft-press"].pressure
    assert pressure is not None
    low, high = FOAM.conductivity_ratio(FOAM.strain(pressure))
    assert (round(float(low), 2), round(float(high), 2)) == (0.91, 0.28)


def test_conductivity_ratio_is_thickness_times_archie() -> None:
    # At a strain of 1/2 the solid's share doubles from 3 % to 6 % and half of the layer is left.
    assert FOAM.conductivity_ratio(0.5) == pytest.approx(0.5 * (0.94 / 0.97) ** 1.5)


def test_edge_decays_over_the_stated_length() -> None:
    assert pytest.approx(0.01 / np.sqrt(6)) == FOAM.falloff
    distance = np.linspace(0, 10 * FOAM.falloff, 30)
    ratio = FOAM.pressed(30e3, distance)
    assert ratio[0] == pytest.approx(float(FOAM.conductivity_ratio(FOAM.strain(30e3))))
    assert (np.diff(ratio) > 0).all()
    assert ratio[-1] == pytest.approx(1.0, abs=1e-4)
    one_length = FOAM.conductivity_ratio(FOAM.strain(30e3) / np.e)
    assert FOAM.pressed(30e3, FOAM.falloff) == pytest.approx(float(one_length))


@given(st.floats(0, PRESSURE_PA[1]))
def test_pressure_is_found_again_from_conductivity(pressure: float) -> None:
    ratio = FOAM.conductivity_ratio(FOAM.strain(pressure))
    assert FOAM.pressure(ratio) == pytest.approx(pressure, rel=1e-5, abs=0.01)


def test_noise_about_the_untouched_cancels_and_no_pressure_is_firmer_than_the_firmest() -> None:
    up, down = FOAM.pressure([1.001, 0.999])
    assert up < 0 < down
    assert up + down == pytest.approx(0, abs=0.01 * down)
    firmest = float(FOAM.conductivity_ratio(FOAM.strain(PRESSURE_PA[1])))
    least, beyond = FOAM.pressure([firmest, 0.05])
    assert least == pytest.approx(PRESSURE_PA[1])
    assert beyond == pytest.approx(PRESSURE_PA[1])
    assert FOAM.pressure(5.0) == FOAM.pressure(2.1)


@pytest.mark.parametrize("newtons", [0.5, 2.5, 8.0])
def test_an_indenter_carries_what_the_force_of_its_image_says(newtons: float) -> None:
    """On a sensor of fine pixels, far from its rim; and back."""
    fine = replace(sensor("foam16"), image_shape=(800, 800))
    radius = 0.005
    pressure = FOAM.pressure_of(newtons, radius)
    assert float(FOAM.carried(pressure, radius)) == pytest.approx(newtons, rel=1e-9)
    x, y = fine.pixel_centres
    away = np.maximum(np.hypot(x - 0.05, y - 0.05) - radius, 0)
    image = fine.background * FOAM.pressed(pressure, away)
    assert force(image[None], fine) == pytest.approx(newtons, rel=2e-3)


def test_more_than_the_law_of_the_foam_holds_for_is_refused() -> None:
    with pytest.raises(InputError, match=r"up to 60000 Pa, which is 10\.0 N .* of 5 mm"):
        FOAM.pressure_of(40.0, 0.005)
