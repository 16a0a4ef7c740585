"""The ladder: what is compared with what, and areas that can be worked out by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.findings.ladder import Ladder, read_ladder
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import Suite

N = 40
RUNGS: dict[str, tuple[Imperfections, bool]] = {
    "ideal": (Imperfections(), False),
    "gain": (Imperfections(gain=0.01), False),
    "none": (Imperfections(gain=0.01, drift=0.01, severity=0), False),
    "half": (Imperfections(gain=0.01, drift=0.01, severity=0.5), False),
    "all": (Imperfections(gain=0.01, drift=0.01), False),
    "triple": (Imperfections(gain=0.01, drift=0.01, severity=3), False),
    "gain-calibrated": (Imperfections(gain=0.01), True),
}
# Mean B of each method on each rung; every touch is so much better or worse than the mean.
MEANS = {
    "good": {"ideal": 0.9, "gain": 0.8, "none": 0.9, "half": 0.8, "all": 0.7, "triple": 0.3},
    "poor": {"ideal": 0.5, "gain": 0.5, "none": 0.5, "half": 0.5, "all": 0.5, "triple": 0.5},
}
CALIBRATED = {"good": 0.85, "poor": 0.5}
FROM_NONE = ("ideal", "gain", "none", "all", "triple", "gain-calibrated")
TOUCH = np.linspace(-0.05, 0.05, N)


def scenario(name: str) -> SimulatedScenario:
    imperfections, calibrated = RUNGS[name]
    return SimulatedScenario(
        name=name, families=("circle",), train=0, validation=0, test=N,
        imperfections=imperfections, ladder=True, calibrated=calibrated,
    )  # fmt: skip


def made(names: tuple[str, ...] = FROM_NONE) -> Run:
    suite = Suite(
        name="ladder", title="", methods=("good", "poor"),
        scenarios=tuple(scenario(name) for name in names),
    )  # fmt: skip
    noise = np.random.default_rng(0).normal(0, 1e-3, N)
    rows = [
        pd.DataFrame(
            {
                "suite": "ladder", "scenario": name, "method": method, "track": "default",
                "sample": np.arange(N), "phantom": [f"p{k}" for k in range(N)], "status": "ok",
                "bounded": MEANS[method].get(name, CALIBRATED[method]) + TOUCH + noise * (k + 1),
                "score": 1.0,
            }
        )
        for k, name in enumerate(names)
        for method in MEANS
    ]  # fmt: skip
    manifest = {"plan": {"suite": suite.model_dump(mode="json")}, "data": {}}
    return Run(Path("run"), METHOD_RUNS, manifest, pd.concat(rows), pd.DataFrame(), {})


def ladder_of(run: Run) -> Ladder:
    ladder = read_ladder(run)
    assert ladder is not None
    return ladder


def test_losses_are_against_the_ideal_sensor_and_paired() -> None:
    ladder = ladder_of(made())
    assert ladder.rungs == ("ideal", "gain", "none", "all", "triple")
    step = ladder.steps["all", "good"]
    assert step.loss is not None
    assert step.loss.value == pytest.approx(0.2, abs=1e-3)
    # Touches differ by a twentieth, but alike on all rungs: the difference is known far better.
    assert step.loss.high - step.loss.low < 0.1 * (step.value.high - step.value.low)


def test_a_rung_is_compared_with_its_calibrated_twin_alone() -> None:
    ladder = ladder_of(made())
    gain = ladder.steps["gain", "good"].gain
    assert gain
    assert gain.value == pytest.approx(0.05, abs=1e-3)
    assert gain.low > 0.04
    assert not ladder.steps["all", "good"].gain


def test_areas_follow_the_trapezoidal_rule_over_the_span() -> None:
    ladder = ladder_of(made())
    assert ladder.severities == {"none": 0, "all": 1, "triple": 3}
    good = (0.5 * (0.9 + 0.7) * 1 + 0.5 * (0.7 + 0.3) * 2) / 3
    assert ladder.areas["good", False].value == pytest.approx(good, abs=1e-3)
    assert ladder.areas["poor", False].value == pytest.approx(0.5, abs=1e-3)
    assert ladder.methods == ("good", "poor")
    assert ("good", True) not in ladder.areas  # no calibrated curve was run
    later = ladder_of(made(("half", "all", "triple")))
    good = (0.5 * (0.8 + 0.7) * 0.5 + 0.5 * (0.7 + 0.3) * 2) / 2.5
    assert later.areas["good", False].value == pytest.approx(good, abs=1e-3)


def test_without_a_curve_or_an_ideal_rung_there_is_less_and_of_one_rung_nothing() -> None:
    ladder = ladder_of(made(("gain", "all")))
    assert not ladder.severities
    assert not ladder.areas
    assert not ladder.steps["all", "good"].loss
    assert read_ladder(made(("ideal",))) is None
    whole = made()
    assert read_ladder(replace(whole, samples=whole.samples.iloc[:0])) is None


def test_rungs_of_the_curve_follow_each_other() -> None:
    ladder = ladder_of(made(("none", "gain", "triple", "ideal", "all")))
    assert ladder.rungs == ("none", "all", "triple", "gain", "ideal")


def test_a_method_on_fewer_touches_is_compared_with_no_other() -> None:
    run = made()
    short = (run.samples["method"] == "good") & (run.samples["sample"] >= N // 2)
    ladder = ladder_of(replace(run, samples=run.samples[~short]))
    assert ladder.lacking == ("good",)
    assert ladder.methods == ("poor",)
    assert (
        {method for _, method in ladder.steps} == {method for method, _ in ladder.areas} == {"poor"}
    )


def test_few_sessions_give_no_intervals() -> None:
    run = made()
    few = run.samples[run.samples["sample"] < 3 * (MIN_CLUSTERS - 1)]
    ladder = ladder_of(replace(run, samples=few))
    assert np.isnan(ladder.steps["all", "good"].value.low)


def test_rungs_that_lack_different_touches_are_not_compared() -> None:
    run = made()
    lacking = run.samples["scenario"].map({"ideal": 0, "all": 1})
    ladder = ladder_of(replace(run, samples=run.samples[run.samples["sample"] != lacking]))
    assert not ladder.steps["all", "good"].loss
