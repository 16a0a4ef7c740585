"""Figures of acuity, against images and laws whose answers are known."""

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from eitbench.benchmark.findings.acuity import (
    least_apart,
    pull_to_centre,
    result_of,
    roc,
    smallest_detected,
    threshold,
)
from eitbench.benchmark.findings.acuity_seen import seen
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.phantoms.acuity import Acuity
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor


def test_the_threshold_lets_one_in_a_hundred_pass() -> None:
    rng = np.random.default_rng(3)
    for n in (102, 250):
        limits = np.array([threshold(rng.uniform(size=n)) for _ in range(4000)])
        rate = (1 - limits).mean()  # of uniform strengths, the share above a limit is 1 - limit
        assert 0.5 / n < rate < 0.0105
    assert threshold(np.arange(99.0)) == 98
    assert threshold(np.arange(98.0)) == np.inf  # a new frame exceeds all with 1 in 99


def test_area_under_the_roc_is_the_probability_of_the_right_order() -> None:
    rng = np.random.default_rng(1)
    none, touch = rng.integers(0, 8, 60).astype(float), rng.integers(3, 12, 80).astype(float)
    curve = roc(none, touch)
    order = (touch[:, None] > none).mean() + 0.5 * (touch[:, None] == none).mean()  # Mann-Whitney
    assert np.trapezoid(curve[1], curve[0]) == pytest.approx(order)
    assert curve[:, 0].tolist() == [0, 0]
    assert curve[:, -1].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        ([0.0, 0.0, 1.0], 10 * np.sqrt(10)),  # halfway between 10 and 100 on a logarithmic axis
        ([1.0, 1.0, 1.0], 1.0),  # an upper bound
        ([1.0, 0.0, 1.0], 10 * np.sqrt(10)),  # luck below does not count
        ([0.0, 0.5, 1.0], 10.0),
        ([1.0, 1.0, 0.0], np.nan),
    ],
)
def test_the_smallest_touch_is_where_half_are_detected(share: list[float], expected: float) -> None:
    found = smallest_detected(np.array([1.0, 10.0, 100.0]), np.array(share))
    assert found == pytest.approx(expected, nan_ok=True)


def test_two_points_need_all_greater_distances_too() -> None:
    pairs = pd.DataFrame(
        {
            "probe_distance_mm": [10.0] * 10 + [20.0] * 10 + [30.0] * 10,
            "apart": [True] * 10 + [True] * 8 + [False] * 2 + [True] * 9 + [False],
        }
    )
    assert least_apart(pairs, 0.9) == 30.0
    assert least_apart(pairs, 0.8) == 10.0
    assert np.isnan(least_apart(pairs, 1.0))


def test_images_pulled_by_a_known_share_show_that_pull() -> None:
    sides = np.linspace(0.01, 0.09, 4)
    x, y = map(np.ravel, np.meshgrid(sides, sides))
    touch = pd.DataFrame({"place": np.arange(16.0), "x_m": x, "y_m": y, "detected": True})
    for pull in (0.25, 0.0, -0.1):
        touch["found_x_mm"], touch["found_y_mm"] = (
            1e3 * (0.05 + (1 - pull) * (axis - 0.05)) for axis in (x, y)
        )
        assert pull_to_centre(touch) == pytest.approx((pull, pull, pull), abs=1e-9)
        found, low, high = pull_to_centre(touch[touch["place"].between(3, 11)])
        assert np.isfinite(found)
        assert np.isnan([low, high]).all()  # nine places


def test_the_interval_of_the_pull_holds_it_as_often_as_it_says() -> None:
    """Of 400 lattices of 16 places with noise; an interval of quantiles alone holds 92 %."""
    rng = np.random.default_rng(0)
    sides = np.linspace(0.01, 0.09, 4)
    x, y = map(np.ravel, np.meshgrid(sides, sides))
    touch = pd.DataFrame({"place": np.arange(16.0), "x_m": x, "y_m": y, "detected": True})
    held = []
    for _ in range(400):
        for name, axis in (("found_x_mm", x), ("found_y_mm", y)):
            touch[name] = 1e3 * (0.05 + 0.8 * (axis - 0.05)) + rng.normal(0, 5, 16)
        _, low, high = pull_to_centre(touch)
        held.append(low <= 0.2 <= high)
    assert 0.93 <= np.mean(held) <= 0.98


COLUMNS = ("place", "pressure_pa", "x_m", "y_m", "x2_m", "y2_m", "probe_distance_mm")


def designed(nominal: Sensor, acuity: Acuity) -> tuple[NDArray[np.float64], pd.DataFrame]:
    """True images (n, H, W) of the design, and rows of samples at 50 dB."""
    phantoms = acuity.design(nominal)
    rows = [
        {"family": p.family, "snr_db": 50.0}
        | {name: p.parameters.get(name, np.nan) for name in COLUMNS}
        for p in phantoms
    ]
    return np.array([rasterise(phantom, nominal) for phantom in phantoms]), pd.DataFrame(rows)


