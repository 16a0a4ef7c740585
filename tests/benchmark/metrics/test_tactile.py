from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from eitbench.benchmark.metrics import tactile
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import contacts, locate
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.sensors.standard import foam16

Array = NDArray[np.float64]
FOAM = foam16()
PIXEL = 0.1 / 80


def disc_sensor() -> Sensor:
    outline = Disc(0.07)
    return replace(
        FOAM, name="disc", outline=outline, electrodes=even_electrodes(outline, 16, 0.01, 1e-3)
    )


def blobs(*discs: tuple[float, float, float, float], sensor: Sensor = FOAM) -> Array:
    """Contrast (1, H, W) with discs of x, y, radius [m] and contrast [S/m]."""
    x, y = sensor.pixel_centres
    image = np.zeros(sensor.image_shape)
    for x0, y0, radius, level in discs:
        image[np.hypot(x - x0, y - y0) < radius] = level
    return image[None]


def test_contacts_have_their_place_area_strength_and_sign() -> None:
    image = blobs((0.03, 0.04, 0.01, -0.5), (0.07, 0.06, 0.012, 0.9))
    found = contacts(image, FOAM)
    assert found.count.tolist() == [2]
    np.testing.assert_allclose(found.position, [[0.07, 0.06], [0.03, 0.04]], atol=PIXEL / 2)
    areas = np.array([np.sum(image == 0.9), np.sum(image == -0.5)]) * PIXEL**2
    np.testing.assert_allclose(found.area, areas)
    np.testing.assert_allclose(found.strength, areas * [0.9, 0.5])
    np.testing.assert_array_equal(found.region, np.sign(image))


def test_images_do_not_touch_each_other_and_may_be_empty() -> None:
    image = blobs((0.05, 0.05, 0.02, -0.5))
    stack = np.concatenate([image, image, np.zeros_like(image), image])
    found = contacts(stack, FOAM)
    assert found.count.tolist() == [1, 1, 0, 1]
    assert found.of(2) == slice(2, 2)
    assert contacts(stack[:0], FOAM).count.shape == (0,)


def test_touching_regions_of_opposite_sign_are_two_contacts() -> None:
    image = blobs((0.05, 0.05, 0.02, -0.5))
    image[:, :, 40:] *= -1
    assert contacts(image, FOAM).count.tolist() == [2]


def test_specks_are_no_contacts_unless_nothing_else_is_there() -> None:
    image = blobs((0.05, 0.05, 0.02, -0.5))
    image[0, 2, 2] = -1.0
    found = contacts(image, FOAM)
    assert found.count.tolist() == [1]
    assert found.region[0, 2, 2] == 0
    np.testing.assert_allclose(found.position, [[0.05, 0.05]], atol=1e-9)
    speck = np.zeros((1, 80, 80))
    speck[0, 2, 5] = 0.1
    np.testing.assert_allclose(locate(speck, FOAM), [[5.5 * PIXEL, 2.5 * PIXEL]])


def test_only_a_quarter_of_the_peak_counts() -> None:
    image = blobs((0.03, 0.03, 0.01, -0.8), (0.07, 0.07, 0.01, -0.21), (0.03, 0.07, 0.01, -0.19))
    found = contacts(image, FOAM)
    assert found.count.tolist() == [2]


@pytest.mark.parametrize("level", [0.0, -0.3])
def test_a_constant_image_shows_no_contact(level: float) -> None:
    sensor = disc_sensor()
    image = np.full((1, 80, 80), level)
    image[:, ~sensor.mask] = 5.0
    assert contacts(image, sensor).count.tolist() == [0]
    assert np.isnan(locate(image, sensor)).all()


def test_the_only_contact_may_be_drawn_in_pieces() -> None:
    """Two equal blobs of one press: its place is between them; a faint third changes nothing."""
    image = blobs((0.03, 0.05, 0.01, -0.8), (0.07, 0.05, 0.01, -0.8), (0.05, 0.09, 0.01, 0.19))
    np.testing.assert_allclose(locate(image, FOAM), [[0.05, 0.05]], atol=1e-9)


def test_what_lies_outside_the_sensor_is_not_seen() -> None:
    sensor = disc_sensor()
    image = blobs((0.02, -0.03, 0.012, 0.4), sensor=sensor)
    image[:, ~sensor.mask] = np.nan
    np.testing.assert_allclose(locate(image, sensor), [[0.02, -0.03]], atol=1e-3)


