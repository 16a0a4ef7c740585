"""Contacts found in images that are made by hand."""

import numpy as np
import pytest
from tests.support.contact_images import FOAM, PIXEL, blobs, disc_sensor

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import contacts, locate


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
    for find in (contacts, locate):
        with pytest.raises(InputError, match=r"shape \(n, 80, 80\), got \(80, 80\)"):
            find(np.zeros((80, 80)), FOAM)
        with pytest.raises(InputError, match=r"got \(\)"):
            find(1.0, FOAM)
    with pytest.raises(InputError, match="finite inside the sensor"):
        locate(np.full((1, 80, 80), np.inf, np.float32), FOAM)
