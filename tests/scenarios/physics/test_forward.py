"""Laws that the discrete forward model must keep, whatever the sensor."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.physics.mesh import triangle_mesh
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon, rectangle
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, even_electrodes

Array = NDArray[np.float64]


def sensor_on(
    outline: Outline,
    shape: tuple[int, int],
    width: float = 0.007,
    contact_impedance: float = 1e-3,
    start: float = 0.0125,
) -> Sensor:
    electrodes = even_electrodes(outline, 16, width, contact_impedance, start=start)
    return Sensor("small", outline, electrodes, offset_pattern(16, 3), image_shape=shape)


def small(name: str) -> Sensor:
    outlines: dict[str, Outline] = {
        "square": rectangle(0.1, 0.1),
        "wide": rectangle(0.13, 0.06),
        "tall": rectangle(0.06, 0.13),
        "disc": Disc(0.05),
        "polygon": Polygon(((0, 0), (0.1, 0), (0.1, 0.05), (0.05, 0.05), (0.05, 0.1), (0, 0.1))),
    }
    return sensor_on(outlines[name], {"wide": (12, 26), "tall": (26, 12)}.get(name, (20, 20)))


def on_triangles(s: Sensor) -> ForwardModel:
    return ForwardModel(s, triangle_mesh(s))


SENSORS = ["square", "wide", "tall", "disc", "polygon"]


def rough_image(s: Sensor, seed: int = 0) -> Array:
    return np.exp(0.5 * np.random.default_rng(seed).standard_normal(s.image_shape))


@pytest.mark.parametrize("name", SENSORS)
def test_reciprocity(name: str) -> None:
    s = small(name)
    v = ForwardModel(s).voltages(rough_image(s))
    pairs = s.pattern.reciprocal_pairs()
    assert len(pairs) == 104
    gap = v[pairs[:, 1]] - s.pattern.reciprocal_signs(pairs) * v[pairs[:, 0]]
    assert np.abs(gap).max() < 1e-10 * np.abs(v).max()


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("magnitudes", [False, True])
def test_jacobian_against_central_differences(name: str, magnitudes: bool) -> None:
    s = small(name)
    s = replace(s, pattern=replace(s.pattern, magnitudes=magnitudes))
    model, sigma = ForwardModel(s), rough_image(s)
    v, jacobian = model.linearise(sigma)
    np.testing.assert_allclose(v, model.voltages(sigma), rtol=1e-12)
    some = np.array([5, 0, 17])
    assert np.array_equal(model.linearise(sigma, some)[1], jacobian[some])
    rng = np.random.default_rng(1)
    for _ in range(3):
        direction = sigma * rng.standard_normal(s.image_shape)
        step = 1e-4
        central = (
            model.voltages(sigma + step * direction) - model.voltages(sigma - step * direction)
        ) / (2 * step)
        predicted = np.tensordot(jacobian, direction, axes=2)
        assert np.linalg.norm(predicted - central) < 1e-6 * np.linalg.norm(central)


@pytest.mark.parametrize(("offset", "values", "rank"), [(1, 208, 104), (3, 208, 104), (4, 208, 62)])
def test_independent_measurements(offset: int, values: int, rank: int) -> None:
    """offset 3 and 4 both give 208 values; only the rank tells them apart."""
    foam = sensor("foam16", offset=offset)
    foam = replace(foam, image_shape=(40, 40))
    jacobian = forward_model(foam).jacobian(np.ones((40, 40))).reshape(values, -1)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    assert int(np.sum(singular > 1e-9 * singular[0])) == rank
    assert singular[rank] < 1e-12 * singular[0]


def test_voltages_converge_at_second_order_under_refinement() -> None:
    """Between grids of n, 2n and 4n pixels the differences of a smooth sigma fall by 2^2."""
    # A contact impedance of a tenth of the side: with foam16's the asymptotic range starts
    # where pixels are much smaller than z sigma = 1 mm.
    s = sensor_on(rectangle(0.1, 0.1), (16, 16), 0.0125, 1e-2)
    solutions = []
    for factor in (1, 2, 4, 8):
        fine = s.refined(factor)
        x, y = fine.pixel_centres
        sigma = 1 + 0.5 * np.sin(40 * x) * np.cos(30 * y)
        solutions.append(ForwardModel(fine).voltages(sigma))
    gaps = [np.linalg.norm(b - a) for a, b in pairwise(solutions)]
    rates = -np.diff(np.log2(gaps))
    assert (rates > 1.7).all()
    assert (rates < 2.2).all()


@pytest.mark.parametrize("name", SENSORS)
def test_scaling_law(name: str) -> None:
    """V(c sigma, z / c) = V(sigma, z) / c: twice the conductance, half the voltage."""
    s, sigma = small(name), rough_image(small(name))
    halved = (replace(e, contact_impedance=e.contact_impedance / 2) for e in s.electrodes)
    softer = ForwardModel(replace(s, electrodes=tuple(halved))).voltages(2 * sigma)
    np.testing.assert_allclose(softer, ForwardModel(s).voltages(sigma) / 2, rtol=1e-9, atol=1e-12)


def test_quarter_turn_of_the_sensor_permutes_the_frame() -> None:
    foam = replace(sensor("foam16"), image_shape=(20, 20))
    sigma = rough_image(foam)
    v = forward_model(foam).voltages(sigma)
    # Rows grow upwards: counter-clockwise.
    turned = forward_model(foam).voltages(np.rot90(sigma, -1))
    order = {tuple(row): k for k, row in enumerate(foam.pattern.table.tolist())}
    shifted = [order[tuple((np.array(row) + 4) % 16)] for row in foam.pattern.table.tolist()]
    np.testing.assert_allclose(turned[shifted], v, rtol=1e-10)


def test_an_electrode_may_end_inside_an_edge() -> None:
    """The width of an electrode counts, not the edges it happens to touch."""
    v = []
    for width in np.linspace(0.0094, 0.0106, 5):
        s = sensor_on(rectangle(0.1, 0.1), (20, 20), width)
        v.append(ForwardModel(s).voltages(np.ones((20, 20)))[0])
    steps = np.diff(v)
    assert (steps < 0).all()
    assert steps.min() > 2 * steps.max()


def test_electrode_across_the_start_of_the_rim() -> None:
    """Turning a disc's electrodes past the start of its rim changes nothing but the mesh."""
    frames = []
    for start in (0.0, 0.02):
        s = sensor_on(Disc(0.05), (48, 48), 0.008, start=start)
        frames.append(ForwardModel(s).voltages(np.ones(s.image_shape)))
    assert np.linalg.norm(frames[0] - frames[1]) < 2e-3 * np.linalg.norm(frames[0])


