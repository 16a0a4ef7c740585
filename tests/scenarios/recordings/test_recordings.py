"""The recorded sets as read from the real files."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import loadmat

from eitbench.methods.places.kernel_ridge import gaussians, kernel_ridge
from eitbench.scenarios.arrays import unit_frames
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.recordings.public.hydrogel import CUTS, START_FRAMES
from eitbench.scenarios.recordings.public.pyeidors_tank import read_csv
from eitbench.scenarios.recordings.quality import quality, reciprocity_error
from eitbench.scenarios.recordings.superposed import DISTANCES_MM, PAIRS, TOLERANCE_MM
from eitbench.scenarios.sensors.patterns import DrivePattern, ring_pattern
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]

pytestmark = pytest.mark.usefixtures("recorded_data")

read = cache(read_recording)


@cache
def nominal(name: str) -> Sensor:
    return RECORDED_SETS[name].sensor()


@cache
def background(name: str) -> tuple[Array, Array]:
    """Voltages (M,) and Jacobian (M, H, W) of the nominal, homogeneous sensor."""
    model = forward_model(nominal(name))
    return model.voltages(model.background), model.jacobian(model.background)


def one_step(name: str, change: Array) -> Array:
    """One-step images (..., H, W) of changes (..., M), diagonal prior, 0 outside the sensor."""
    voltages, jacobian = background(name)
    reference = read(name).reference
    gain = (voltages @ reference) / (voltages @ voltages)
    mask = nominal(name).mask
    weight = 1 / (np.abs(voltages) + 0.02 * np.abs(voltages).max())
    weighted = jacobian[:, mask] * weight[:, None]
    prior = np.maximum(np.sum(weighted**2, axis=0), 1e-12)
    system = weighted @ (weighted / prior).T
    system += 0.03 * np.trace(system) / len(system) * np.eye(len(system))
    images = np.zeros((*change.shape[:-1], *mask.shape))
    images[..., mask] = np.linalg.solve(system, (weight * change / gain).T).T @ (weighted / prior)
    return images


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if name.startswith("superposed") else name
        for name in RECORDED_SETS
    ],
)
def test_every_set_is_read_and_split(name: str) -> None:
    recording = read(name)
    n, m = len(recording.samples), nominal(name).n_measurements
    assert recording.voltages.shape == (n, m)
    assert recording.reference.shape == (m,)
    assert np.isfinite(recording.voltages).all()
    assert set(recording.samples["split"]) == {"validation", "test"}
    assert recording.samples["touched"].dtype == bool
    if RECORDED_SETS[name].truth == "position":
        assert {"x_m", "y_m"} <= set(recording.samples)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "least"),
    [
        ("ktc2023", 0.99),
        ("sciospec-tank", 0.99),
        ("pyeidors-tank", 0.99),
        ("jku-tank-diagonal", 0.99),
        ("jku-tank-hybrid", 0.99),
        ("jku-tank-opposite", 0.99),
        # Half of this signal is out of phase: see the module's docstring.
        ("jku-tank-adjacent", 0.85),
    ],
)
def test_simulated_reference_agrees_in_order_and_sign(name: str, least: float) -> None:
    voltages, _ = background(name)
    assert np.corrcoef(voltages, read(name).reference)[0, 1] > least


def agreement(name: str, positions: Array, change: Array) -> float:
    """Mean correlation, over values, of the change with a drop of conductivity at `positions`."""
    sensor = nominal(name)
    _, jacobian = background(name)
    x0, y0, _, _ = sensor.outline.bounds
    column, row = np.floor((positions - [x0, y0]) / sensor.pixel_size).astype(int).T
    predicted = -jacobian[:, row, column].T
    change = change - np.median(change, axis=0)
    change = np.clip(change / np.median(np.abs(change), axis=0), -5, 5)
    values = [np.corrcoef(p, c)[0, 1] for p, c in zip(predicted.T, change.T, strict=True)]
    return float(np.mean(values))


@pytest.mark.parametrize(
    ("name", "least"),
    [
        *((name, 0.2) for name in ("ohmc16", "ohmc8", "superpose500")),
        *((f"cam09-{n:02d}", 0.2) for n in (5, 6, 8, 9, 10, 11, 14, 16, 18)),
        ("cam09-12", 0.08),
    ],
)
def test_disc_skins_answer_where_the_robot_presses(name: str, least: float) -> None:
    """The boards' uneven channels hide the homogeneous field, so the changes prove the order."""
    recording = read(name)
    positions = recording.samples[["x_m", "y_m"]].to_numpy()
    change = recording.voltages - recording.reference
    nominal_frame = agreement(name, positions, change)
    mirrored = agreement(name, positions * [1, -1], change)
    opposite = agreement(name, -positions, change)
    assert nominal_frame > least
    assert abs(mirrored) < nominal_frame / 2
    assert opposite < nominal_frame / 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ohmc16", "ohmc8", "superpose500"])
