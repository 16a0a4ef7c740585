"""The ladder's table and figure, from a run of the real thing on a coarse grid."""

from pathlib import Path

import pandas as pd
import pytest

from eitbench import cli
from eitbench.benchmark.findings.ladder import Ladder, Real, Step
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.findings.ladder import draw, grid

SUITE = """
name = "tiny-ladder"
title = "A ladder on a coarse grid"
methods = ["tikhonov"]
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
test = 60
phantoms = "tiny"
ladder = true
{calibrated}
[scenarios.imperfections]
{imperfections}
"""
RUNGS = {
    "ideal": ("", '"clean"', False),
    "shift": ("electrode_shift_m = 0.002", '"clean"', False),
    "shift-calibrated": ("electrode_shift_m = 0.002", '"clean"', True),
    "mild": ("electrode_shift_m = 0.001\nsettling = 0.01\nseverity = 0.0", "60", False),
    "typical": ("electrode_shift_m = 0.001\nsettling = 0.01", "60", False),
    "severe": ("electrode_shift_m = 0.001\nsettling = 0.01\nseverity = 3.0", "60", False),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ladder")
    scenarios = [
        SCENARIO.format(
            name=name,
            noise=noise,
            imperfections=imperfections,
            calibrated="calibrated = true" if calibrated else "",
        )
        for name, (imperfections, noise, calibrated) in RUNGS.items()
    ]
    (folder / "tiny.toml").write_text(SUITE + "".join(scenarios))
    with pytest.MonkeyPatch.context() as patch:
        words = ["eitbench", "run", str(folder / "tiny.toml"), "--out", str(folder / "run")]
        patch.setattr("sys.argv", words)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 0
    return folder / "run"


@pytest.mark.slow
def test_a_run_with_a_ladder_gets_its_table_and_figure(run: Path) -> None:
    for name in ("ladder.md", "ladder.csv", "figures/ladder.png", "figures/ladder.pdf"):
        assert (run / name).stat().st_size > 500, name
    lines = (run / "ladder.md").read_text().splitlines()
    assert lines[0].startswith("| rung |")
    assert [line.split("|")[1].strip() for line in lines[2:8]] == [
        "ideal", "shift", "mild (severity 0)", "typical (severity 1)", "severe (severity 3)",
        "area over severity",
    ]  # fmt: skip


@pytest.mark.slow
def test_figures_fall_along_the_ladder_and_calibration_wins_where_electrodes_moved(
    run: Path,
) -> None:
    table = pd.read_csv(run / "ladder.csv").set_index("rung")
    value, gain = table["value"], table["gain"]
    assert value["tiny-severe"] < value["tiny-ideal"]
    assert gain["tiny-shift"] > 0
    assert table["gain_low"]["tiny-shift"] > 0
    mild, typical, severe = (value[f"tiny-{name}"] for name in ("mild", "typical", "severe"))
    assert value["area"] == pytest.approx(
        (0.5 * (mild + typical) + (typical + severe)) / 3, abs=1e-5
    )


@pytest.mark.slow
def test_calibrated_rows_say_so(run: Path) -> None:
    cells = pd.read_parquet(run / "methods.parquet").set_index("scenario")
    assert cells["track"]["tiny-shift-calibrated"] == "calibrated"
    assert cells["track"]["tiny-shift"] != "calibrated"


def test_calibrated_areas_and_real_sets_stand_below_the_rungs() -> None:
    value, gain = Interval(0.5, 0.4, 0.6), Interval(0.1, 0.05, 0.15)
    ladder = Ladder(
        rungs=("a", "b"),
        methods=("good", "poor"),
        lacking=(),
        steps={(rung, "good"): Step(value, None, gain) for rung in ("a", "b")},
        distances={"a": -12.3},
        severities={},
        curves={},
        areas={("good", True): value},
        real={("foam", "good"): Real("localisation_mm", 3.0, 2.0)},
    )
    _, *rows = grid(ladder)
    assert rows[0] == ["a", "-12", "0.500 (+0.100!)", "–"]
    assert rows[1] == ["b", "–", "0.500 (+0.100!)", "–"]
    assert rows[2] == ["area, calibrated", "", "0.500", "–"]
    assert rows[3][1:] == ["", "3 (-1)", "–"]
    assert len(draw(ladder).axes) == 3  # rungs with their colour bar, and the real set
