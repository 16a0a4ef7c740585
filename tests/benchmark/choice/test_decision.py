"""The rule that picks the best method, and the file of a choice."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from tests.support.choices import made_choice

from eitbench.benchmark.choice.decision import Choice, Pick, pick, read_choice
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import foam16

SESSIONS = np.repeat(np.arange(20), 3)


def errors(**shifts: float) -> pd.DataFrame:
    """Errors [mm] of 60 frames: 10 mm and a shift, each with a noise of its own of 1 mm."""
    rng = np.random.default_rng(0)
    columns = {name: 10 + by + rng.normal(size=60) for name, by in shifts.items()}
    return pd.DataFrame(columns, index=SESSIONS)


def test_the_smallest_error_wins_where_it_can_be_told() -> None:
    assert pick(errors(sharp=0, blurred=5), {"sharp": 50, "blurred": 0.1}) == Pick(method="sharp")


def test_of_equals_the_faster_is_taken() -> None:
    table = errors(sharp=0, equal=0.1, blurred=5)
    assert table.median().idxmin() == "sharp"
    found = pick(table, {"sharp": 50, "equal": 2, "blurred": 0.1})
    assert found == Pick(method="equal", not_told_from=("sharp",))


def test_of_equals_that_are_about_as_fast_the_one_of_the_smaller_error_is_taken() -> None:
    """Times differ from run to run, and with them the choice would."""
    table = errors(sharp=0, equal=0.1)
    for times in ({"sharp": 1.2, "equal": 1.0}, {"sharp": 1.0, "equal": 1.2}):
        assert pick(table, times) == Pick(method="sharp", not_told_from=("equal",))


@pytest.mark.parametrize(("gain", "told"), [(0.62, True), (0.35, False)])
def test_a_difference_is_told_at_5_percent(gain: float, told: bool) -> None:
    rng = np.random.default_rng(4)
    noise = rng.normal(size=20)
    difference = gain + (noise - noise.mean()) / noise.std()
    p = stats.wilcoxon(difference).pvalue
    assert 0.01 < p < 0.05 if told else 0.05 < p < 0.2
    base = 10 + 5 * rng.normal(size=20)
    table = pd.DataFrame({"a": base, "b": base + difference}, index=np.arange(20))
    found = pick(table, {"a": 50.0, "b": 1.0})
    assert found == (Pick(method="a") if told else Pick(method="b", not_told_from=("a",)))


def test_differences_are_counted_by_session() -> None:
    """Frames of a session repeat one another: sixty of ten sessions are ten differences."""
    rng = np.random.default_rng(1)
    base = 10 + rng.normal(size=60)
    by_session = np.repeat([1.0, 1.0, -0.5, 1.0, -0.5, 1.0, -0.5, 1.0, -0.5, 1.0], 6)
    table = pd.DataFrame({"a": base, "b": base + by_session})
    times = {"a": 50.0, "b": 1.0}
    assert pick(table.set_axis(np.arange(60)), times) == Pick(method="a")
    together = pick(table.set_axis(np.repeat(np.arange(10), 6)), times)
    assert together == Pick(method="b", not_told_from=("a",))


def test_nothing_is_picked_of_nothing() -> None:
    assert pick(errors(a=0)[[]], {}) is None


def test_a_choice_is_read_as_it_was_written(choice_file: Callable[..., Path]) -> None:
    name, parameters = read_choice(choice_file(), foam16())
    assert (name, parameters) == ("noser", {"noser": {"weight": 0.5}, "greit": {}})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"best": None}, "names no method"),
        ({"best": {"method": "tv", "not_told_from": []}}, "did not try 'tv'"),
        ({"format": "eitbench choice 9"}, "damaged at 'format'"),
        ({"frame_rate": "fast"}, "damaged at 'frame_rate'"),
        ({"more": 1}, "damaged at 'more'"),
        ({"tried": []}, "damaged at 'tried'"),
    ],
)
def test_a_choice_that_cannot_be_used_is_one_sentence(
    choice_file: Callable[..., Path], changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as error:
        read_choice(choice_file(**changes), foam16())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[1]", b"[" * 100_000])
def test_what_is_no_choice_is_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "choice.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match="is damaged") as error:
        read_choice(path, foam16())
    assert "\n" not in str(error.value)


def test_a_choice_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Cannot read the choice"):
        read_choice(tmp_path / "choice.json", foam16())


def test_a_choice_of_an_unknown_method_or_parameter_is_refused(
    choice_file: Callable[..., Path],
) -> None:
    path = choice_file()
    for old, new, sentence in (
        ('"noser"', '"nose"', "did you mean 'noser'"),
        ('"weight"', '"height"', "cannot be made with"),
    ):
        path.write_text(choice_file().read_text().replace(old, new))
        with pytest.raises(InputError, match=sentence):
            read_choice(path, foam16())


def test_the_whole_sensor_counts_and_not_its_name(choice_file: Callable[..., Path]) -> None:
    sensor = foam16()
    assert read_choice(choice_file(), replace(sensor, name="mine"))[0] == "noser"
    with pytest.raises(InputError, match="which is not the board's, 'foam16'"):
        read_choice(choice_file(), replace(sensor, background=2.0))


@pytest.fixture
def choice_file(tmp_path: Path) -> Callable[..., Path]:
    def write(**changes: object) -> Path:
        path = tmp_path / "choice.json"
        path.write_text(json.dumps(made_choice().model_dump(mode="json") | changes))
        return path

    return write


def test_the_made_choice_is_one() -> None:
    assert Choice.model_validate_json(made_choice().model_dump_json()) == made_choice()
