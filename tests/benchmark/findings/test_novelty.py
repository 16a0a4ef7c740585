"""Scores of frames, from a method's answer to the table of conditions it does not know."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.findings.novelty import NOBODY, Told, _told, read_novelty
from eitbench.benchmark.metrics.novelty import FRAME, residuals
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.reports.findings.novelty import by_condition, findings
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.phantoms.families import DeclaredFamily
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite

DISC = DeclaredFamily(name="disc", shape="circle", sizes={"radius": (0.1, 0.2)})
CONDUCTS = DISC.model_copy(update={"name": "conducts", "conductivity": (1.1, 1.9)})
SAMPLES = 36
STATES = """
import numpy as np
from eitbench.methods import Method, register


class Sees(Method):
    def fit(self, problem):
        self.problem = problem
        self.seen = len(problem.validation())

    def reconstruct(self, voltages):
        sign = np.sign(self.problem.difference(voltages) @ self.problem.background_voltages)
        return 1 - 0.1 * sign[:, None, None] * self.problem.mask

    def sign(self, voltages):
        return (self.problem.difference(voltages) @ self.problem.background_voltages)


@register("knows")
class Knows(Sees):
    def novelty(self, voltages):
        return -self.sign(voltages)


@register("mistakes")
class Mistakes(Knows):
    def novelty(self, voltages):
        return self.sign(voltages)


@register("refuses")
class Refuses(Sees):
    def novelty(self, voltages):
        if (self.sign(voltages) < 0).any():
            raise OSError("this is no touch")
        return np.ones(len(voltages))


@register("endless")
class Endless(Sees):
    def novelty(self, voltages):
        return np.full(len(voltages), np.inf)


@register("silent")
class Silent(Sees):
    pass
