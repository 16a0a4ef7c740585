"""The ladder's table and figure, from a run of the real thing on a coarse grid."""

from pathlib import Path

import pandas as pd
import pytest

from eitbench import cli

SUITE = """
name = "tiny-ladder"
title = "A ladder on a coarse grid"
methods = ["tikhonov", "back-projection"]
{scenarios}
"""
SCENARIO = """
[[scenarios]]
kind = "simulated"
name = "tiny-{name}"
image_shape = [16, 16]
families = ["circle"]
noise = {{ validation = 50, test = {noise} }}
train = 0
validation = 4
test = 12
phantoms = "tiny"
{calibrated}
[scenarios.imperfections]
{imperfections}
"""
RUNGS = {
    "ideal": ("", '"clean"'),
    "shift": ("electrode_shift_m = 0.002", '"clean"'),
    "mild": ("electrode_shift_m = 0.001\nsettling = 0.01\nseverity = 0.0", "60"),
    "typical": ("electrode_shift_m = 0.001\nsettling = 0.01", "60"),
    "severe": ("electrode_shift_m = 0.001\nsettling = 0.01\nseverity = 3.0", "60"),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ladder")
    text = "".join(
        SCENARIO.format(
            name=name + ("-calibrated" if calibrated else ""),
            noise=noise,
            imperfections=imperfections,
            calibrated="calibrated = true" if calibrated else "",
        )
        for name, (imperfections, noise) in RUNGS.items()
        for calibrated in (False, True)
    )
    (folder / "tiny.toml").write_text(SUITE.format(scenarios=text))
    with pytest.MonkeyPatch.context() as patch:
        words = ["eitbench", "run", str(folder / "tiny.toml"), "--out", str(folder / "run")]
        patch.setattr("sys.argv", words)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 0
    return folder / "run"


def test_a_run_with_a_ladder_gets_its_table_and_figure(run: Path) -> None:
    for name in ("ladder.md", "ladder.csv", "figures/ladder.png", "figures/ladder.pdf"):
        assert (run / name).stat().st_size > 500, name
    text = (run / "ladder.md").read_text()
    lines = text.splitlines()
    assert lines[0].startswith("| rung |")
    assert [line.split("|")[1].strip() for line in lines[2:9]] == [
        "ideal", "shift", "mild (severity 0)", "typical (severity 1)", "severe (severity 3)",
        "area over severity", "area, calibrated",
    ]  # fmt: skip


def test_figures_fall_along_the_ladder_and_calibration_wins_where_electrodes_moved(
    run: Path,
) -> None:
    table = pd.read_csv(run / "ladder.csv").set_index(["rung", "method"])
    value, gain = table["value"], table["gain"]
    assert value["tiny-severe", "tikhonov"] < value["tiny-ideal", "tikhonov"]
    assert gain["tiny-shift", "tikhonov"] > 0
    assert table["gain_low"]["tiny-shift", "tikhonov"] > 0
    assert value["area", "tikhonov"] == pytest.approx(
        (
            0.5 * (value["tiny-mild", "tikhonov"] + value["tiny-typical", "tikhonov"])
            + (value["tiny-typical", "tikhonov"] + value["tiny-severe", "tikhonov"])
        )
        / 3,
        abs=1e-5,
    )


def test_calibrated_rows_say_so(run: Path) -> None:
    cells = pd.read_parquet(run / "methods.parquet").set_index("scenario")
    assert set(cells["track"]["tiny-shift-calibrated"]) == {"calibrated"}
    assert "calibrated" not in set(cells["track"]["tiny-shift"])