def test_common_mode_explains_the_uneven_channels(name: str) -> None:
    """The one factor of the module's docstring holds for both boards."""
    sensor, reference = nominal(name), read(name).reference
    src, sink, a, b = sensor.pattern.table.T

    def above_sink(electrode: NDArray[np.int64]) -> Array:
        table = DrivePattern(np.column_stack([src, sink, electrode, sink]))
        model = forward_model(replace(sensor, pattern=table))
        return model.voltages(model.background)

    difference = above_sink(a) - above_sink(b)
    common = (above_sink(a) + above_sink(b)) / 2
    assert np.corrcoef(np.abs(difference), reference)[0, 1] < 0.25
    assert np.corrcoef(np.abs(difference - 0.46 * common), reference)[0, 1] > 0.7


def test_the_two_layer_skins_have_differences_and_places_only(recorded_data: Path) -> None:
    folder = recorded_data / "DSHardman/Anisotropy/Shared Code/tests Aleix/CAM09-05"
    with (folder / "inp-CAM09-05.csv").open(encoding="utf-8-sig") as file:
        first = [float(value) for value in file.readline().split(",")]
    with (folder / "out-CAM09-05.csv").open(encoding="utf-8-sig") as file:
        x, y, _ = (float(value) for value in file.readline().split(","))
    recording = read("cam09-05")
    assert recording.modelled_reference
    change = recording.voltages - recording.reference
    np.testing.assert_allclose(change[0], first, atol=1e-9 * recording.reference.max())
    assert recording.samples.loc[0, "x_m"] == pytest.approx(x - 0.0458)
    assert recording.samples.loc[0, "y_m"] == pytest.approx(y + 0.4093)
    assert set(recording.samples) == {"split", "x_m", "y_m", "touched"}  # no load to be judged by


@pytest.mark.parametrize("name", [n for n in RECORDED_SETS if n.startswith("cam09")])
def test_every_two_layer_skin_was_pressed_in_the_middle_of_its_disc(name: str) -> None:
    places = read(name).samples[["x_m", "y_m"]].to_numpy()
    assert len(places) in (2000, 2500)
    np.testing.assert_allclose(np.ptp(places, axis=0), 0.08, atol=2e-3)
    np.testing.assert_allclose(places.max(axis=0) + places.min(axis=0), 0, atol=3e-3)


def test_rectangle_answers_where_the_robot_presses() -> None:
    """Presses beside the electrodes that drive change the frame most, where ours are placed."""
    recording = read("hydrogel-rectangle")
    sensor = nominal("hydrogel-rectangle")
    places = sensor.outline.point([e.centre for e in sensor.electrodes])
    positions = recording.samples[["x_m", "y_m"]].to_numpy()
    change = np.abs(recording.voltages - recording.reference)
    change /= np.median(change, axis=0)
    saturated = recording.reference > 5e4
    for pair in ((2, 6), (3, 7)):
        driven = np.isin(sensor.pattern.table[:, 0], pair) & ~saturated
        strength = np.median(change[:, driven], axis=1)
        distance = np.min([np.hypot(*(positions - places[k]).T) for k in pair], axis=0)
        assert np.median(strength[distance < 0.01]) > 2 * np.median(strength[distance > 0.03])


def test_pressing_hydrogel_is_rebased_on_the_common_reference(recorded_data: Path) -> None:
    recording = read("ohmc16")
    raw = loadmat(recorded_data / "DSHardman/HydrogelEIT/Extracted/ohmc16.mat")
    np.testing.assert_allclose(
        recording.voltages - recording.reference, raw["responsedowns"] - raw["responseups"]
    )
    np.testing.assert_array_equal(recording.reference, np.median(raw["responseups"][::5], axis=0))
    assert set(recording.samples["depth_mm"]) == {10.0, 15.0, 20.0}


