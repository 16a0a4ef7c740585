from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from eitbench.benchmark import metrics
from eitbench.benchmark.metrics.evaluation import (
    GroundTruth,
    Scorer,
    evaluate,
    fit_calibration,
    fit_registration,
)
from eitbench.benchmark.metrics.image_metrics import PSNR_CEILING_DB
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import contacts
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.sensor import even_electrodes, foam16
from eitbench.scenarios.similarity import Similarity

Array = NDArray[np.float64]
# Not exactly a float32, as real backgrounds are.
SKIN = replace(
    foam16(), outline=Disc(0.07), electrodes=even_electrodes(Disc(0.07), 16, 0.01, 1e-3),
    background=0.3, image_shape=(40, 40),
)  # fmt: skip


def dataset(
    truth: Literal["conductivity", "position", "classes", "none"],
    n: int,
    images: NDArray[Any] | None = None,
    **columns: Array,
) -> GroundTruth:
    samples = pd.DataFrame({"sample": np.arange(n), **columns})
    return GroundTruth("bench", SKIN, samples, truth, images, images)


def presses(places: Array, level: float = -0.1) -> Array:
    """Conductivity (n, H, W) with a disc at each of `places` (n, 2) [m]."""
    x, y = SKIN.pixel_centres
    near = np.hypot(x - places[:, 0, None, None], y - places[:, 1, None, None]) < 0.012
    return np.where(near, SKIN.background + level, SKIN.background)


