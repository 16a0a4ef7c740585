"""Touches with a reference each, and sets of differences: read on one reference, in any order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import no_split

from eitbench.benchmark.metrics.evaluation import GroundTruth, evaluate, fit_registration
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording.exchange import (
    export_recording,
    import_recording,
    write_recording,
)
from eitbench.methods import Problem, methods
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording, reference_frames
from eitbench.scenarios.recordings.files.own import TYPICAL_CHANGE, frames_of_touches
from eitbench.scenarios.recordings.files.pairs import alternating, from_differences, from_pairs
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.recordings.quality import check, quality

Array = NDArray[np.float64]
SKIN = replace(sensor("foam16"), name="bench", image_shape=(24, 24))


def measured(n: int, drift: float = 0.3) -> tuple[Array, Array, pd.DataFrame]:
    """Released and pressed frames (n, M) of a skin that drifts, and where it was pressed."""
    model, draws = forward_model(SKIN), np.random.default_rng(4)
    x, y = SKIN.pixel_centres
    places = draws.uniform(0.02, 0.08, size=(n, 2))
    away = np.hypot(x - places[:, :1, None], y - places[:, 1:, None])
    pressed = model.background * FOAM.pressed(40e3, np.maximum(away - 0.005, 0))
    # A warm corner wanders through the skin, as on the hydrogels: no gain removes it.
    warm = 1 + drift * np.linspace(0, 1, n)[:, None, None] * (x > 0.05) * (y > 0.05)
    frames = model.voltages(np.concatenate([warm * model.background, warm * pressed]))
    return frames[:n], frames[n:], pd.DataFrame(places, columns=["x_m", "y_m"])


def test_every_touch_is_re_based_on_its_own_reference() -> None:
    released, pressed, places = measured(6)
    content = from_pairs(released, pressed, SKIN, "fake", places, "from elsewhere")
    assert content.events["text"].tolist()[1:] == ["from elsewhere"]
    recording = frames_of_touches(content)
    np.testing.assert_allclose(recording.reference, np.median(released[[0, 5]], axis=0))
    np.testing.assert_allclose(recording.voltages - recording.reference, pressed - released)
    np.testing.assert_array_equal(recording.samples[["x_m", "y_m"]], places)
    # A common reference is taken where there is one; touches without a reference rest on it.
    labels = content.labels.copy()
    labels.loc[3, ["reference_first", "reference_last"]] = -1
    both = frames_of_touches(replace(content, reference=np.array([0]), labels=labels))
    np.testing.assert_array_equal(both.reference, released[0])
    np.testing.assert_array_equal(both.voltages[3], pressed[3])
    change = both.voltages[4] - both.reference
    np.testing.assert_allclose(change, pressed[4] - released[4], atol=1e-12)


def place_error_mm(content: Content) -> float:
    """Median error of the places that `noser` finds."""
    recording = frames_of_touches(content)
    method = methods()["noser"]()
    method.fit(Problem(SKIN, recording.reference, no_split))
    images = method.reconstruct(recording.voltages)
    samples = recording.samples.assign(sample=np.arange(len(images)))
    truth = GroundTruth("bench", SKIN, samples, "position")
    registration = fit_registration(truth, images)
    return float(evaluate(truth, images, registration)["localisation_mm"].median())


def test_on_a_drifting_skin_a_reference_a_touch_finds_the_places() -> None:
    released, pressed, places = measured(25)
    own = from_pairs(released, pressed, SKIN, "fake", places)
    unmarked = own.labels.assign(reference_first=-1, reference_last=-1)
    common = place_error_mm(replace(own, reference=np.array([0]), labels=unmarked))
    each = place_error_mm(own)
    assert common > 3 * each
    differences = from_differences(pressed - released, SKIN, "fake", places)
    assert place_error_mm(differences) == pytest.approx(each, rel=0.1)


def test_differences_are_put_on_the_model_and_say_so(tmp_path: Path) -> None:
    released, pressed, places = measured(6)
    content = from_differences(1e3 * (pressed - released), SKIN, "fake", places)
    recording = frames_of_touches(content)
    model = forward_model(SKIN)
    gain = recording.reference / model.voltages(model.background)
    np.testing.assert_allclose(gain, gain[0])
    change = recording.voltages - recording.reference
    np.testing.assert_allclose(change, 1e3 * (pressed - released), atol=1e-9 * gain[0])
    validation = np.linalg.norm(change[[0, 5]], axis=1) / np.linalg.norm(recording.reference)
    assert np.median(validation) == pytest.approx(TYPICAL_CHANGE)

    path = tmp_path / "touch.h5"
    write_recording(content, path)
    assert recorded_set(str(path)).title == (
        "own recording with the board fake, touches: 6, differences only: the reference is modelled"
    )
    assert np.isnan(quality(read_recording(str(path)), SKIN.pattern)).all()
    with pytest.raises(InputError, match="no frame shows the untouched sensor"):
        reference_frames(str(path))
    with pytest.raises(InputError, match="differences, which no board measures"):
        Replay(path)
    for ending in (".csv", ".mat"):
        export_recording(path, tmp_path / f"touch{ending}")
        import_recording(str(tmp_path / f"touch{ending}"), tmp_path / f"again{ending}.h5")
        again = read_recording(str(tmp_path / f"again{ending}.h5"))
        np.testing.assert_array_equal(again.voltages, recording.voltages)


def test_differences_of_nothing_keep_the_scale_of_the_model() -> None:
    recording = frames_of_touches(from_differences(np.zeros((3, 208)), SKIN, "fake"))
    model = forward_model(SKIN)
    np.testing.assert_array_equal(recording.reference, model.voltages(model.background))


def test_contacts_of_one_touch_are_one_sample() -> None:
    frames = np.ones((3, 208))
    contacts = pd.DataFrame(
        {
            "touch": [0, 0, 1, 2],
            "x_m": [0.02, 0.07, 0.03, 0.04],
            "y_m": 0.05,
            "force_N": [1.0, 2.0, 4.0, np.nan],
            "pressure_Pa": [1e3, 2e3, 3e3, np.nan],
        }
    )
    samples = frames_of_touches(from_pairs(frames, frames, SKIN, "fake", contacts)).samples
    assert samples["contacts"].tolist() == [2, 1, 1]
    assert samples["x2_m"].tolist()[0] == 0.07
    np.testing.assert_array_equal(samples["force_N"], [3.0, 4.0, np.nan])
    np.testing.assert_array_equal(samples["pressure_pa"], [np.nan, 3e3, np.nan])
    alone = frames_of_touches(from_pairs(frames, frames, SKIN, "fake", contacts[["x_m"]][:3]))
    assert not {"contacts", "force_N", "pressure_pa", "x2_m"} & set(alone.samples)


def test_pairs_that_do_not_fit_are_one_sentence(tmp_path: Path) -> None:
    frames = np.arange(6 * 208.0).reshape(6, 208)
    released, pressed = alternating(frames)
    np.testing.assert_array_equal(pressed, frames[[1, 3, 5]])
    with pytest.raises(InputError, match="there are 5 frames: an even number is needed"):
        alternating(frames[:5])
    with pytest.raises(InputError, match="as many released frames as pressed ones, got 3 and 2"):
        from_pairs(released, pressed[:2], SKIN, "fake")
    places = pd.DataFrame({"x_m": [0.01, 0.02]})
    with pytest.raises(InputError, match="3 touches in the frames and 2 in their labels"):
        from_pairs(released, pressed, SKIN, "fake", places)
    with pytest.raises(InputError, match="3 touches in the frames and 2 in their labels"):
        from_differences(pressed, SKIN, "fake", places)
    content = from_pairs(released, pressed, SKIN, "fake")
    for column, row in (("reference_first", 9), ("reference_last", -1), ("reference_last", 0)):
        wrong = content.labels.copy()
        wrong.loc[1, column] = row
        path = tmp_path / f"{column}{row}.h5"
        write_recording(replace(content, labels=wrong), path)
        with pytest.raises(DataCorruptError, match="a label or the reference lies outside"):
            recorded_set(str(path))
        assert any("Label 1 names reference frames" in problem for problem in check(path)[0])
