"""The track of stated uncertainty: from a method's answer to the tables, and back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.ceiling import record
from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.findings.uncertainty import read_uncertainty
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.benchmark.metrics.uncertainty import LEVELS, UNCERTAINTY, figures_of_draws
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.methods import Problem
from eitbench.methods.method import DRAWS
from eitbench.methods.problem import no_split
from eitbench.methods.registry import create
from eitbench.reports.findings.uncertainty import draw, findings
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.phantoms.families import DeclaredFamily
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite

DISC = DeclaredFamily(name="disc", shape="circle", sizes={"radius": (0.1, 0.2)})
SAMPLES = 7
STATES = """
import numpy as np
MOST = {most}
from eitbench.methods import Method, register


class Sound(Method):
    def fit(self, problem):
        self.problem = problem

    def reconstruct(self, voltages):
        self.problem.difference(voltages)
        return np.full((len(voltages), *self.problem.mask.shape), 0.9)


@register("deviates")
class Deviates(Sound):
    def uncertainty(self, voltages):
        return np.full((len(voltages), *self.problem.mask.shape), 0.25)


@register("fails")
class Fails(Sound):
    def uncertainty(self, voltages):
        raise OSError("no idea")


@register("wild")
class Wild(Sound):
    def uncertainty(self, voltages):
        return np.full((len(voltages), *self.problem.mask.shape), np.inf)


@register("negative")
class Negative(Sound):
    def uncertainty(self, voltages):
        return np.full((len(voltages), *self.problem.mask.shape), -1.0)


@register("far")
class Far(Sound):
    def uncertainty(self, voltages):
        return np.full((len(voltages), *self.problem.mask.shape), 1e30)


@register("refuses")
class Refuses(Sound):
    def uncertainty(self, voltages):
        if len(voltages) > 1 or abs(voltages).sum() > MOST:
            raise OSError("too hard")
        return np.full((len(voltages), *self.problem.mask.shape), 0.25)


@register("silent")
class Silent(Sound):
    pass
"""


SCENARIO = SimulatedScenario(
    name="n", image_shape=(20, 20), families=(DISC,), noise=SplitNoise(test=40.0), train=0,
    validation=2, test=SAMPLES,
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("u")
    plugin = folder / "states.py"
    sums = np.abs(load(SCENARIO, "test").voltages).sum(axis=1)
    plugin.write_text(STATES.replace("{most}", repr(float(np.median(sums)))))
    names = ("noser", "greit", "deviates", "fails", "wild", "negative", "far", "refuses", "silent")
    suite = Suite(name="n", title="N", methods=names, scenarios=(SCENARIO,))
    plan = make_plan(suite, plugins=[plugin])
    return read_run(start_run(plan, folder / "run").path)


def test_figures_are_those_of_the_draws_of_each_frame(run: Run) -> None:
    """Drawn here again by the method alone; NOSER's draws are the same in every process."""
    data = load(SCENARIO, "test")
    assert data.conductivity is not None
    method = create("noser")
    problem = Problem(data.sensor, data.references[0], no_split)
    method.fit(problem)
    stored = run.cell("n", "noser").sort_values("sample")
    mask = data.sensor.mask
    for k, row in enumerate(stored.to_dict("records")):
        problem.reference = data.references[k]
        frame = data.voltages[k : k + 1]
        image, draws = (
            np.asarray(found)[0].astype(np.float32).astype(np.float64)[..., mask]
            for found in (method.reconstruct(frame), method.uncertainty(frame))
        )
        truth = data.conductivity[k][mask].astype(np.float32).astype(np.float64)
        of_one = figures_of_draws(truth[None], draws[None], image[None], data.sensor.data_range)
        expected = {name: values[0] for name, values in of_one.items()}
        for name in ("crps", "sharpness", "error_over_spread", "ause"):
            assert row[name] == pytest.approx(float(expected[name]), rel=1e-4)
        assert row["coverage_95"] == pytest.approx(expected["ranks"][1:-1].sum(), abs=1e-3)
        assert row["uncertainty_ms"] > 0


def test_only_methods_that_state_something_are_on_the_track(run: Run) -> None:
    found = {one.method: one for one in read_uncertainty(run)}
    assert found.keys() == {"noser", "deviates", "refuses"}
    crps = [one.figures["crps"].value for one in read_uncertainty(run)]
    assert crps == sorted(crps)
    assert found["deviates"].figures["sharpness"].value == pytest.approx(0.25, rel=0.02)
    # Independent pixels say nothing of a place.
    assert np.isnan(found["deviates"].figures["place_coverage_95"].value)
    assert 0 <= found["noser"].figures["place_coverage_95"].value <= 1
    for one in (found["noser"], found["deviates"]):
        assert one.curves is not None
        stated, observed = one.curves.reliability()
        for level in LEVELS:
            value = one.figures[f"coverage_{level}"].value
            assert observed[np.isclose(stated, level / 100)] == pytest.approx(value, abs=1e-5)