@pytest.mark.parametrize(
    ("name", "file"), [("ohmc16", "ohmc16"), ("superpose500", "MultiTouch/superpose500")]
)
def test_the_reference_of_the_start_is_the_first_released_frames(
    name: str, file: str, recorded_data: Path
) -> None:
    """Pressed frames stay as measured; places and splits are those of the renewed reference."""
    own, start = read(name), read(f"{name}-start")
    raw = loadmat(recorded_data / f"DSHardman/HydrogelEIT/Extracted/{file}.mat")
    np.testing.assert_array_equal(start.voltages, raw["responsedowns"])
    first = raw["responseups"][:START_FRAMES]
    np.testing.assert_array_equal(start.reference, np.median(first, axis=0))
    assert start.samples.equals(own.samples)


def test_each_cut_is_a_step_larger_than_any_other() -> None:
    """What upstream's figure shows, and the frames do: three cuts, and slow drift between them."""
    recording = read("hydrogel-damage")
    frames, samples = recording.voltages, recording.samples
    step = np.linalg.norm(np.diff(frames, axis=0), axis=1) / np.linalg.norm(recording.reference)
    # A step leads from the frame before it to its own, and the last one back from the cut.
    during = np.concatenate([np.arange(cut.first - 1, cut.after) for cut in CUTS])
    assert step[during].min() > 0.01
    assert np.delete(step, during).max() < 0.006
    assert samples["time_s"].iloc[-1] == 8 * 831
    assert samples.groupby("cuts").size().to_dict() == {0: 491, 1: 12, 2: 160, 3: 169}


def test_superposed_touches_are_sums_of_test_presses() -> None:
    """Every difference is that of one press or the sum of two, at the places that the row says."""
    single, pairs = read("superpose500"), read("superposed-pairs")
    samples = pairs.samples[pairs.samples["split"] == "test"]
    change = (pairs.voltages - pairs.reference)[samples.index]
    presses = single.samples[single.samples["split"] == "test"]
    of_press = (single.voltages - single.reference)[presses.index]
    row_of = {(x, y): k for k, (x, y) in enumerate(presses[["x_m", "y_m"]].to_numpy().tolist())}
    for row, measured in zip(samples.to_dict("records"), change, strict=True):
        places = [(row["x_m"], row["y_m"]), (row["x2_m"], row["y2_m"])][: row["contacts"]]
        expected = of_press[[row_of[place] for place in places]].sum(axis=0)
        np.testing.assert_allclose(measured, expected, atol=1e-9 * np.abs(pairs.reference).max())
        apart = 1e3 * np.hypot(row["x_m"] - row["x2_m"], row["y_m"] - row["y2_m"])
        if row["contacts"] == 2:
            assert apart == pytest.approx(row["probe_distance_mm"], abs=TOLERANCE_MM)
    assert (samples.groupby("probe_distance_mm").size() == PAIRS).all()
    assert samples.head(10)["probe_distance_mm"].tolist() == [0.0, *DISTANCES_MM]


def test_the_places_of_the_two_probes_agree_with_single_presses() -> None:
    """The single presses nearest to the tips explain a pair better than those elsewhere.

    Elsewhere are the tips turned by 90 degrees. Touches at the centre hardly change by a turn.
    """
    single, pairs = read("superpose500"), read("hydrogel-two-probes")
    places = single.samples[["x_m", "y_m"]].to_numpy()
    change = single.voltages / single.reference - 1
    samples = pairs.samples[pairs.samples["split"] == "test"]
    measured = (pairs.voltages / pairs.reference - 1)[samples.index]
    tips = samples[["x_m", "y_m", "x2_m", "y2_m"]].to_numpy().reshape(-1, 2, 2)
    elsewhere = tips @ np.array([[0.0, 1.0], [-1.0, 0.0]])

    def explained(at: Array) -> Array:
        near = np.linalg.norm(at[:, :, None] - places, axis=-1).argsort(axis=-1)[:, :, :8]
        modelled = change[near].mean(axis=(1, 2))
        norms = np.linalg.norm(modelled, axis=1) * np.linalg.norm(measured, axis=1)
        return np.asarray((modelled * measured).sum(axis=1) / norms)

    off_centre = np.hypot(*tips.mean(axis=1).T) + np.ptp(tips, axis=1).max(axis=1) > 0.03
    assert off_centre.sum() == 16
    assert (explained(tips) > explained(elsewhere))[off_centre].all()


