"""Tactile metrics of images that are made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tests.support.contact_images import FOAM, PIXEL, Array, blobs, disc_sensor

from eitbench.benchmark.metrics import tactile
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.scenarios.phantoms.contacts import contacts
from eitbench.scenarios.phantoms.press import FOAM as LAW
from eitbench.scenarios.sensors.sensor import Sensor


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


def bars(inside: float, outside: float, far: float = 0.0, sign: float = -1.0) -> Array:
    """A bar of contrast `sign` over the whole height, with a step of its own near its edges."""
    x = (np.arange(80) + 0.5) / 80 * 0.1
    reach = tactile.EDGE_ZONE * tactile.diameter(FOAM)
    off = np.abs(x - 0.05) - 0.02  # below 0 inside
    profile = np.where(
        off < -reach, 1.0, np.where(off < 0, inside, np.where(off < reach, outside, far))
    )
    return sign * np.broadcast_to(profile, (1, 80, 80))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_edge_and_artefacts_of_a_bar_as_by_hand(sign: float) -> None:
    truth = bars(1.0, 0.0, sign=sign)
    zones = tactile.edge_zones(contacts(truth, FOAM), truth, FOAM)

    def figures(image: Array) -> tuple[float, float]:
        edge, artefacts = tactile.edges_and_artefacts(zones, image, FOAM)
        return float(edge[0]), float(artefacts[0])

    assert figures(truth) == pytest.approx((1, 0))
    assert figures(0 * truth) == pytest.approx((0, 0))
    assert figures(bars(0.7, 0.3, sign=sign)) == pytest.approx((0.4, 0))
    assert figures(bars(1.2, -0.1, sign=sign)) == pytest.approx((1.3, 0))
    columns = np.count_nonzero(bars(0.0, 0.0, 1.0)[0, 0] == -1) - np.count_nonzero(
        bars(0.0, 0.0)[0, 0] == -1
    )
    wide = np.count_nonzero(truth[0, 0])
    expected = 0.2 * np.sqrt(columns / wide)
    assert figures(bars(1.0, 0.0, 0.2, sign=sign)) == pytest.approx((1, expected))


def test_edges_blur_and_contacts_of_both_signs_count_alike() -> None:
    truth = blobs((0.03, 0.03, 0.012, -0.8), (0.07, 0.07, 0.012, 0.8))
    zones = tactile.edge_zones(contacts(truth, FOAM), truth, FOAM)
    widths = [0, 1, 2, 4, 8]
    found = [
        tactile.edges_and_artefacts(zones, gaussian_filter(truth, (0, w, w)), FOAM) for w in widths
    ]
    edges, artefacts = np.array(found)[:, :, 0].T
    assert (np.diff(edges) < 0).all()
    assert (np.diff(artefacts) > 0).all()
    # Where nothing was touched there is nothing to compare with.
    nothing = np.zeros_like(truth)
    zones = tactile.edge_zones(contacts(nothing, FOAM), nothing, FOAM)
    blank = tactile.edges_and_artefacts(zones, truth, FOAM)
    assert np.isnan(blank).all()


@pytest.mark.parametrize("sensor", [FOAM, disc_sensor()])
def test_edges_are_those_by_the_distance_of_every_pixel_from_every_other(sensor: Sensor) -> None:
    """Rectangles of either sign anywhere, also beside the rim."""
    rng, sensor = np.random.default_rng(4), replace(sensor, image_shape=(40, 40))
    x, y = (centres.ravel() for centres in sensor.pixel_centres)
    mask = sensor.mask.ravel()
    apart = np.hypot(x - x[:, None], y - y[:, None])
    reach = tactile.EDGE_ZONE * tactile.diameter(sensor)
    for _ in range(20):
        truth = np.zeros((1, *sensor.image_shape))
        for row, column in rng.integers(0, sensor.image_shape, (3, 2)):
            height, width = rng.integers(2, 13, 2)
            truth[0, row : row + height, column : column + width] = rng.choice([-0.5, 0.5])
        image = truth + 0.1 * rng.standard_normal(truth.shape)
        true = contacts(truth, sensor)
        region = true.region.ravel().astype(float)
        outside = apart[:, region != 0].min(axis=1)
        inner = mask & (region != 0) & (apart[:, region == 0].min(axis=1) <= reach)
        outer = mask & (region == 0) & (outside <= reach)
        # Pixels between contacts of both signs belong to either.
        nearest = {sign: apart[:, region == sign].min(axis=1, initial=9.0) for sign in (-1, 1)}
        sign = np.where(nearest[1] < nearest[-1], 1.0, -1.0)
        tied = outer & np.isclose(nearest[1], nearest[-1])
        zones = tactile.edge_zones(true, truth, sensor)
        edge, artefacts = tactile.edges_and_artefacts(zones, image, sensor)
        step, whole = (
            (sign * of.ravel())[inner].mean() - (sign * of.ravel())[outer].mean()
            for of in (image, truth)
        )
        far = mask & (outside > reach)
        left = np.linalg.norm(image.ravel()[far]) / np.linalg.norm(truth.ravel()[mask])
        np.testing.assert_allclose(artefacts, left)
        if not tied.any():
            np.testing.assert_allclose(edge, step / whole)


def test_force_of_a_strip_is_that_of_its_edges_and_its_middle() -> None:
    """Under a strip p w; beside it, p(e exp(-d / l)) integrates to -E l e_d ln(1 - e / e_d)."""
    pressure, width, side = 30e3, 0.03, 0.1
    strain = float(LAW.strain(pressure))
    edge = -LAW.modulus * LAW.falloff * LAW.densification * np.log(1 - strain / LAW.densification)
    expected = side * (pressure * width + 2 * edge)
    errors = []
    for n in (80, 160, 320):
        x = (np.arange(n) + 0.5) / n * side
        profile = LAW.pressed(pressure, np.maximum(np.abs(x - side / 2) - width / 2, 0))
        sensor = replace(FOAM, image_shape=(4, n))
        image = FOAM.background * np.broadcast_to(profile, (1, 4, n))
        (found,) = tactile.force(image, sensor)
        errors.append(abs(found / expected - 1))
    assert errors[0] < 0.003
    assert errors[1] < errors[0] / 3.5
    assert errors[2] < errors[1] / 3.5
    assert tactile.force(np.full((1, 80, 80), FOAM.background), FOAM) == pytest.approx(0, abs=1e-4)


def test_noise_adds_as_much_to_the_force_as_the_card_says() -> None:
    """The law is curved: pressures of noise that is 0 in the mean are not."""
    noise = np.random.default_rng(0).standard_normal((20, 80, 80))
    for share, newtons in ((0.02, 0.1), (0.05, 0.5)):
        found = tactile.force(FOAM.background * (1 + share * noise), FOAM).mean()
        assert found == pytest.approx(newtons, abs=0.05)
        assert f"{newtons} N" in METRICS["force_error"].traps