"""
KNOWN = SimulatedScenario(
    name="known", image_shape=(20, 20), conductivity_range=(0.05, 2.0), families=(DISC,),
    noise=SplitNoise(validation=50.0, test=50.0), train=0, validation=30, test=SAMPLES,
)  # fmt: skip
NOVEL = KNOWN.model_copy(
    update={"name": "novel", "families": (CONDUCTS,), "validation": 0, "familiar": "known"}
)
NAMES = ("knows", "mistakes", "refuses", "endless", "silent")
SUITE = Suite(name="s", title="S", methods=NAMES, scenarios=(KNOWN, NOVEL))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("n")
    plugin = folder / "states.py"
    plugin.write_text(STATES)
    return read_run(start_run(make_plan(SUITE, plugins=[plugin]), folder / "run").path)


def told(run: Run) -> dict[tuple[str, str], Told]:
    return {(one.method, one.score): one for one in read_novelty(run)}


def test_a_score_that_knows_is_right_and_one_that_mistakes_is_wrong(run: Run) -> None:
    found = told(run)
    for name, value in (("knows", 1.0), ("mistakes", 0.0)):
        auroc = found[name, "novelty"].figures["auroc"]
        assert auroc == pytest.approx((value, value, value))
        assert found[name, "novelty"].figures["caught"].value == value
        assert found[name, "novelty"].n == 2 * SAMPLES
    assert {one.scenario for one in found.values()} == {"novel"}


def test_who_refuses_what_it_does_not_know_tells_it(run: Run) -> None:
    found = told(run)["refuses", "residual"].figures
    assert found["auroc"].value == 1
    rows = run.cell("novel", "refuses")
    assert set(rows["message"]) == {"OSError: this is no touch"}
    assert told(run)["refuses", "residual"].failed == SAMPLES
    assert told(run)["silent", "residual"].failed == 0


def test_the_frame_alone_needs_no_method(run: Run) -> None:
    """What conducts better changes every voltage the other way."""
    frame = told(run)[NOBODY, FRAME].figures
    assert frame["auroc"].value > 0.9
    assert np.isnan(frame["ordered"].value)


def test_sessions_of_one_unit_are_drawn_together() -> None:
    """Scores of units that differ far more than their two conditions do."""
    rng = np.random.default_rng(7)
    unit = np.repeat(10 * rng.standard_normal(40), 3)
    scores = np.concatenate([unit, unit + 0.5]) + 0.01 * rng.standard_normal(240)
    rows = pd.DataFrame({
        "scenario": np.repeat(["known", "novel"], 120), "status": "ok", "residual": scores,
        "phantom": [f"known test {k}" for _ in range(2) for k in range(120)],
        "cluster": [f"{of} test session {k // 3}" for of in ("known", "novel") for k in range(120)],
    })  # fmt: skip
    together = _told(NOVEL, KNOWN, "m", "residual", rows, with_intervals=True).figures["auroc"]
    apart = rows.assign(cluster=rows["scenario"] + rows["scenario"] + rows["cluster"])
    alone = _told(NOVEL, KNOWN, "m", "residual", apart, with_intervals=True).figures["auroc"]
    assert together.value == alone.value
    assert together.high - together.low < 0.3 * (alone.high - alone.low)
    # Without sessions the touches of both are the clusters, named after the first scenario.
    touches = rows.assign(cluster=rows["phantom"])
    shared = _told(NOVEL, KNOWN, "m", "residual", touches, with_intervals=True).figures["auroc"]
    assert shared.high - shared.low < 0.3 * (alone.high - alone.low)


def test_a_score_that_is_not_finite_costs_the_frame(run: Run) -> None:
    endless = run.cell("known", "endless")
    assert set(endless["status"]) == {"invalid-output"}
    assert set(endless["message"]) == {"returned a novelty that is not finite"}
    assert set(run.cell("known", "silent")["status"]) == {"ok"}
    assert ("silent", "novelty") not in told(run)
    assert ("silent", "residual") in told(run)


def test_stored_residuals_are_those_of_the_images(run: Run) -> None:
    rows = run.cell("novel", "silent").sort_values("sample")
    images = run.estimates("novel", "silent", rows["sample"].tolist())
    assert images is not None
    for name, values in residuals(load(NOVEL, "test"), images).items():
        np.testing.assert_allclose(rows[name], values, rtol=1e-6)


def test_methods_learn_and_are_tuned_on_the_familiar_condition(run: Run) -> None:
    """`novel` declares no validation data, and the methods have read some."""
    assert (run.cell("novel", "silent")["status"] == "ok").all()
    data = MethodData.load(NOVEL, SUITE, 3, jobs=1, progress=False)
    assert data.familiar == KNOWN
    assert data.usual is not None
    np.testing.assert_array_equal(data.usual.voltages, load(KNOWN, "validation").voltages)
    np.testing.assert_array_equal(data.reference, load(KNOWN, "test").references[0])
    alone = SUITE.model_copy(update={"scenarios": (KNOWN,)})
    assert MethodData.load(KNOWN, alone, 3, jobs=1, progress=False).usual is None


def test_figures_are_the_same_without_their_intervals(run: Run) -> None:
    whole, bare = read_novelty(run), read_novelty(run, with_intervals=False)
    assert [(one.method, one.score) for one in bare] == [(one.method, one.score) for one in whole]
    for one, other in zip(whole, bare, strict=True):
        for name, figure in one.figures.items():
            assert other.figures[name].value == pytest.approx(figure.value, nan_ok=True)
            assert np.isnan([other.figures[name].low, other.figures[name].high]).all()
    assert not np.isnan(whole[0].figures["auroc"].low)


def test_a_condition_brings_its_familiar_one_along() -> None:
    assert make_plan(SUITE, methods=["noser"], scenarios=["novel"]).scenarios == ("known", "novel")
    assert make_plan(SUITE, methods=["noser"], scenarios=["known"]).scenarios == ("known",)


def test_without_the_familiar_condition_nothing_is_judged(run: Run) -> None:
    assert findings(replace(run, samples=run.samples[run.samples["scenario"] == "novel"])) == []
    assert findings(replace(run, samples=run.samples.drop(columns="residual"))) == []


def test_rows_are_ranked_by_their_mean_over_common_conditions(run: Run) -> None:
    (finding,) = findings(run)
    wide = by_condition(finding.table)
    assert wide["mean"].iloc[0] == 1
    assert {("knows", "novelty"), ("refuses", "residual")} <= set(wide.index[wide["mean"] == 1])
    assert wide["mean"].is_monotonic_decreasing
    more = finding.table[finding.table["score"] == "residual"].assign(scenario="other", auroc=0.2)
    wide = by_condition(finding.table.merge(more, how="outer"))
    assert wide["mean"].tolist() == wide["novel"].tolist()  # `other` lacks the novelty
    assert len({len(row) for row in finding.grid}) == 1


def test_the_table_and_figure_are_written(run: Run, tmp_path: Path) -> None:
    (finding,) = findings(run)
    written = {path.name for path in finding.write(tmp_path, tmp_path)}
    assert {"novelty.md", "novelty.csv", "novelty.png"} <= written


def test_rescoring_leaves_scores_as_they_are(run: Run) -> None:
    rescore(run.path)
    assert repr(read_novelty(read_run(run.path))) == repr(read_novelty(run))