def places(n: int, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    radius, angle = 0.05 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def test_conductivity_is_scored_with_all_metrics() -> None:
    truth = presses(places(5))
    rng = np.random.default_rng(0)
    estimates = truth + 0.01 * rng.standard_normal(truth.shape)
    estimates[:, ~SKIN.mask] = np.nan
    rows = evaluate(dataset("conductivity", 5, truth), estimates)
    kept = estimates.astype(np.float32)
    expected = metrics.ssim(truth, kept, 1.0, SKIN.mask)
    np.testing.assert_array_equal(rows["ssim"], expected)
    np.testing.assert_array_equal(rows["psnr"], metrics.psnr(truth, kept, 1.0, SKIN.mask))
    np.testing.assert_allclose(
        rows["score"], 0.25 * (rows["ssim"] + rows["cc"] + rows["psnr"] - rows["rie"])
    )
    assert (rows["localisation_mm"] < 2).all()
    assert (rows["contact_count_error"] == 0).all()
    assert (rows["iou"] > 0.9).all()
    assert not rows["cc_undefined"].any()
    np.testing.assert_allclose(rows[["found_x_m", "found_y_m"]], places(5), atol=2e-3)


def test_a_scorer_that_is_asked_again_scores_as_if_asked_first() -> None:
    truth = presses(places(300))  # more than one block
    data = dataset("conductivity", 300, truth)
    scorer, noise = Scorer(data), np.random.default_rng(0).standard_normal(truth.shape)
    for estimates in (truth + 0.01 * noise, truth[::-1] + 0.02 * noise):
        pd.testing.assert_frame_equal(scorer(estimates), evaluate(data, estimates))


def test_the_force_is_scored_where_a_pressure_is_known() -> None:
    """Over the same area forces are to each other as pressures are."""
    truth, found = presses(places(3), level=-0.1), presses(places(3), level=-0.15)
    rows = evaluate(
        dataset("conductivity", 3, truth, pressure_pa=np.array([5e3, np.nan, 5e3])), found
    )
    law = FOAM.pressure([0.2 / 0.3, 0.15 / 0.3])
    expected = law[1] / law[0] - 1
    np.testing.assert_allclose(rows["force_error"], [expected, np.nan, expected], rtol=1e-4)
    assert evaluate(dataset("conductivity", 3, truth), found)["force_error"].isna().all()


def test_the_response_is_the_rms_of_the_contrast_inside() -> None:
    images = presses(places(3), level=-0.1)
    images[:, ~SKIN.mask] = 9.0
    inside = images[:, SKIN.mask] - SKIN.background
    rows = evaluate(dataset("none", 3), images)
    expected = np.sqrt((inside**2).mean(axis=1))
    assert expected.min() > 0.005
    np.testing.assert_allclose(rows["response"], expected, rtol=1e-5)
    assert not rows["cc_undefined"].any()
    assert rows["localisation_mm"].isna().all()


def test_the_truth_itself_is_perfect() -> None:
    truth = presses(places(4))
    rows = evaluate(dataset("conductivity", 4, truth), truth)
    np.testing.assert_allclose(rows["localisation_mm"], 0, atol=1e-4)
    assert (rows[["contact_count_error", "area_error"]] == 0).all(axis=None)
    assert (rows["iou"] == 1).all()
    assert (rows["psnr"] == PSNR_CEILING_DB).all()


def test_doing_nothing_is_flagged_and_charged_the_diameter() -> None:
    truth = presses(places(3))
    rows = evaluate(dataset("conductivity", 3, truth), np.full_like(truth, SKIN.background))
    assert rows["cc_undefined"].all()
    assert (rows["cc"] == 0).all()
    np.testing.assert_allclose(rows["localisation_mm"], 140.0)
    assert (rows["contact_count_error"] == 1).all()
    assert (rows["strength"] == 0).all()


def test_a_failed_frame_is_charged_what_the_untouched_sensor_gets() -> None:
    truth = presses(places(3))
    data = dataset("conductivity", 3, truth)
    estimates = truth.copy()
    estimates[1, 20, 20] = np.nan
    untouched = evaluate(data, np.full_like(truth, SKIN.background))
    pd.testing.assert_frame_equal(evaluate(data, estimates).loc[[1]], untouched.loc[[1]])


def test_classes_are_compared_with_the_contrast() -> None:
    low, high = places(3), places(3, seed=5)
    classes = (np.sign(presses(low) - 0.3) - np.sign(presses(high) - 0.3)).astype(np.int8)
    data = dataset("classes", 3, classes)
    rows = evaluate(data, SKIN.background + 0.02 * classes)
    np.testing.assert_allclose(rows["cc"], 1, atol=1e-6)
    assert (rows[["iou_resistive", "iou_conductive"]] == 1).all(axis=None)
    wrong = evaluate(data, SKIN.background - 0.02 * classes)
    np.testing.assert_allclose(wrong["cc"], -1, atol=1e-6)
    assert (wrong[["iou_resistive", "iou_conductive"]] < 0.2).all(axis=None)
    assert rows[["ssim", "psnr", "score"]].isna().all(axis=None)


def robot(points: Array) -> Array:
    return np.asarray(1.2 * points[:, ::-1] + np.array([0.3, -0.1]))


def position_data(n: int, seed: int) -> tuple[GroundTruth, Array]:
    image = places(n, seed)
    x, y = robot(image).T
    return dataset("position", n, x_m=x, y_m=y, depth_mm=np.linspace(10, 20, n)), image


def test_positions_are_judged_in_the_robot_s_frame() -> None:
    validation, image = position_data(30, 1)
    registration = fit_registration(validation, presses(image))
    test, image = position_data(20, 2)
    rows = evaluate(test, presses(image), registration)
    assert rows["localisation_mm"].median() < 2
    np.testing.assert_allclose(rows[["expected_x_m", "expected_y_m"]], image, atol=2e-3)
    np.testing.assert_allclose(rows[["found_x_m", "found_y_m"]], image, atol=2e-3)
    shifted = evaluate(test, presses(image + np.array([0.01, 0.0])), registration)
    assert shifted["localisation_mm"].median() == pytest.approx(12, abs=2)
    nothing = evaluate(test, np.full((20, 40, 40), SKIN.background), registration)
    np.testing.assert_allclose(nothing["localisation_mm"], 140 * registration.scale, rtol=1e-9)


def test_finding_nothing_is_never_better_than_guessing() -> None:
    """A similarity of images that say nothing shrinks them."""
    validation, _ = position_data(100, 1)
    registration = fit_registration(validation, presses(places(100, 7)))
    assert registration.scale < 0.5
    test, _ = position_data(100, 2)
    guessed = evaluate(test, presses(places(100, 8)), registration)["localisation_mm"]
    nothing = evaluate(test, np.full((100, 40, 40), SKIN.background), registration)
    np.testing.assert_allclose(nothing["localisation_mm"], 140, rtol=1e-9)
    assert guessed.max() < 140


def test_a_method_that_cannot_be_registered_gains_nothing() -> None:
    validation, _ = position_data(30, 1)
    blank = np.full((30, 40, 40), np.nan)
    registration = fit_registration(validation, blank)
    assert registration.scale == 1
    np.testing.assert_allclose(registration.turn, np.eye(2))
    pressed = validation.samples[["x_m", "y_m"]].to_numpy()
    np.testing.assert_allclose(registration.shift, pressed.mean(axis=0))  # the disc is centred
    always = presses(np.zeros((30, 2)))
    error = evaluate(validation, always, fit_registration(validation, always))["localisation_mm"]
    assert error.median() > 30


def test_positions_need_a_registration_and_estimates_their_shape() -> None:
    data, image = position_data(4, 0)
    with pytest.raises(InputError, match="registration"):
        evaluate(data, presses(image))
    with pytest.raises(InputError, match=r"\(4, 40, 40\), got \(3, 40, 40\)"):
        evaluate(data, presses(image)[:3], Similarity(1.0, np.eye(2), np.zeros(2)))


def several(n: int, seed: int) -> tuple[GroundTruth, Array]:
    """Touches of one or two contacts in the robot's frame, and their images."""
    one, other = places(n, seed), -places(n, seed)
    apart = np.hypot(*(one - other).T) > 0.045
    x, y = robot(one).T
    x2, y2 = np.where(apart, robot(other).T, np.nan)
    images = np.where(apart[:, None, None], np.minimum(presses(one), presses(other)), presses(one))
    count = 1 + apart.astype(int)
    return dataset("position", n, x_m=x, y_m=y, x2_m=x2, y2_m=y2, contacts=count), images


def test_several_contacts_are_counted_and_each_place_is_judged() -> None:
    validation, images = several(30, 1)
    assert set(validation.samples["contacts"]) == {1, 2}
    registration = fit_registration(validation, images)
    test, images = several(20, 2)
    rows = evaluate(test, images, registration)
    assert (rows["contact_count_error"] == 0).all()
    assert rows["localisation_mm"].max() < 2
    assert (rows["farthest_contact_mm"] >= rows["localisation_mm"]).all()
    # Of two contacts one is missed: the count is wrong, and so is the farthest place.
    both = (test.samples["contacts"] == 2).to_numpy()
    x, y = test.samples[["x_m", "y_m"]].to_numpy().T
    alone = presses((np.stack([y + 0.1, x - 0.3], axis=1)) / 1.2)
    missed = evaluate(test, alone, registration)[both]
    assert (missed["contact_count_error"] == 1).all()
    assert missed["farthest_contact_mm"].min() > 40
    np.testing.assert_allclose(missed["localisation_mm"], missed["farthest_contact_mm"] / 2, atol=2)
    nothing = evaluate(test, np.full_like(images, SKIN.background), registration)
    np.testing.assert_allclose(nothing["farthest_contact_mm"], 140 * registration.scale)
    assert (nothing["contact_count_error"] == test.samples["contacts"]).all()


def test_touches_of_two_contacts_alone_are_registered() -> None:
    """Where every touch has two, their middle says little: assigned pairs register the images."""
    turn = 2 * np.pi * np.random.default_rng(0).random(30)
    out = 0.04 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    one, other = 0.3 * places(30, 3) + out, 0.3 * places(30, 3) - out
    (x, y), (x2, y2) = robot(one).T, robot(other).T
    data = dataset("position", 30, x_m=x, y_m=y, x2_m=x2, y2_m=y2, contacts=np.full(30, 2))
    images = np.minimum(presses(one), presses(other))
    rows = evaluate(data, images, fit_registration(data, images))
    assert rows["farthest_contact_mm"].median() < 2
    assert (rows["contact_count_error"] == 0).all()


def test_touches_on_both_sides_of_one_point_are_registered() -> None:
    """Their middles say nothing; contacts that are found where they are register the images."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        one = 0.04 * np.exp(2j * np.pi * rng.random(30))
        image = np.stack([one.real, one.imag], axis=1)
        (x, y), (x2, y2) = robot(image).T, robot(-image).T
        data = dataset("position", 30, x_m=x, y_m=y, x2_m=x2, y2_m=y2, contacts=np.full(30, 2))
        strong = image * rng.choice([-1, 1], (30, 1))
        images = np.minimum(presses(strong), presses(-strong, -0.06))
        rows = evaluate(data, images, fit_registration(data, images))
        assert rows["farthest_contact_mm"].median() < 2


def test_a_measured_force_is_judged_after_a_line_through_the_validation_presses() -> None:
    draws = np.random.default_rng(0)
    level = draws.uniform(0.05, 0.2, 30)
    images = np.concatenate([presses(p[None], -s) for p, s in zip(places(30), level, strict=True)])
    strength = contacts(images - SKIN.background, SKIN).total_strength
    force = 2.0 + 3e4 * strength
    data = dataset("none", 30, force_N=force)
    line = fit_calibration(data, 0.3 + 2 * (images - 0.3))  # twice as strong: no difference
    assert line is not None
    assert line.full_scale == pytest.approx(force.max())
    rows = evaluate(data, 0.3 + 2 * (images - 0.3), calibration=line)
    np.testing.assert_allclose(rows["measured_force_error_n"], 0, atol=1e-3 * force.max())
    one_more = dataset("none", 30, force_N=force + 1)
    wrong = evaluate(one_more, 0.3 + 2 * (images - 0.3), calibration=line)
    np.testing.assert_allclose(wrong["measured_force_error_n"], 1, rtol=1e-2)
    expected = 100 * wrong["measured_force_error_n"] / force.max()
    np.testing.assert_allclose(wrong["measured_load_error_percent"], expected)
    assert (rows["response"] > 0).all()
    # Images of nothing get the mean force.
    blank = np.full_like(images, SKIN.background)
    guess = fit_calibration(data, blank)
    assert guess is not None
    assert guess.slope == 0
    assert guess.offset == pytest.approx(force.mean())


def test_a_pressure_is_judged_in_per_cent_alone_and_no_load_not_at_all() -> None:
    pressure = np.array([1e3, 2e3, 4e3, np.nan])
    images = presses(places(4), -0.1)
    data = dataset("none", 4, pressure_pa=pressure)
    rows = evaluate(data, images, calibration=fit_calibration(data, images))
    assert rows["measured_force_error_n"].isna().all()
    assert rows["measured_load_error_percent"].notna().tolist() == [True, True, True, False]
    assert fit_calibration(dataset("none", 4), images) is None
    few = dataset("none", 4, pressure_pa=np.array([1e3, 2e3, np.nan, 0.0]))
    assert fit_calibration(few, images) is None
    truth = dataset("conductivity", 4, images, pressure_pa=pressure)
    assert fit_calibration(truth, images) is None


def test_the_error_of_the_area_is_relative_to_the_true_one() -> None:
    """Squares of 10, 20 and 5 pixels a side: of 100 pixels true, 300 too many, and 75 missing."""
    middle = SKIN.mask.shape[0] // 2

    def square(side: int) -> Array:
        image = np.full((1, *SKIN.mask.shape), SKIN.background)
        image[:, middle - 5 : middle - 5 + side, middle - 5 : middle - 5 + side] -= 0.1
        return image

    for side, expected in ((20, 3.0), (5, 0.75), (10, 0.0)):
        (found,) = evaluate(dataset("conductivity", 1, square(10)), square(side))["area_error"]
        # Regions are cut where an image is halfway, so that corners are off by a pixel.
        assert found == pytest.approx(expected, abs=0.05)
