"""What a sensor is made of is checked where it is made: outlines, patterns, electrodes, pixels."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.scenarios import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model, signed_voltages
from eitbench.scenarios.sensors.outlines import Disc, Polygon, rectangle
from eitbench.scenarios.sensors.patterns import (
    equal_noise,
    independent,
    offset_pattern,
    ring_pattern,
)
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.sensors.symmetry import motions

BOW = [(0, 0), (100, 0), (100, 100), (60, -30)]
SPIKE = [(0, 0), (100, 0), (200, 0), (100, 0), (100, 80), (0, 80)]
TOUCHING = [(0, 0), (200, 0), (200, 100), (100, 100), (100, 0), (50, 100)]
CLOSED_TWICE = [(0, 0), (100, 0), (100, 100), (0, 100), (0, 0)]
U_SHAPE = [(0, 0), (90, 0), (90, 90), (60, 90), (60, 30), (30, 30), (30, 90), (0, 90)]


@pytest.mark.parametrize(
    ("vertices", "sides"),
    [(BOW, "0 and 2"), (SPIKE, "0 and 2"), (TOUCHING, "0 and 3"), (CLOSED_TWICE, "0 and 3")],
)
def test_sides_that_meet_are_named(vertices: list[tuple[float, float]], sides: str) -> None:
    """The mesher would not come to an end."""
    with pytest.raises(InputError, match=f"Sides {sides} of a polygon cross or touch"):
        Polygon(tuple(vertices))


def test_outlines_that_are_not_convex_or_have_straight_corners_are_made() -> None:
    assert Polygon(tuple(U_SHAPE)).perimeter == pytest.approx(480)
    assert Polygon(((0, 0), (1, 0), (2, 0), (2, 1), (0, 1))).perimeter == pytest.approx(6)
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    ring = Polygon(tuple(zip(np.cos(angle).tolist(), np.sin(angle).tolist(), strict=True)))
    assert ring.perimeter == pytest.approx(2 * np.pi, rel=1e-3)


def test_coordinates_are_finite() -> None:
    with pytest.raises(InputError, match="no finite number"):
        Polygon(((0, 0), (1, 0), (1, float("nan"))))
    with pytest.raises(InputError, match="positive radius"):
        Disc(float("inf"))


def test_a_grid_needs_a_pixel_inside() -> None:
    c_shape = Polygon(
        ((0.0, 0.0), (0.4, 0.0), (0.4, 0.02), (0.02, 0.02), (0.02, 0.38), (0.4, 0.38), (0.4, 0.4),
         (0.0, 0.4))
    )  # fmt: skip
    electrodes = even_electrodes(c_shape, 8, 0.01, 1e-3)
    pattern = offset_pattern(8, 1)
    with pytest.raises(InputError, match=r"No pixel of sensor 'c'.* use a finer image_shape"):
        Sensor("c", c_shape, electrodes, pattern, image_shape=(4, 4))
    assert Sensor("c", c_shape, electrodes, pattern, image_shape=(40, 40)).mask.any()


def test_offsets_are_whole_numbers_of_any_kind() -> None:
    of_numpy = offset_pattern(16, np.int64(3))  # type: ignore[arg-type]
    assert np.array_equal(of_numpy.table, offset_pattern(16, 3).table)
    for wrong in (True, 1.0, 16, 0):
        with pytest.raises(InputError, match="An offset is a whole number from 1 to 15"):
            offset_pattern(16, wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"nothing is left to measure .*driven = true"):
        ring_pattern(3, 1, 1)


def test_another_offset_keeps_what_the_board_reports() -> None:
    assert sensor("ohmc16").pattern.magnitudes
    assert sensor("ohmc16", offset=3).pattern.magnitudes
    assert not sensor("foam16", offset=1).pattern.magnitudes


def test_the_combinations_of_a_frame_have_the_noise_of_one_measurement() -> None:
    """Of offset 4 some pairs are measured twice, some four times."""
    pattern = offset_pattern(16, 4)
    combine, norms = equal_noise(pattern)
    noise = np.random.default_rng(0).normal(size=(4000, pattern.n_measurements))
    np.testing.assert_allclose((noise @ combine).std(axis=0), 1, atol=0.05)
    assert set(np.round(norms, 6)) <= {1.0, round(2**-0.5, 6), 0.5}
    assert norms.min() < 1


def test_pairs_that_occur_both_ways_round_are_measured_eight_times() -> None:
    """Of offset 8 each drive and each sense pair is its own reverse: 28 pairs of pairs are left."""
    pattern = offset_pattern(16, 8)
    half = np.random.default_rng(3).normal(size=(16, 16))
    voltages = signed_voltages(pattern.table, half + half.T)
    first, owner, sign = independent(pattern)
    assert len(first) == len(set(np.round(np.abs(voltages), 9))) == 28
    np.testing.assert_allclose(voltages, voltages[first][owner] * sign, rtol=1e-6)
    assert set(np.bincount(owner)) == {8}
    pairs = pattern.reciprocal_pairs()
    assert len(pairs) == 28 * 4 * 4
    signs = pattern.reciprocal_signs(pairs)
    np.testing.assert_allclose(voltages[pairs[:, 1]], signs * voltages[pairs[:, 0]])


def test_a_square_ring_of_electrodes_has_the_eight_symmetries_of_a_square() -> None:
    foam = replace(sensor("foam16"), image_shape=(16, 16))
    model = forward_model(foam)
    assert len(motions(foam, model.jacobian(model.background))) == 8
    oblong = rectangle(0.1, 0.08)
    electrodes = even_electrodes(oblong, 16, 0.005, 1e-3, start=0.01125)
    uneven = replace(foam, outline=oblong, electrodes=electrodes)
    model = forward_model(uneven)
    assert len(motions(uneven, model.jacobian(model.background))) < 8


def test_the_rim_is_a_place_on_the_sensor_and_what_is_beyond_it_is_not() -> None:
    square, disc = sensor("foam16"), sensor("ktc2023")
    assert isinstance(disc.outline, Disc)
    for made in (square, disc):
        outline = made.outline
        for x, y in outline.point(np.linspace(0, outline.perimeter, 41)).tolist():
            made.check_place(x, y)
            beyond = outline.centre + 1.0001 * (np.array([x, y]) - outline.centre)
            with pytest.raises(InputError, match="is outside the sensor"):
                made.check_place(*beyond.tolist())


def test_a_notch_is_not_part_of_a_sensor() -> None:
    notched = Polygon(((0, 0), (4, 0), (4, 4), (2, 1), (0, 4)))
    assert notched.reaches([2, 2, 1, np.inf], [1, 1.01, 1, 0]).tolist() == [
        True,
        False,
        True,
        False,
    ]


def test_widths_that_overlap_are_told_in_mm() -> None:
    foam = sensor("foam16")
    wide = tuple(replace(electrode, width=0.03) for electrode in foam.electrodes)
    with pytest.raises(InputError, match="30 mm and 30 mm wide and 25 mm apart"):
        replace(foam, electrodes=wide)
