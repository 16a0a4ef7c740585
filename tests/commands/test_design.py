"""The command `eitbench design`: what it prints and writes, and its sentence without noise."""

import json
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from eitbench.cli import app
from eitbench.scenarios.errors import InputError


@pytest.mark.slow
def test_design_prints_and_writes_the_same_figures(tmp_path: Path) -> None:
    arguments = ["design", "ohmc8", "--snr", "60", "--compare", "own,offset=1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--radius", "10", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    about = json.loads(result.output)
    assert about == json.loads((tmp_path / "design.json").read_text())
    table = pd.read_csv(tmp_path / "designs.csv")
    assert table["place_mm"].tolist() == pytest.approx(
        [row["place_mm"] for row in about["designs"]], rel=1e-4
    )
    assert about["best"] == table["design"].iloc[table["place_mm"].argmin()]
    places = pd.read_csv(tmp_path / "places.csv")
    assert set(places["design"]) == set(table["design"])
    assert {path.name for path in tmp_path.iterdir()} == {
        "design.json", "design.pdf", "design.png", "designs.csv", "places.csv"
    }  # fmt: skip


def test_design_without_noise_says_what_to_give(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["design", "foam16", "--out", str(tmp_path)])
    assert isinstance(result.exception, InputError)
    assert "--snr 60" in str(result.exception)
    assert not list(tmp_path.iterdir())
