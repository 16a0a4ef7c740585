"""The slab in three dimensions: beside the plane, and beside its own finer layers."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.scenarios import sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.physics.slab import Depth, SlabModel
from eitbench.scenarios.sensors.outlines import Disc

FOAM = replace(sensor("foam16"), image_shape=(16, 16))


def touched() -> Array:
    x, y = FOAM.pixel_centres
    return np.where(np.hypot(x - 0.04, y - 0.06) < 0.015, 0.4, 1.0)


@pytest.mark.parametrize("thickness_m", [0.001, 0.02])
def test_with_electrodes_of_its_whole_height_it_is_the_plane(thickness_m: float) -> None:
    """The potential is then the same at every depth, to the last digits."""
    sigma = np.random.default_rng(0).uniform(0.2, 1.0, FOAM.image_shape)
    slab = SlabModel(FOAM, Depth(thickness_m, (0.0, 1.0), 3))
    np.testing.assert_allclose(slab.voltages(sigma), ForwardModel(FOAM).voltages(sigma), rtol=1e-9)


def test_lower_electrodes_differ_and_their_side_does_not_matter() -> None:
    sigma = touched()
    plane = ForwardModel(FOAM).voltages(sigma)
    below, above = (
        SlabModel(FOAM, Depth(0.01, ends, 4)).voltages(sigma) for ends in ((0, 0.5), (0.5, 1))
    )
    np.testing.assert_allclose(below, above, rtol=1e-9)
    assert np.linalg.norm(below - plane) > 0.005 * np.linalg.norm(plane)


def test_a_thin_slab_is_the_plane_with_the_contact_impedance_of_its_electrodes() -> None:
    """Half of the height has half of the area; current fills the depth within the thickness."""
    halved = tuple(replace(e, contact_impedance=2 * e.contact_impedance) for e in FOAM.electrodes)
    plane = ForwardModel(replace(FOAM, electrodes=halved)).voltages(touched())
    apart = [
        np.linalg.norm(
            SlabModel(FOAM, Depth(thickness_m, (0.0, 0.5), 4)).voltages(touched()) - plane
        )
        for thickness_m in (4e-3, 1e-3, 2.5e-4)
    ]
    assert apart[0] > 2 * apart[1] > 2 * 2 * apart[2]
    assert apart[2] < 1e-3 * np.linalg.norm(plane)


def test_layers_converge() -> None:
    """The current is singular at the upper ends of electrodes, so that the order is near 1."""
    found = [
        SlabModel(FOAM, Depth(0.01, (0.0, 0.5), layers)).voltages(touched())
        for layers in (2, 4, 8, 32)
    ]
    errors = [np.linalg.norm(one - found[-1]) for one in found[:-1]]
    assert errors[0] > 1.6 * errors[1] > 1.6 * 1.6 * errors[2]


def test_what_is_no_image_of_the_sensor_is_refused() -> None:
    model = SlabModel(replace(FOAM, image_shape=(6, 13)))
    with pytest.raises(InputError, match=r"needs shape \(\.\.\., 6, 13\), got \(13, 6\)"):
        model.voltages(model.background.T)
    with pytest.raises(InputError, match="above 0 S/m"):
        model.voltages(-model.background)
    with pytest.raises(InputError, match=r"4 layers end between two of them; \(0, 0\.3\)"):
        Depth(0.01, (0, 0.3), 4)


def test_a_disc_is_refused() -> None:
    with pytest.raises(InputError, match="rectangle"):
        SlabModel(replace(FOAM, outline=Disc(0.4 / (2 * np.pi))))
