"""Units of a sensor on the mesh of the nominal one."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.scenarios import sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import TYPICAL
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.physics.mesh import Mesh, triangle_mesh
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, even_electrodes

FOAM = replace(sensor("foam16"), image_shape=(20, 20))
UNITS = [TYPICAL.model_copy(update={"unit": unit}).built(FOAM) for unit in range(3)]


TOUCHES = ((0.043, 0.061, 0.012), (0.071, 0.032, 0.008), (0.024, 0.024, 0.01))
"""Discs (x, y, radius) [m] of a fall to 0.4 S/m."""


def change(of: Sensor, mesh: Mesh) -> Array:
    """What touches change (3, M) [V/A]."""
    model = ForwardModel(of, mesh)
    x, y = of.pixel_centres
    sigma = np.array([np.where(np.hypot(x - a, y - b) < r, 0.4, 1.0) for a, b, r in TOUCHES])
    return np.asarray(model.voltages(sigma) - model.voltages(model.background))


def apart_db(one: Array, other: Array) -> float:
    return float(20 * np.log10(np.linalg.norm(other) / np.linalg.norm(one - other)))


@pytest.mark.parametrize(
    "electrodes", [UNITS[0], *(pytest.param(of, marks=pytest.mark.slow) for of in UNITS[1:])]
)
def test_a_unit_is_solved_on_the_mesh_of_the_nominal_sensor_as_on_its_own(
    electrodes: tuple[Electrode, ...],
) -> None:
    """Its electrodes end between nodes there: at most half of the error of the mesh as a whole."""
    unit = replace(FOAM, electrodes=electrodes)
    shared, own = (change(unit, triangle_mesh(of)) for of in (FOAM, unit))
    finer = replace(unit, image_shape=(60, 60))
    assert apart_db(shared, own) > apart_db(own, change(finer, triangle_mesh(finer))) + 6


def test_an_electrode_beyond_its_part_of_the_rim_is_refused() -> None:
    first = replace(FOAM.electrodes[0], centre=FOAM.electrodes[0].centre + 0.014)
    moved = replace(FOAM, electrodes=(first, *FOAM.electrodes[1:]))
    with pytest.raises(InputError, match="too far"):
        ForwardModel(moved, triangle_mesh(FOAM))


@pytest.mark.slow
def test_unstructured_data_are_nearer_to_the_truth_than_the_model_of_methods_is() -> None:
    """Pixels, triangles three times finer, and the truth: triangles four times finer."""
    own = ForwardModel(FOAM).mesh
    fine, finest = (replace(FOAM, image_shape=(20 * k, 20 * k)) for k in (3, 4))
    truth = change(finest, triangle_mesh(finest))
    nominal, data = change(FOAM, own), change(fine, triangle_mesh(fine))
    assert apart_db(data, truth) > apart_db(nominal, truth) + 10


def test_a_mesh_of_long_thin_pixels_is_refused_before_it_fills_the_memory() -> None:
    outline = rectangle(0.2, 0.01)
    strip = replace(
        FOAM, name="strip", outline=outline, image_shape=(144, 144),
        electrodes=even_electrodes(outline, 16, 0.005, 1e-3),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"'strip' would have about 9\d\d,\d\d\d triangles"):
        triangle_mesh(strip)
