"""Touches with a reference each, and sets of differences: read on one reference, in any order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.benchmark.metrics.evaluation import GroundTruth, evaluate, fit_registration
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording.exchange import (
    export_recording,
    import_recording,
    write_recording,
)
from eitbench.methods import Problem, methods
from eitbench.methods.problem import no_split
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.differences import TYPICAL_CHANGE
from eitbench.scenarios.recordings.fetch import read_recording, reference_frames
from eitbench.scenarios.recordings.files.own import frames_of_touches
from eitbench.scenarios.recordings.files.pairs import alternating, from_differences, from_pairs
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.recordings.quality import check, quality


def test_every_touch_is_re_based_on_its_own_reference() -> None:
    released, pressed, places = pressed_skin(6, drift=0.3)
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
    """Median error of the places that `back-projection` finds."""
    recording, nominal = frames_of_touches(content), content.sensor
    method = methods()["back-projection"]()
    method.fit(Problem(nominal, recording.reference, no_split))
    images = method.reconstruct(recording.voltages)
    samples = recording.samples.assign(sample=np.arange(len(images)))
    truth = GroundTruth("bench", nominal, samples, "position")
    registration = fit_registration(truth, images)
    return float(evaluate(truth, images, registration)["localisation_mm"].median())


def with_one_reference(pairs: Content) -> Content:
    """The same touches, all against the first released frame."""
    labels = pairs.labels.assign(reference_first=-1, reference_last=-1)
    return replace(pairs, reference=np.array([0]), labels=labels)


def test_on_a_drifting_skin_a_reference_a_touch_finds_the_places() -> None:
    released, pressed, places = pressed_skin(25, drift=2.0)
    own = from_pairs(released, pressed, SKIN, "fake", places)
    each = place_error_mm(own)
    assert place_error_mm(with_one_reference(own)) > 3 * each
    differences = from_differences(pressed - released, SKIN, "fake", places)
    assert place_error_mm(differences) == pytest.approx(each, rel=0.1)


def test_on_a_real_hydrogel_a_reference_a_touch_finds_the_places(recorded_data: Path) -> None:
    """500 presses in places of which a guess is 49 mm away (median)."""
    path = recorded_data / "DSHardman/HydrogelEIT/Extracted/MultiTouch/superpose500.mat"
    file = read_arrays(path, "positions", "responsedowns", "responseups")
    places = pd.DataFrame(file["positions"][:, :2], columns=["x_m", "y_m"])
    frames = file["responseups"], file["responsedowns"]
    own = from_pairs(*frames, sensor("ohmc16"), "robot", places)
    assert place_error_mm(with_one_reference(own)) > 30
    assert place_error_mm(own) < 15


def test_differences_are_put_on_the_model_and_say_so(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(6, drift=0.3)
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
    with pytest.raises(InputError, match="no frame shows the untouched sensor"):
        Replay(path)
    for ending in (".csv", ".mat"):
        export_recording(path, tmp_path / f"touch{ending}")
        import_recording([str(tmp_path / f"touch{ending}")], tmp_path / f"again{ending}.h5")
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
        with pytest.raises(
            DataCorruptError, match="a label or the reference names frames that are not there"
        ):
            recorded_set(str(path))
        assert any("Label 1 names reference frames" in problem for problem in check(path)[0])


@pytest.mark.parametrize(
    ("contacts", "says"),
    [
        ({"touch": [0] * 11 + [1]}, "touch 0 has 11 contacts, and at most 10 are possible"),
        ({"force_N": [1.0, -2.0]}, "label 1 has -2 N, and a force or pressure is 0 or more"),
        ({"pressure_Pa": [np.inf, 1.0]}, "label 0 has inf Pa, and a force or pressure is"),
    ],
)
def test_labels_that_no_touch_can_have_are_told(
    tmp_path: Path, contacts: dict[str, list[float]], says: str
) -> None:
    frames, path = pressed_skin(2)[0], tmp_path / "a.h5"
    write_recording(from_pairs(frames, frames, SKIN, "fake", pd.DataFrame(contacts)), path)
    with pytest.raises(DataCorruptError, match=says):
        recorded_set(str(path))
    assert any(says[1:] in problem for problem in check(path)[0])
