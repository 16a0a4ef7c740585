"""The command `eitbench choose`: what it prints and writes, and its sentences on bad input."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from tests.support.choices import made_choice

from eitbench.benchmark.choice import measure
from eitbench.benchmark.choice.decision import Choice


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What the command asks for; it gets a choice that was made before."""
    found: list[dict[str, Any]] = []

    def choose(name: str, out: Path, **options: Any) -> Choice:
        found.append({"name": name, "out": out} | options)
        return made_choice(unusable={"dnn": "It has no weights."}, note="Frames are left out.")

    monkeypatch.setattr(measure, "choose", choose)
    return found


def test_it_prints_the_sentence_and_the_table_and_writes_both(
    eitbench: Any, tmp_path: Path, asked: list[dict[str, Any]]
) -> None:
    out = tmp_path / "out"
    code, said, err = eitbench("choose", "foam16", "--methods", "noser, greit", "--out", out)
    assert (code, err) == (0, "eitbench: Frames are left out.\n")
    assert said.startswith("Put `noser` behind foam16: ")
    assert "Not usable here, or failed (choice.json says why): dnn" in said
    (options,) = asked
    del options["progress"]
    assert options == {
        "name": "foam16", "out": out, "frame_rate": 10.0, "time_limit_s": 300.0,
        "methods": ["noser", "greit"],
    }  # fmt: skip
    choice = Choice.model_validate_json((out / "choice.json").read_text())
    assert choice.answer == said.splitlines()[0]
    rows = list(csv.DictReader((out / "choice.csv").read_text().splitlines()))
    assert [row["method"] for row in rows] == ["noser", "greit"]
    assert [float(row["place_value"]) for row in rows] == [5.0, 8.0]
    assert rows[0]["parameters_weight"] == "0.5"


def test_json_is_the_file(eitbench: Any, tmp_path: Path, asked: list[dict[str, Any]]) -> None:
    code, said, _ = eitbench("choose", "foam16", "--json", "--out", tmp_path / "out")
    assert code == 0
    assert json.loads(said) == json.loads((tmp_path / "out" / "choice.json").read_text())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["omc16"], "did you mean 'ohmc16'"),
        (["mine.toml"], "Cannot read the sensor file mine.toml"),
        (["mine.h5"], "Cannot read the recording mine.h5"),
        (["foam16", "--time-limit", "0"], "number of seconds above 0, got 0"),
        (["foam16", "--time-limit", "-5"], "number of seconds above 0, got -5"),
        (["foam16", "--frame-rate", "0"], "number of frames/s above 0, got 0"),
        (["foam16", "--methods", "tank-unet"], "No method can be used on sensor 'foam16'"),
    ],
)
def test_what_cannot_be_is_one_sentence(
    eitbench: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, said, err = eitbench("choose", *arguments)
    assert (code, said) == (2, "")
    assert sentence in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())
