"""The command `eitbench ceiling`: what it prints and writes, and what it refuses."""

import json
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from eitbench.benchmark.ceiling import sampler
from eitbench.cli import app
from eitbench.commands.console import names_in
from eitbench.scenarios.errors import InputError

SUITE = """
name = "few"
title = "Few"
methods = ["noser"]
[[scenarios]]
kind = "simulated"
name = "few"
image_shape = [24, 24]
families = ["circle"]
noise = { test = 25 }
train = 0
validation = 2
test = 4
"""


def test_a_name_counts_once() -> None:
    assert names_in("--scenarios", "b, a,b") == ["b", "a"]


@pytest.mark.slow
def test_ceiling_prints_and_writes_the_same_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four samples are a session and a part of one."""
    monkeypatch.setattr(sampler, "PARTICLES", 6)
    suite, out = tmp_path / "few.toml", tmp_path / "out"
    suite.write_text(SUITE)
    arguments = ["ceiling", str(suite), "--samples", "10", "--out", str(out)]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)
    frames = pd.read_csv(out / "few.csv")
    assert list(frames["sample"]) == [0, 1, 2, 3]
    assert row["psnr"] == pytest.approx(frames["psnr"].mean(), rel=1e-4)
    assert frames["likely_circle"].tolist() == [1, 1, 1, 1]
    about = json.loads((out / "few.json").read_text())
    assert about["command"] == "eitbench ceiling few --scenarios few --samples 10 --out DIR"
    again = CliRunner().invoke(app, arguments)
    assert again.exit_code == 0
    assert f"{row['psnr']:.2f}" in again.output


@pytest.mark.parametrize(
    ("scenarios", "why"),
    [("few,nosuch", "Unknown scenario 'nosuch'"), (None, "The noise of scenario 'few' is 0.0")],
)
def test_ceiling_refuses_and_writes_nothing(
    tmp_path: Path, scenarios: str | None, why: str
) -> None:
    suite, out = tmp_path / "few.toml", tmp_path / "out"
    suite.write_text(SUITE.replace("test = 25", "test = 0"))
    chosen = ["--scenarios", scenarios] if scenarios else []
    result = CliRunner().invoke(app, ["ceiling", str(suite), "--out", str(out), *chosen])
    assert isinstance(result.exception, InputError)
    assert why in str(result.exception)
    assert not out.exists()


def test_a_file_in_the_place_of_the_folder_is_named(tmp_path: Path) -> None:
    suite, out = tmp_path / "few.toml", tmp_path / "out"
    suite.write_text(SUITE)
    out.write_text("mine")
    result = CliRunner().invoke(app, ["ceiling", str(suite), "--out", str(out)])
    assert isinstance(result.exception, InputError)
    assert "out is a file: name a folder with --out" in str(result.exception)
    out.unlink()
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    result = CliRunner().invoke(app, ["ceiling", str(suite), "--out", str(out)])
    assert "out holds other things than draws: name another folder" in str(result.exception)
    assert [path.name for path in out.iterdir()] == ["notes.txt"]