def test_contrast_must_be_finite_images() -> None:
    with pytest.raises(InputError, match="finite inside the sensor"):
        contacts(np.full((1, 80, 80), np.nan), FOAM)
    with pytest.raises(InputError, match="shape"):
        contacts(np.zeros((80, 80)), FOAM)


def test_diameter_is_the_longest_way_across() -> None:
    assert tactile.diameter(FOAM) == pytest.approx(0.1 * np.sqrt(2))
    assert tactile.diameter(disc_sensor()) == pytest.approx(0.14)


def localised(truth: Array, estimate: Array) -> float:
    pair = contacts(truth, FOAM), contacts(estimate, FOAM)
    return float(tactile.localisation(*pair, FOAM)[0])


def test_localisation_assigns_contacts_so_that_distances_are_least() -> None:
    truth = blobs((0.03, 0.03, 0.01, -0.8), (0.07, 0.07, 0.01, -0.7))
    swapped = blobs((0.033, 0.03, 0.01, -0.4), (0.07, 0.075, 0.01, -0.9))
    assert localised(truth, truth) == pytest.approx(0)
    assert localised(truth, swapped) == pytest.approx((0.003 + 0.005) / 2, abs=PIXEL / 2)


def test_missing_extra_and_no_contacts_are_never_rewarded() -> None:
    truth = blobs((0.03, 0.03, 0.01, -0.8), (0.07, 0.03, 0.01, -0.7))
    one = blobs((0.03, 0.03, 0.01, -0.8))
    assert localised(truth, one) == pytest.approx(0.04 / 2, abs=PIXEL / 2)
    assert localised(truth, np.zeros((1, 80, 80))) == pytest.approx(0.1 * np.sqrt(2))
    # Two strong false contacts hide two weak true ones: spraying contacts does not help.
    sprayed = truth * 0.5 + blobs((0.03, 0.08, 0.01, -0.8), (0.07, 0.08, 0.01, -0.8))
    assert localised(truth, sprayed) == pytest.approx(0.05, abs=PIXEL / 2)
    assert np.isnan(localised(np.zeros((1, 80, 80)), one))


def test_overlap_counts_pixels_of_the_same_sign() -> None:
    truth = np.zeros((4, 4, 4), dtype=np.int8)
    truth[:3, :2] = 1
    estimate = np.zeros_like(truth)
    estimate[0, :2] = 1
    estimate[1, 1:3] = 1
    estimate[2, :2] = -1
    np.testing.assert_allclose(tactile.overlap(truth, estimate), [1, 1 / 3, 0, np.nan])
    np.testing.assert_allclose(tactile.overlap(truth, estimate, (-1,)), [np.nan, np.nan, 0, np.nan])


@given(
    angle=st.floats(0, 6.28),
    scale=st.floats(0.1, 10),
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    mirrored=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_similarity_is_recovered(
    angle: float, scale: float, shift: tuple[float, float], mirrored: bool, seed: int
) -> None:
    points = np.random.default_rng(seed).standard_normal((12, 2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if mirrored:
        turn = turn @ np.diag([1, -1])
    target = scale * points @ turn.T + shift
    lost = np.vstack([points, [np.nan, np.nan]])
    fitted = tactile.fit_similarity(lost, np.vstack([target, [0.0, 0.0]]))
    assert fitted is not None
    np.testing.assert_allclose(fitted(points), target, atol=1e-9)
    np.testing.assert_allclose(fitted.inverse(target), points, atol=1e-9)
    np.testing.assert_allclose(fitted.turn, turn, atol=1e-9)


def test_points_that_determine_no_similarity_give_none() -> None:
    target = np.random.default_rng(0).standard_normal((5, 2))
    line = np.linspace(0, 1, 5)[:, None] * [1.0, 2.0]
    assert tactile.fit_similarity(np.zeros((5, 2)), target) is None
    assert tactile.fit_similarity(line, target) is None
    assert tactile.fit_similarity(np.full((5, 2), np.nan), target) is None
    assert tactile.fit_similarity(target[:2], target[:2]) is None


def test_a_similarity_survives_contacts_that_were_found_elsewhere() -> None:
    rng = np.random.default_rng(0)
    points = rng.standard_normal((60, 2))
    target = 2 * points[:, ::-1] + np.array([5.0, 1.0])
    points[:15] = rng.standard_normal((15, 2))
    fitted = tactile.fit_similarity(points, target)
    assert fitted is not None
    np.testing.assert_allclose(fitted(points[15:]), target[15:], atol=0.05)