def test_every_figure_has_an_interval_over_sessions(run: Run) -> None:
    """Of 60 sessions whose figures are drawn alike; of a mean it is that of normal errors."""
    rng = np.random.default_rng(3)
    sessions = np.repeat(np.arange(60), 3)
    drawn = {name: rng.uniform(0.5, 1.5, 60)[sessions] for name in UNCERTAINTY}
    rows = pd.DataFrame(drawn).assign(
        scenario="n", method="deviates", cluster=[f"s{k}" for k in sessions], sample=0
    )
    (found,) = read_uncertainty(replace(run, samples=rows))
    for name, (value, low, high) in found.figures.items():
        assert low < value < high, name
    error = np.std(drawn["crps"][::3]) / np.sqrt(60)
    _, low, high = found.figures["crps"]
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=0.15)
    squares = np.mean(drawn["error_over_spread"] ** 2)
    assert found.figures["error_over_spread"].value == pytest.approx(np.sqrt(squares))


def _of_sessions(methods: dict[str, np.ndarray]) -> pd.DataFrame:
    """Samples of 40 sessions of two frames, with the CRPS of each session by method."""
    return pd.concat(
        pd.DataFrame({
            "scenario": "n", "method": method, "sample": range(80), "crps": np.repeat(crps, 2),
            "cluster": np.repeat([f"s{k}" for k in range(40)], 2), "uncertainty_ms": 1.0,
        })
        for method, crps in methods.items()
    )  # fmt: skip


def test_methods_are_tied_unless_paired_differences_tell_them_apart(run: Run) -> None:
    """Methods differ far less than sessions do; only pairs on the same frames show which do."""
    rng = np.random.default_rng(4)
    sessions, noise = rng.uniform(1, 9, 40), rng.standard_normal((4, 40))
    rows = _of_sessions({
        "noser": sessions + 0.05 + 0.01 * noise[0],
        "deviates": sessions + 0.01 * noise[1],
        "refuses": sessions + 0.001 + 0.01 * noise[2],
        "greit": np.full(40, np.nan),
    })  # fmt: skip
    found = read_uncertainty(replace(run, samples=rows))
    assert {one.method: one.rank for one in found[:3]} == {"deviates": 1, "refuses": 2, "noser": 3}
    groups = {one.method: one.group for one in found}
    assert groups == {"deviates": "a", "refuses": "a", "noser": "b", "greit": ""}
    assert found[-1].rank is None

    few = rows[rows["cluster"].isin([f"s{k}" for k in range(9)])]
    assert {one.group for one in read_uncertainty(replace(run, samples=few))} == {""}
    # The best of all, but on half of the frames: a figure without a rank, below those with one.
    part = rows[(rows["method"] != "deviates") | (rows["sample"] < 40)]
    order = [
        (one.method, one.rank, one.group) for one in read_uncertainty(replace(run, samples=part))
    ]
    assert order[:2] == [("refuses", 1, "a"), ("noser", 2, "b")]
    assert ("deviates", None, "") in order[2:]


def test_an_uncertainty_that_fails_costs_the_frame(run: Run) -> None:
    for name, status, message in (
        ("fails", "error", "OSError: no idea"),
        ("wild", "invalid-output", "returned an uncertainty that is negative or not finite"),
        ("negative", "invalid-output", "returned an uncertainty that is negative or not finite"),
        ("far", "invalid-output", "returned an uncertainty of values beyond 1000 S/m"),
    ):
        rows = run.cell("n", name)
        assert set(rows["status"]) == {status}
        assert set(rows["message"]) == {message}
    assert set(run.cell("n", "silent")["status"]) == {"ok"}
    assert run.cell("n", "silent").get("crps", pd.Series(dtype=float)).isna().all()


def test_a_frame_that_failed_is_charged_as_certain_of_an_untouched_sensor(run: Run) -> None:
    rows = run.cell("n", "refuses").sort_values("sample").reset_index(drop=True)
    failed = rows["status"] != "ok"
    assert failed.sum() == SAMPLES // 2
    data = load(SCENARIO, "test")
    assert data.conductivity is not None
    error = np.abs(data.conductivity - 1)[:, data.sensor.mask].mean(axis=1)
    np.testing.assert_allclose(rows["crps"][failed], error[failed], rtol=1e-5)
    assert (rows["sharpness"][failed] == 0).all()
    assert (rows["coverage_95"][failed] < 0.1).all()


