"""What is given of a skin: nested labelled presses, none of those that are located."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.pressed_skin import SKIN, pressed_skin, recording, renumbered, rows

from eitbench.scenarios import InputError, load
from eitbench.scenarios.data.transfer import TransferData, load_transfer, split
from eitbench.scenarios.guard import closed_test_split
from eitbench.scenarios.suites.scenario import TransferScenario

HASHES = Path(__file__).parents[3] / "docs" / "studies" / "new-skin" / "splits.csv"


def given(path: str, labelled: int, others: tuple[str, ...] = ()) -> TransferData:
    scenario = TransferScenario(name="new", recording=path, labelled=labelled, others=others)
    return load_transfer(scenario)


def test_no_press_that_is_located_is_given(tmp_path: Path) -> None:
    path = recording(tmp_path / "skin.h5")
    for count in (0, 10, 25):
        data = given(path, count)
        located = rows(data.test.voltages - data.test.references)
        frames = [data.given.labelled.differences, data.given.unlabelled]
        assert not located & rows(np.concatenate([*frames, data.registration.differences]))
        assert (len(data.test), len(data.given.unlabelled)) == (10, 40)
        assert len(data.given.labelled) == count
        assert len(data.registration) == (25 if count == 0 else 0)


def test_labelled_presses_are_nested_and_located_ones_stay(tmp_path: Path) -> None:
    path = recording(tmp_path / "skin.h5")
    none, few, many = (given(path, count) for count in (0, 10, 25))
    assert rows(few.given.labelled.places) <= rows(many.given.labelled.places)
    assert np.array_equal(none.registration.places, many.given.labelled.places)
    assert np.array_equal(none.test.voltages, many.test.voltages)
    hashes = {data.test.data_hash for data in (none, few, many)}
    assert len(hashes) == 3


def test_a_moved_recording_has_the_same_split(tmp_path: Path) -> None:
    path = recording(tmp_path / "skin.h5")
    first = split(path, 50)
    moved = Path(path).rename(tmp_path / "moved.h5")
    assert split(str(moved), 50).sha256 == first.sha256
    assert sorted([*first.test, *first.pool]) == list(range(50))


def test_a_skin_that_is_recorded_again_is_read_again(tmp_path: Path) -> None:
    path = recording(tmp_path / "skin.h5")
    before = given(path, 10)
    Path(recording(tmp_path / "longer.h5", 60)).rename(path)
    after = given(path, 10)
    assert (len(before.test), len(after.test)) == (10, 12)
    assert len(after.given.unlabelled) == 48


def test_places_of_other_skins_lie_electrode_on_electrode(tmp_path: Path) -> None:
    """The same skin with its electrodes numbered from the opposite corner, as a mirror image."""
    path = recording(tmp_path / "skin.h5")
    turned = renumbered(SKIN, (np.arange(16) + 8) % 16)
    other = recording(tmp_path / "other.h5", 20, turned)
    data = given(path, 0, others=(other,))
    (placed,) = data.given.others.values()
    x0, y0, x1, y1 = SKIN.outline.bounds
    own = pressed_skin(20, skin=turned)[2].to_numpy()
    expected = np.array([x0 + x1, y0 + y1]) - own  # turned by half a turn
    np.testing.assert_allclose(placed.places, expected, atol=1e-9)


def test_a_copy_of_a_skin_is_no_other_skin(tmp_path: Path) -> None:
    path = Path(recording(tmp_path / "skin.h5"))
    copy = tmp_path / "copy.h5"
    copy.write_bytes(path.read_bytes())
    with pytest.raises(InputError, match=r"skin\.h5' and .*copy\.h5' hold the same file"):
        given(str(path), 0, others=(str(copy),))


def test_what_cannot_be_is_said(tmp_path: Path) -> None:
    path = recording(tmp_path / "skin.h5")
    with pytest.raises(InputError, match=r"needs 41 presses to learn from, and .* has 40 beside"):
        given(path, 41)
    several = recording(tmp_path / "two.h5", 40, SKIN, {"touch": 3, "x_m": 0.05, "y_m": 0.05})
    with pytest.raises(InputError, match="touches of several contacts"):
        given(several, 10)
    shuffled = renumbered(SKIN, np.random.default_rng(0).permutation(16))
    wrong = recording(tmp_path / "shuffled.h5", 20, shuffled)
    for other in ("ohmc8", wrong):
        with pytest.raises(InputError, match="are not those of 'bench'"):
            given(path, 0, others=(other,))
    scenario = TransferScenario(name="new", recording=path, labelled=0)
    with pytest.raises(InputError, match="has no splits of its own"):
        load(scenario)
    with closed_test_split(), pytest.raises(InputError, match="test split is closed"):
        load_transfer(scenario)


def test_the_splits_are_those_of_the_record() -> None:
    stored = pd.read_csv(HASHES)
    assert len(stored) == 13
    for row in stored.to_dict("records"):
        found = split(row["recording"], row["presses"])
        assert len(found.test) == row["located"]
        assert found.sha256 == row["sha256"]