def test_true_images_feel_all_at_their_places_and_blurred_ones_do_not_tell_two_apart() -> None:
    nominal, acuity = sensor("foam16"), Acuity()
    truth, samples = designed(nominal, acuity)
    exact = result_of("acuity", "exact", 50.0, seen(truth.copy(), truth, samples, nominal), nominal)
    assert exact.figures["auc"] == 1
    assert exact.figures["smallest_pa"] == acuity.pressures[0]
    assert exact.figures["error_mm"] < 1
    # Beside an indenter the foam gives way, too: nearer pairs are one contact even in the truth.
    assert exact.figures["least_mm"] == exact.figures["truth_least_mm"] == 30
    assert exact.figures["false_pairs"] == 0
    assert exact.figures["linearity"] > 0.99
    assert abs(exact.figures["pull"]) < 0.01
    places = exact.places
    assert places[["x_mm", "y_mm"]].to_numpy() == pytest.approx(
        1e3 * np.array(acuity.places(nominal))
    )
    rim = 50 - (places[["x_mm", "y_mm"]] - 50).abs().max(axis=1)  # of a square of 100 mm
    assert places["depth_mm"].to_numpy() == pytest.approx(rim.to_numpy(), abs=0.01)
    assert (places["least_mm"] == 30).sum() > 10
    assert (places["room_mm"] >= places["least_mm"].fillna(0)).all()
    assert places["amplitude"].to_numpy() == pytest.approx(1)  # of a right image
    assert places["ringing"].to_numpy() == pytest.approx(0)
    assert exact.figures["shape_deformation"] < 0.05
    assert abs(exact.figures["position_error_mm"]) < 0.3
    # Without an image nothing is felt, whatever was pressed.
    nothing = np.full_like(truth, np.nan)
    blind = result_of("acuity", "nothing", 50.0, seen(nothing, truth, samples, nominal), nominal)
    assert np.isnan(blind.figures["error_mm"])
    assert blind.figures["auc"] == 0
    assert blind.places[["smallest_pa", "amplitude", "resolution"]].isna().all(axis=None)
    assert np.isnan(blind.figures["least_mm"])


@pytest.mark.parametrize("family", ["no-touch", "touch"])
def test_a_method_gains_nothing_by_frames_that_it_fails_on(family: str) -> None:
    nominal = sensor("foam16")
    truth, samples = designed(nominal, Acuity())
    noise = np.random.default_rng(0).normal(scale=0.02, size=truth.shape)
    images = truth + np.where(nominal.mask, noise, 0)
    figures = []
    for failed in (False, True):
        if failed:
            of = samples["family"] == family
            firmest = samples["pressure_pa"] == samples["pressure_pa"].max()
            rows = np.flatnonzero(of & (firmest if family == "touch" else of))
            images[rows[::2]] = np.nan
        table = seen(images.copy(), truth, samples, nominal).assign(signal=1.0, rms=1.0)
        figures.append(result_of("acuity", "m", 50.0, table, nominal).figures)
    before, after = figures
    assert after["auc"] < before["auc"]
    if family == "no-touch":
        assert np.isnan(after["noise_figure"])
        assert np.isfinite(before["noise_figure"])
    else:
        for name in ("position_error_mm", "resolution", "ringing"):
            assert not after[name] < before[name]
        assert after["linearity"] < before["linearity"]


def test_the_noise_figure_of_a_matrix_is_what_its_frames_say() -> None:
    """The images of a linear method, against frames that are simulated here."""
    nominal, level = sensor("foam16"), 40.0
    model, rng = forward_model(nominal), np.random.default_rng(0)
    (phantom,) = (
        p for p in Acuity(draws=1).design(nominal)
        if p.family == "touch" and p.parameters["pressure_pa"] == 40000.0
        and abs(p.parameters["x_m"] - 0.05) + abs(p.parameters["y_m"] - 0.05) < 1e-6
    )  # fmt: skip
    truth = rasterise(phantom, nominal)[None]
    touched, untouched = model.voltages(truth)[0], model.voltages(model.background)
    change, rms = touched - untouched, np.sqrt(np.mean(touched**2))
    matrix = rng.normal(size=(nominal.mask.sum(), len(change)))
    std = 10 ** (-level / 20) * rms
    noise = rng.normal(scale=std, size=(2, 200, len(change)))
    images = np.full((201, *nominal.image_shape), nominal.background)
    images[:200, nominal.mask] += (noise[0] - noise[1]) @ matrix.T
    images[200:, nominal.mask] += change @ matrix.T
    of = {name: phantom.parameters.get(name, np.nan) for name in COLUMNS}
    none = {"family": "no-touch", "snr_db": level} | dict.fromkeys(COLUMNS, np.nan)
    samples = pd.DataFrame([none] * 200 + [{"family": "touch", "snr_db": level} | of])
    truths = np.full_like(images, nominal.background)
    truths[200:] = truth
    table = seen(images, truths, samples, nominal)
    pair = table.iloc[200:].assign(family="pair", probe_distance_mm=30.0, apart=False)
    rows = pd.concat([table, pair]).assign(signal=np.abs(change).mean(), rms=rms)
    found = result_of("acuity", "matrix", level, rows, nominal)
    pixels = images[:, nominal.mask] - nominal.background
    by_frames = (np.abs(change).mean() / np.std(noise[0] - noise[1], axis=1, ddof=1).mean()) / (
        np.abs(pixels[200]).mean() / np.std(pixels[:200], axis=1, ddof=1).mean()
    )
    assert found.figures["noise_figure"] == pytest.approx(by_frames, rel=0.01)
