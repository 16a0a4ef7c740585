"""Quality against noise: the ceiling and the untouched sensor beside a method."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.findings.noise import CEILING, UNTOUCHED, noise_curves
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.reports.findings.noise import draw, findings
from eitbench.scenarios.imperfections.noise import Noise
from eitbench.scenarios.phantoms.families import DeclaredFamily
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite

DISC = DeclaredFamily(name="disc", shape="circle", sizes={"radius": (0.1, 0.2)})
LEVELS: dict[str, Noise] = {"n-clean": "clean", "n-50": 50.0, "n-30": 30.0}
SAMPLES = 6


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    scenarios = tuple(
        SimulatedScenario(
            name=name, image_shape=(20, 20), families=(DISC,), phantoms="n",
            noise=SplitNoise(test=level), train=0, validation=2, test=SAMPLES,
        )
        for name, level in LEVELS.items()
    )  # fmt: skip
    suite = Suite(name="n", title="N", methods=("noser",), scenarios=scenarios)
    return read_run(start_run(make_plan(suite), tmp_path_factory.mktemp("n") / "run").path)


def test_the_untouched_sensor_is_an_image_of_the_background(run: Run) -> None:
    curves = noise_curves(run)
    assert curves is not None
    assert curves.n == SAMPLES
    assert curves.psnr.columns.to_numpy().tolist() == [30, 50, np.inf]
    assert CEILING not in curves.psnr.index
    cell = run.cell("n-50", "noser")
    psnr = -10 * np.log10(np.mean(10 ** (-cell["psnr"] / 10)))
    assert curves.psnr.loc["noser", 50] == pytest.approx(psnr)
    scene = run.scene("n-50", list(range(SAMPLES)))
    assert scene.truth is not None
    error = np.mean((scene.truth - 1.0) ** 2)
    assert curves.psnr.loc[UNTOUCHED, 30] == pytest.approx(-10 * np.log10(error), rel=1e-6)


def test_all_figures_are_over_the_phantoms_of_the_ceiling(run: Run, records: Path) -> None:
    records.mkdir()
    known = [0, 2, 5]
    rows = [
        {"scenario": name, "sample": k, "input_hash": f"{name} {k}", "mse": 1e-3}
        for name in ("n-50", "n-30")
        for k in known
    ]
    pd.DataFrame(rows).to_csv(records / "n.csv", index=False)
    # The record of n-50 is of other data.
    hashes = {"n-30": run.manifest["data"]["n-30"]["hash"], "n-50": "other"}
    (records / "n.json").write_text(json.dumps({"data": hashes}))
    curves = noise_curves(run)
    assert curves is not None
    assert curves.n == 3
    cell = run.cell("n-50", "noser")
    expected = np.mean(10 ** (-cell[cell["sample"].isin(known)]["psnr"] / 10))
    assert curves.psnr.loc["noser", 50] == pytest.approx(-10 * np.log10(expected))
    np.testing.assert_allclose(curves.psnr.loc[CEILING], [30, np.nan, np.nan])


def test_a_method_on_few_phantoms_does_not_decide_for_the_others(run: Run) -> None:
    def with_a_slow_one(samples: int) -> Run:
        slow = run.samples[run.samples["sample"] < samples].assign(method="slow")
        many = pd.concat(
            [run.samples.assign(sample=run.samples["sample"] + 10 * k) for k in (0, 1)]
        )
        return replace(run, samples=pd.concat([many, slow]))

    alone, beside = noise_curves(with_a_slow_one(1)), noise_curves(with_a_slow_one(2))
    assert alone is not None
    assert beside is not None
    assert (alone.n, beside.n) == (2 * SAMPLES, 2)
    assert "slow" not in alone.psnr.index
    assert "slow" in beside.psnr.index


def test_a_method_that_lacks_a_level_has_the_rest_of_its_curve(run: Run) -> None:
    rest = run.samples[run.samples["scenario"] != "n-50"].assign(method="partly")
    curves = noise_curves(replace(run, samples=pd.concat([run.samples, rest])))
    assert curves is not None
    assert curves.n == SAMPLES
    lacking = np.isnan(curves.psnr.loc["partly"].to_numpy(np.float64))
    assert lacking.tolist() == [False, True, False]


def test_the_finding_has_a_row_for_each_line(run: Run) -> None:
    (finding,) = findings(run)
    assert [row[0] for row in finding.grid[1:]] == ["noser", UNTOUCHED]
    assert finding.grid[0][1:] == ["30 dB", "50 dB", "clean"]
    assert finding.figure is not None
    assert "is an image without a touch" in finding.legend
    assert "ceiling" not in finding.legend


def test_frames_of_a_hidden_set_have_no_line_of_the_open_one(run: Run, records: Path) -> None:
    """They are other phantoms, of which neither the ceiling nor the images are known here."""
    records.mkdir()
    rows = [
        {"scenario": name, "sample": k, "input_hash": f"{name} {k}", "mse": 1e-3}
        for name in LEVELS
        for k in range(SAMPLES)
    ]
    pd.DataFrame(rows).to_csv(records / "n.csv", index=False)
    hashes = {name: run.manifest["data"][name]["hash"] for name in LEVELS}
    (records / "n.json").write_text(json.dumps({"data": hashes}))
    hidden = {name: {"hash": f"{k}" * 64} for k, name in enumerate(LEVELS)}
    curves = noise_curves(replace(run, manifest={**run.manifest, "data": hidden}))
    assert curves is not None
    assert curves.psnr.index.tolist() == ["noser"]
    assert draw(curves).axes
    curves = noise_curves(run)
    assert curves is not None
    assert curves.psnr.index.tolist() == ["noser", CEILING, UNTOUCHED]


def test_runs_without_levels_have_no_curves(run: Run) -> None:
    few = run.samples[run.samples["scenario"] != "n-30"]
    assert noise_curves(replace(run, samples=few)) is None
