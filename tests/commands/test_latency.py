"""The command `eitbench latency`: what it prints and writes, and its sentences on bad input."""

import json
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from eitbench.cli import app
from eitbench.scenarios.errors import InputError


@pytest.mark.slow
def test_latency_prints_and_writes_the_same_figures(tmp_path: Path) -> None:
    arguments = ["latency", "ohmc8", "--snr", "60", "--methods", "noser,greit", "--touches", "2"]
    result = CliRunner().invoke(app, [*arguments, "--json", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    about = json.loads(result.output)
    assert about == json.loads((tmp_path / "latency.json").read_text())
    assert about["processor"]
    table = pd.read_csv(tmp_path / "latency.csv")
    assert table["method"].tolist() == ["noser"] * 6 + ["greit"] * 6
    assert table["missed"].tolist() == [row["missed"] for row in about["methods"]]
    touches = pd.read_csv(tmp_path / "touches.csv")
    assert len(touches) == 2 * 2 * 6
    assert {path.name for path in tmp_path.iterdir()} == {
        "latency.csv", "latency.json", "latency.pdf", "latency.png", "touches.csv"
    }  # fmt: skip
    printed = CliRunner().invoke(app, [*arguments, "--touches", "1"])
    assert printed.exit_code == 0
    assert "touch [kPa]" in printed.output
    assert about["processor"] in printed.output


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["foam16"], "for example `--snr 60`"),
        (["foam61", "--snr", "60"], "did you mean 'foam16'"),
        (["foam16", "--snr", "60", "--methods", "linear-touch"], "cannot be used live"),
        (["foam16", "--snr", "60", "--radius", "60"], "no room for a touch of radius 60 mm"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(
    arguments: list[str], sentence: str, tmp_path: Path
) -> None:
    result = CliRunner().invoke(app, ["latency", *arguments, "--out", str(tmp_path)])
    assert isinstance(result.exception, InputError)
    assert sentence in str(result.exception)
    assert not list(tmp_path.iterdir())