@pytest.mark.parametrize(("count", "share", "start"), [(16, 0.3, 0.02125), (12, 0.2, 0.03)])
def test_an_electrode_may_end_at_the_first_vertex(count: int, share: float, start: float) -> None:
    """Its end lies a rounding error before the start of the rim; both meshes take it."""
    outline = rectangle(0.1, 0.1)
    electrodes = even_electrodes(outline, count, share * 0.4 / count, 1e-3, start=start)
    ends = [(e.centre + e.width / 2) % 0.4 for e in electrodes]
    assert 0.4 - 1e-12 < max(ends) < 0.4
    s = Sensor("corner", outline, electrodes, offset_pattern(count, 3), image_shape=(40, 40))
    untouched = np.ones(s.image_shape)
    squares, triangles = (m.voltages(untouched) for m in (ForwardModel(s), on_triangles(s)))
    assert np.abs(triangles - squares).max() < 0.02 * np.abs(squares).max()


def test_electrodes_may_have_unlike_widths() -> None:
    """A wide one reaches beyond the middle between its centre and that of a narrow neighbour."""
    outline = rectangle(0.1, 0.1)
    electrodes = tuple(
        Electrode(0.0125 + 0.025 * k, (0.026, 0.006)[k % 2], 1e-3) for k in range(16)
    )
    s = Sensor("unlike", outline, electrodes, offset_pattern(16, 3), image_shape=(40, 40))
    untouched = np.ones(s.image_shape)
    squares, triangles = (m.voltages(untouched) for m in (ForwardModel(s), on_triangles(s)))
    assert np.abs(triangles - squares).max() < 0.01 * np.abs(squares).max()
    pairs = s.pattern.reciprocal_pairs()
    gap = squares[pairs[:, 1]] - s.pattern.reciprocal_signs(pairs) * squares[pairs[:, 0]]
    assert np.abs(gap).max() < 1e-10 * np.abs(squares).max()