def test_multitouch_keeps_the_probe_distances_and_every_touch_once() -> None:
    """The files hold 26 touches, the last four of A and of B for the second time."""
    recording = read("hydrogel-multitouch")
    counts = recording.samples["probe_distance_mm"].value_counts()
    assert counts.to_dict() == {108.0: 4, 75.0: 4, 20.0: 10}
    assert len(np.unique(recording.voltages, axis=0)) == 18
    # Tips at other places are another state: 4, 4 and 5 turns, those at 20 mm twice.
    states = recording.samples.groupby("probe_distance_mm")["state"].agg(["nunique", "count"])
    assert states.to_numpy().tolist() == [[5, 10], [4, 4], [4, 4]]
    assert recording.samples["state"].nunique() == 13


def test_noise_of_the_fixed_press() -> None:
    _, noise = quality(read("hydrogel-fixed"), nominal("hydrogel-fixed").pattern)
    assert noise == pytest.approx(0.0012, abs=1e-4)


@pytest.mark.parametrize(("name", "lookup"), [("ohmc16", "lookup192"), ("ohmc8", "lookup32")])
def test_the_pattern_of_the_skins_is_upstreams(name: str, lookup: str, recorded_data: Path) -> None:
    """Upstream's table numbers 32 half electrodes."""
    pattern = nominal(name).pattern
    table = loadmat(recorded_data / f"DSHardman/HydrogelEIT/{lookup}.mat")["lookup"]
    np.testing.assert_array_equal(table, pattern.table * (32 // (pattern.table.max() + 1)))


def test_repeats_are_five_of_each_press() -> None:
    samples = read("hydrogel-repeats").samples
    assert (samples.groupby("state").size() == 5).all()
    assert (samples.groupby("state")[["x_m", "y_m", "depth_mm", "split"]].nunique() == 1).all(
        axis=None
    )


def test_levels_of_the_challenge_lack_electrodes() -> None:
    """Exactly the values that the organisers replaced by NaN are left out."""
    folder = fetch_recording(RECORDED_SETS["ktc2023"]).parents[1]
    files = folder / "LJK666666666/EIT_KTC2023_4/KTC2023/EvaluationData/evaluation_datasets"
    whole = nominal("ktc2023").pattern.table
    for level in range(1, 8):
        name = f"ktc2023-level{level}"
        values = loadmat(files / f"level{level}" / "data1.mat")["Uel"].ravel()
        assert (whole[np.isfinite(values)] == nominal(name).pattern.table).all()
        assert nominal(name).n_electrodes == 32
        assert read(name).samples["split"].tolist() == ["validation"] * 4 + ["test"] * 3


def test_levels_are_validated_with_the_training_targets() -> None:
    whole, level = read("ktc2023"), read("ktc2023-level4")
    kept = (nominal("ktc2023").pattern.table >= 6).all(axis=1)
    assert (level.voltages[:4] == whole.voltages[:, kept]).all()
    assert (level.reference == whole.reference[kept]).all()
    assert level.classes is not None
    assert level.classes.shape == (7, 256, 256)
    assert whole.classes is not None
    x = ((np.arange(80) + 0.5) * 256 / 80).astype(int)
    assert (level.classes[:4, x[:, None], x] == whole.classes).all()


@pytest.mark.slow
def test_kuopio_truth_has_our_orientation() -> None:
    """One-step images agree with every truth image, and with no mirrored or turned one as well."""
    recording = read("ktc2023")
    truth = recording.classes
    assert truth is not None
    assert set(np.unique(truth)) == {-1, 0, 1}
    mask = nominal("ktc2023").mask
    images = one_step("ktc2023", recording.voltages - recording.reference)

    def agreement_of(oriented: NDArray[np.int8]) -> list[float]:
        pairs = zip(images, oriented, strict=True)
        return [float(np.corrcoef(image[mask], t[mask])[0, 1]) for image, t in pairs]

    upright = agreement_of(truth)
    assert min(upright) > 0.4
    others = [
        np.rot90(flipped, quarter, axes=(1, 2))
        for flipped in (truth, truth[:, ::-1])
        for quarter in range(4)
    ][1:]
    assert max(np.mean(agreement_of(other)) for other in others) < np.mean(upright) - 0.1


def test_small_tank_shows_its_targets_at_their_electrodes() -> None:
    recording = read("pyeidors-tank")
    sensor = nominal("pyeidors-tank")
    places = 0.65 * sensor.outline.point([e.centre for e in sensor.electrodes])
    x, y = sensor.pixel_centres
    for frame, targets in zip(recording.voltages, recording.samples["targets"], strict=True):
        image = one_step("pyeidors-tank", frame - recording.reference)
        for target in targets.split(", "):
            number, kind = target.split()
            near = np.hypot(x - places[int(number) - 1, 0], y - places[int(number) - 1, 1]) < 0.003
            contrast = float(image[near].mean()) / np.abs(image[sensor.mask]).mean()
            assert contrast > 1 if kind == "metal" else contrast < -1, (targets, target, contrast)


def test_the_older_file_of_the_small_tank_is_readable(recorded_data: Path) -> None:
    name = "2025-11-14-22-18-02_1_10.00_50uA_3000Hz.csv"
    path = recorded_data / "CBZ199671/PyEIDORS/data/measurements/tank" / name
    empty, _ = read_csv(path)
    assert np.corrcoef(empty, read("pyeidors-tank").reference)[0, 1] > 0.98


def test_offset_three_tank_is_reciprocal_and_repeatable() -> None:
    recording = read("sciospec-tank")
    pattern = nominal("sciospec-tank").pattern
    assert reciprocity_error(recording.reference, pattern) < 0.03
    assert (reciprocity_error(recording.voltages, pattern) < 0.05).all()
    empty = ~recording.samples["touched"].to_numpy(dtype=bool)
    assert empty.sum() == 17
    change = np.linalg.norm(recording.voltages - recording.reference, axis=1)
    assert change[empty].max() < change[~empty].min() / 5


@pytest.mark.parametrize("name", [n for n in RECORDED_SETS if n.startswith("jku-tank")])
def test_rectangular_tank_repeats_and_tells_positions_apart(name: str) -> None:
    recording = read(name)
    frames = recording.voltages.reshape(4, 3, -1)
    assert recording.samples["position"].tolist() == list(np.repeat(range(1, 5), 3))
    within = np.linalg.norm(frames - frames.mean(axis=1, keepdims=True), axis=-1).max()
    means = frames.mean(axis=1)
    between = min(np.linalg.norm(means[i] - means[j]) for i in range(4) for j in range(i))
    assert between > within


def test_quality_is_silent_without_repeats() -> None:
    figures = quality(read("ktc2023"), nominal("ktc2023").pattern)
    assert np.isnan(figures).all()


def test_the_presses_of_taros_say_nothing_of_their_places(recorded_data: Path) -> None:
    """Why it is no recorded set: see docs/results/skins.md."""
    path = recorded_data / "DSHardman/HydrogelEIT/Extracted/taros/taros32.mat"
    if not path.is_file():
        pytest.skip("needs taros32.mat of DSHardman/HydrogelEIT in EITBENCH_DATA")
    file = read_arrays(path, "positions", "responsedowns", "responseups")
    change, places = file["responsedowns"] - file["responseups"], file["positions"][:, :2]
    presses = read("cam09-05")
    real = presses.voltages[:315] - presses.reference
    assert left_out(real, presses.samples[["x_m", "y_m"]].to_numpy()[:315]) < 0.25
    assert left_out(change, places) > 0.9

    released = np.median(file["responseups"], axis=0)
    ascending, rotating = (ring_pattern(32, 1, 1, rotating=turn) for turn in (False, True))
    assert agreement_of_reciprocals(released, ascending) > 0.6
    assert abs(agreement_of_reciprocals(released, rotating)) < 0.1


def left_out(change: Array, places: Array) -> float:
    """Error of the places by regression on the others' frames, over the spread of the places."""
    frames = unit_frames(change)
    spread = np.sqrt(np.mean((places - places.mean(axis=0)) ** 2))
    return float(kernel_ridge(frames, places, gaussians(frames)[1:3]).error / spread)


def agreement_of_reciprocals(frame: Array, pattern: DrivePattern) -> float:
    """Correlation of reciprocal values of `frame` (M,), without the pair 28, which is dead."""
    pairs = pattern.reciprocal_pairs()
    pairs = pairs[~(pattern.table[pairs][:, :, [0, 2]] == 28).any(axis=(1, 2))]
    return float(np.corrcoef(*frame[pairs].T)[0, 1])