def test_the_ceiling_is_judged_like_a_method(run: Run, records: Path) -> None:
    records.mkdir()
    # Of one frame all truths lie in the middle of the draws, of another half of them above all.
    ends = np.eye(DRAWS + 1)
    ranks = [" ".join(map(str, of)) for of in (ends[DRAWS // 2], (ends[DRAWS // 2] + ends[-1]) / 2)]
    rows = [
        {"scenario": "n", "sample": sample, "mse": 1e-3, "crps": 10.0 * (k + 1),
         "coverage_50": 0.4, "coverage_80": 0.7, "coverage_95": 0.95, "cluster": f"c{k}",
         "ranks": "nan " * (DRAWS + 1) if k == 2 else ranks[k % 2],
         "sparsified": " ".join([f"{k + 1}"] * 20 + ["0.5"] * 20)}
        for k, sample in enumerate([0, 1, 2, 1_000])
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(records / "n.csv", index=False)
    (records / "n.json").write_text(json.dumps({"data": {"n": "of other data"}}))
    assert all(of.method != CEILING for of in read_uncertainty(run))
    (records / "n.json").write_text(json.dumps({"data": {"n": SCENARIO.data_hash("test")}}))
    record._stored.cache_clear()
    first = read_uncertainty(run)[0]
    assert (first.method, first.n) == (CEILING, 3)
    assert first.figures["crps"].value == pytest.approx(20)  # first without being the best
    assert (first.rank, first.group) == (None, "")
    (finding,) = findings(run)
    assert finding.grid[1][:5] == ["n", "–", CEILING, "–", "3"]
    assert finding.figure is not None
    # Its curves are means over the frames that have them, and no place is known.
    pixels, left, places = finding.figure.axes
    assert [CEILING in labels(axes) for axes in (pixels, left, places)] == [True, False, False]
    x, y = line(pixels, CEILING)
    np.testing.assert_allclose(y[(x > 5) & (x < 95)], 75)
    assert first.curves is not None
    np.testing.assert_allclose(first.curves.sparsified, [[2.0] * 20, [0.5] * 20])


def labels(axes: Axes) -> list[str]:
    return [str(line.get_label()) for line in axes.lines]


def line(axes: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    (found,) = (of for of in axes.lines if of.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_places_have_a_diagram_of_reliability(run: Run) -> None:
    (finding,) = findings(run)
    assert finding.figure is not None
    places = finding.figure.axes[-1]
    assert "noser" in labels(places)
    assert "deviates" not in labels(places)  # states no place
    found = {one.method: one for one in read_uncertainty(run)}["noser"].figures
    x, y = line(places, "noser")
    assert x.tolist() == pytest.approx(LEVELS)
    assert y / 100 == pytest.approx([found[f"place_coverage_{k}"].value for k in LEVELS])
    # On skins, where no true conductivity is known, it is the only one.
    pixels = [name for name in UNCERTAINTY if not name.startswith("place") and name[-2:] != "ms"]
    skin = replace(
        run, samples=run.samples.drop(columns=pixels), cells=run.cells.assign(uncertainty="")
    )
    (finding,) = findings(skin)
    assert finding.figure is not None
    (only,) = finding.figure.axes
    assert only.get_ylabel() == places.get_ylabel()
    assert finding.shows.startswith("the share of true places")
    assert finding.grid[0][:3] == ["Scenario", "Method", "n"]  # nothing is ranked


def test_tables_and_figure_show_the_track(run: Run, tmp_path: Path) -> None:
    (finding,) = findings(run)
    # The panels of a scenario stand side by side, and the alternative text says so.
    assert finding.figure is not None
    assert len({axes.get_position().y0 for axes in finding.figure.axes}) == 1
    assert finding.shows.startswith("From the left: the share of true values")
    # A skin, of which places alone are known, has its name above the panel that it has.
    found = read_uncertainty(run)
    unknown = Interval(np.nan, np.nan, np.nan)
    skin = [
        replace(one, scenario="skin", curves=None, figures={
            name: figure if name.startswith("place") else unknown
            for name, figure in one.figures.items()
        })
        for one in found
    ]  # fmt: skip
    seen = [axes for axes in draw([*found, *skin]).axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in seen] == ["n", "", "", "skin"]
    assert finding.table["method"].tolist() == [one.method for one in read_uncertainty(run)]
    assert {*UNCERTAINTY} <= {*finding.table.columns}
    assert len({len(row) for row in finding.grid}) == 1
    written = {path.name for path in finding.write(tmp_path, tmp_path)}
    assert {"uncertainty.md", "uncertainty.csv", "uncertainty.png"} <= written
    assert findings(replace(run, cells=run.cells.drop(columns="uncertainty"))) == []


def test_rescoring_leaves_stated_uncertainty_as_it_is(run: Run) -> None:
    rescore(run.path)
    again = read_run(run.path)
    columns = [name for name in UNCERTAINTY if name in run.samples]
    pd.testing.assert_frame_equal(again.samples[columns], run.samples[columns])


@pytest.mark.parametrize("text", ['{"ranks": [1.0]}', "no JSON", '{"ranks": [], "sparsified": 3}'])
def test_a_damaged_column_is_one_sentence(run: Run, text: str) -> None:
    damaged = replace(run, cells=run.cells.assign(uncertainty=text))
    with pytest.raises(DataCorruptError, match=r"The column 'uncertainty' of .* is damaged"):
        read_uncertainty(damaged)


def test_the_number_of_draws_makes_the_levels_exact() -> None:
    assert all(level * (DRAWS + 1) % 100 == 0 for level in LEVELS)