@pytest.mark.parametrize("first", [1, 2, 3])
def test_a_rectangle_may_begin_at_any_corner(first: int) -> None:
    """Electrodes at the same places of it give the same frame, on the mesh of pixels."""
    nominal = sensor("foam16")
    assert isinstance(nominal.outline, Polygon)
    corners = nominal.outline.vertices
    begun = Polygon((*corners[first:], *corners[:first]))
    start = nominal.outline.corners[first]
    moved = replace(
        nominal,
        outline=begun,
        electrodes=tuple(
            replace(e, centre=(e.centre - start) % begun.perimeter) for e in nominal.electrodes
        ),
    )
    expected, found = (
        model.voltages(model.background) for model in map(forward_model, (nominal, moved))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_equal_sensors_share_a_model() -> None:
    assert forward_model(sensor("foam16")) is forward_model(sensor("foam16"))
    assert forward_model(sensor("foam16")) is not forward_model(sensor("foam16", offset=4))


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_impossible_conductivity_is_refused(bad: float) -> None:
    s = small("square")
    sigma = np.ones(s.image_shape)
    sigma[3, 4] = bad
    for call in (ForwardModel(s).voltages, ForwardModel(s).jacobian):
        with pytest.raises(InputError, match="finite and above 0"):
            call(sigma)


def test_wrong_shapes_are_refused() -> None:
    model = ForwardModel(small("wide"))
    with pytest.raises(InputError, match=r"\(\.\.\., 12, 26\), got \(26, 12\)"):
        model.voltages(np.ones((26, 12)))
    with pytest.raises(InputError, match="one image"):
        model.jacobian(np.ones((2, 12, 26)))


SQUARE = rectangle(0.1, 0.1)
TWO = (Electrode(0.01, 0.01, 1e-3), Electrode(0.015, 0.01, 1e-3))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"electrodes": even_electrodes(SQUARE, 16, 0.026, 1e-3)}, "overlap"),
        ({"electrodes": TWO}, "Electrodes 0 and 1 of sensor 'foam16' overlap"),
        ({"electrodes": even_electrodes(SQUARE, 8, 0.01, 1e-3)}, "uses electrode 8, but .* 0 to 7"),
        ({"data_range": -1.0}, "range"),
        ({"conductivity_range": (0.0, 1.0)}, "range"),
    ],
)
def test_impossible_sensors_are_refused(change: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        replace(sensor("foam16"), **change)


@pytest.mark.parametrize(
    "table", [np.zeros((0, 4)), np.zeros((3, 3)), [[0, 0, 1, 2]], [[0, 1, 2, 2]], [[0.5, 1, 2, 3]]]
)
def test_impossible_patterns_are_refused(table: object) -> None:
    with pytest.raises(InputError):
        DrivePattern(np.array(table))


@pytest.mark.parametrize("offset", [0, 16, -16, 1.5])
def test_impossible_offsets_are_refused(offset: int) -> None:
    with pytest.raises(InputError, match="whole number from 1 to 15"):
        sensor("foam16", offset=offset)


def test_no_images_give_no_frames() -> None:
    assert ForwardModel(small("square")).voltages(np.ones((0, 20, 20))).shape == (0, 208)


@pytest.mark.nightly
def test_machine_code_need_not_be_kept() -> None:
    """Installed where nothing is writable: compiled anew by every process."""
    program = """
from numba.core.caching import CacheImpl
CacheImpl._locator_classes = []
import numpy as np
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics import elimination
from eitbench.scenarios.physics.forward import forward_model
model = forward_model(sensor("foam16"))
print(model.voltages(model.background)[0], elimination.solve.stats.cache_path)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    first, kept = done.stdout.split()
    model = forward_model(sensor("foam16"))
    assert float(first) == pytest.approx(model.voltages(model.background)[0], rel=1e-12)
    assert kept == "None"
