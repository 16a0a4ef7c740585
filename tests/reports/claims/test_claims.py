"""Verdicts on the published claims: their rules, and runs that were made to deserve them."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from tests.support.made_runs import made

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.metrics.metric_spec import Best
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.benchmark.studies.readings import write_readings
from eitbench.reports.claims.claim import (
    LEAST_SAMPLES,
    Finding,
    Range,
    Verdict,
    around,
    better,
    together,
    towards,
)
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.claims.published_rows import read_rows
from eitbench.reports.claims.rules import IMAGE_METRICS
from eitbench.reports.page.paper import entries
from eitbench.reports.studies.summaries import StudySummary
from eitbench.reports.tables.published import TABLE_II
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import DataCorruptError

N = 120
REFERENCE_PAPER = Path(__file__).parents[4] / "shared" / "000_bd710fd0cccf696f.txt"
NAMES = [claim.name for claim in CLAIMS]


def findings(*runs: Path) -> dict[str, Finding]:
    evidence = Evidence([read_run(run) for run in runs])
    return {claim.name: claim.finding(evidence) for claim in CLAIMS}


@pytest.fixture(scope="module")
def many() -> Dataset:
    """As many samples as decide something."""
    return made("conductivity", N, scenario="paper", inverse_crime=True)


@pytest.fixture
def add(build: Any, many: Dataset) -> Callable[..., None]:
    """Add a method with so much noise on the truth, and these times."""
    build.suite = "paper"

    def adding(method: str, noise: float, p99_ms: float | None = 20.0, seed: int = 0) -> None:
        truth = np.array(many.conductivity)
        rng = np.random.default_rng(seed)
        build.add(many, method, truth + noise * rng.standard_normal(truth.shape))
        build.methods[-1]["frame_ms_p99"] = p99_ms

    return adding


def study(name: str, rows: list[dict[str, Any]]) -> StudySummary:
    return StudySummary(
        study=name, suite="paper", epochs=12, limit=4000, scored=500, operator="fem",
        training_hours=1.5, rows=rows,
    )  # fmt: skip


def test_a_small_study_finds_no_best_beta_and_says_why() -> None:
    rows = [{"beta": 1e-3, "score": 7.0, "n": 500}, {"beta": 0.01, "score": 7.1, "n": 500}]
    lost = {"beta": 0.5}  # a training that diverged
    evidence = Evidence([], {"beta": study("beta", [*rows, lost])})
    found = CLAIMS[NAMES.index("best-beta")].finding(evidence)
    assert (found.verdict, found.figures[0].ours) == (Verdict.untestable, 0.01)
    for reason in ("one seed", "4000 training samples", "12 epochs", "9.4e-05 in our units"):
        assert reason in found.why


@pytest.mark.parametrize(
    ("sides", "verdict"),
    [((1, 1, 1, 1), Verdict.holds), ((1, -1, 0, 0), Verdict.in_part),
     ((-1, 0, -1, 0), Verdict.undecided), ((-1, -1, -1, -1), Verdict.fails)],
)  # fmt: skip
def test_phydnn_over_dnn_with_seeds(sides: tuple[int, ...], verdict: Verdict) -> None:
    """+1: surely better, 0: the interval holds 0, -1: surely worse; RIE is better when smaller."""
    rows = []
    for metric, side in zip(IMAGE_METRICS, sides, strict=True):
        middle = 0.1 * side * (-1 if metric == "rie" else 1)
        for scenario, physics, value in (
            ("paper", "surrogate", middle),
            ("paper", "fem", -middle),
            ("shapes", "surrogate", -middle),
        ):
            rows.append(
                {"scenario": scenario, "physics": physics, "metric": metric, "difference": value,
                 "low": value - 0.05, "high": value + 0.05, "each_seed": [value] * 3, "n": 500}
            )  # fmt: skip
    evidence = Evidence([], {"physics": study("physics", rows)})
    found = CLAIMS[NAMES.index("phydnn-over-dnn-seeds")].finding(evidence)
    assert (found.verdict, found.n) == (verdict, 500)
    assert "3 trainings" in found.why


def test_every_claim_says_what_it_is() -> None:
    assert len(set(NAMES)) == len(NAMES)
    for claim in CLAIMS:
        assert claim.says.endswith(".")
        assert claim.tolerance
        # What nobody outside can measure has neither figures nor a command.
        assert bool(claim.published) == claim.command.startswith("eitbench ")


def test_without_runs_nothing_is_testable_and_the_published_figures_stand() -> None:
    for claim in CLAIMS:
        found = claim.finding(Evidence([]))
        assert found.verdict is Verdict.untestable
        assert found.figures == claim.published
        assert all(figure.ours is None and figure.verdict is None for figure in found.figures)
        assert found.why.endswith(".")
    assert "'phydnn'" in findings()["table2-phydnn"].why


@pytest.mark.parametrize(
    ("noise", "verdict", "psnr"),
    [(0.001, "holds", "holds"), (0.024, "holds in part", "holds"),
     (0.3, "does not hold", "does not hold")],
)  # fmt: skip
def test_the_row_of_phydnn(
    noise: float, verdict: str, psnr: str, add: Callable[..., None], build: Any
) -> None:
    add("phydnn", noise)
    found = findings(build.write())["table2-phydnn"]
    figures = dict(zip(IMAGE_METRICS, found.figures, strict=True))
    assert {n: f.published for n, f in figures.items()} == TABLE_II["phydnn"]
    assert figures["psnr"].ours == pytest.approx(-20 * np.log10(noise), abs=0.2)
    assert (found.verdict, found.n, figures["psnr"].verdict) == (verdict, N, psnr)
    assert found.conditions.startswith(f"all {N} test samples of 'paper'; sizes of phantoms")


def test_table_ii_is_that_of_the_paper() -> None:
    """Read from the paper itself, which lies beside the project where it may."""
    paper = REFERENCE_PAPER
    if not paper.is_file():
        pytest.skip("needs the paper's text beside the checkout: ../shared/000_*.txt")
    text = paper.read_text(encoding="utf-8")
    rows = {"SSIM": "ssim", "CC": "cc", "RIE": "rie", r"PSNR \(dB\)": "psnr"}
    for title, name in rows.items():
        line = re.search(rf"^{title} \$\\\w+\$\s*&(.*)\\\\", text, re.MULTILINE)
        assert line is not None
        printed = [float(part) for part in line[1].split("&")]
        assert printed == [TABLE_II[method][name] for method in ("noser", "tv", "dnn", "phydnn")]


def test_every_work_that_the_paper_cites_has_a_reference() -> None:
    if not REFERENCE_PAPER.is_file():
        pytest.skip("needs the paper's text beside the checkout: ../shared/000_*.txt")
    text = REFERENCE_PAPER.read_text(encoding="utf-8")
    titles = [
        _letters(title) for title in re.findall(r"^ +title *= *\{(.*)\},$", text, re.MULTILINE)
    ]
    known = [_letters(entry) for entry in entries().values()]
    assert len(titles) == 17
    assert [title for title in titles if not any(title in entry for entry in known)] == []


def _letters(text: str) -> str:
    return re.sub(r"[^a-z]", "", text.lower())


@pytest.mark.parametrize("n", [2, 60])
def test_few_samples_decide_nothing(n: int, build: Any) -> None:
    few = made("conductivity", n, scenario="paper", inverse_crime=True)
    build.suite = "paper"
    build.add(few, "phydnn", np.array(few.conductivity))
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.undecided
    assert f"{n} samples are too few" in found.why


def test_a_limited_run_says_so(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    build.limit = N
    assert findings(build.write())["table2-phydnn"].conditions.startswith(f"the first {N} test")


def test_a_classical_row_is_not_kept_by_being_better(add: Callable[..., None], build: Any) -> None:
    add("noser", 0.001)
    found = findings(build.write())["table2-noser"]
    assert found.verdict is Verdict.fails
    assert [figure.published for figure in found.figures] == [-0.0127, 0.1207, 1.2130, -1.0795]


def test_a_classical_row_holds_where_figures_are_as_published(build: Any, many: Dataset) -> None:
    """-0.22 everywhere: an error of about 1.2 on a background of 1; CC is 0, not 0.12."""
    build.suite = "paper"
    build.add(many, "noser", np.full_like(np.array(many.conductivity), -0.22))
    found = findings(build.write())["table2-noser"]
    assert found.verdict is Verdict.in_part
    by_name = dict(zip(IMAGE_METRICS, found.figures, strict=True))
    assert by_name["rie"].verdict is by_name["psnr"].verdict is Verdict.holds
    assert by_name["cc"].verdict is Verdict.fails


@pytest.mark.parametrize(
    ("phydnn", "dnn", "verdict"),
    [(0.02, 0.04, "holds"), (0.04, 0.02, "does not hold"), (0.02, 0.02, "undecided")],
)
def test_phydnn_against_dnn(
    phydnn: float, dnn: float, verdict: str, add: Callable[..., None], build: Any
) -> None:
    add("phydnn", phydnn)
    add("dnn", dnn, seed=1)
    found = findings(build.write())["phydnn-over-dnn"]
    assert (found.verdict, found.n) == (verdict, N)
    psnr = found.figures[3]
    assert psnr.interval is not None
    assert psnr.ours is not None
    assert psnr.ours == pytest.approx(20 * np.log10(dnn / phydnn), abs=0.05)
    assert psnr.interval[0] <= psnr.ours <= psnr.interval[1]
    assert "One training of each" in found.why


@pytest.mark.parametrize(("ahead", "verdict"), [(N, "holds"), (N // 2, "does not hold")])
def test_the_best_in_every_case(
    ahead: int, verdict: str, add: Callable[..., None], build: Any, many: Dataset
) -> None:
    """PhyDNN is nearest to the truth in `ahead` samples, and farthest from it in the others."""
    for k, method in enumerate(("noser", "tv", "dnn")):
        add(method, 0.02, seed=k)
    truth = np.array(many.conductivity)
    noise = np.where(np.arange(N) < ahead, 0.005, 0.1)[:, None, None]
    build.add(many, "phydnn", truth + noise * np.random.default_rng(5).standard_normal(truth.shape))
    run = build.write()
    found = findings(run)["every-case"]
    assert (found.verdict, found.figures[0].ours) == (verdict, ahead / N)
    over = findings(run)["learned-over-classical"]
    assert [figure.name.split(", ")[1] for figure in over.figures[::4]] == [
        "DNN minus NOSER", "DNN minus TV", "PhyDNN minus NOSER", "PhyDNN minus TV",
    ]  # fmt: skip


def test_blurred_images_have_softer_edges_and_more_artefacts(build: Any, many: Dataset) -> None:
    build.suite = "paper"
    truth = np.array(many.conductivity)
    for method, width in (("noser", 5), ("tv", 3), ("dnn", 1), ("phydnn", 1)):
        blurred = 1 + gaussian_filter(truth - 1, (0, width, width))
        build.add(many, method, blurred)
    found = findings(build.write())
    cleaner = found["networks-cleaner"]
    assert cleaner.verdict is Verdict.holds
    assert [figure.name for figure in cleaner.figures[:2]] == [
        "Edge, DNN minus NOSER", "Artefacts, DNN minus NOSER",
    ]  # fmt: skip
    assert cleaner.figures[0].ours is not None
    assert cleaner.figures[0].ours > 0
    assert found["phydnn-cleaner"].verdict is Verdict.undecided  # the same images


def test_other_scenarios_are_compared_where_their_suite_is_the_packaged_one(
    build: Any, many: Dataset
) -> None:
    build.suite = "shapes"
    shapes = replace(many, scenario="shapes")
    shapes.__dict__["conductivity"] = truth = np.array(many.conductivity)
    build.add(shapes, "phydnn", truth)
    build.add(shapes, "dnn", truth + 0.1)
    found = findings(build.write())
    assert found["generalisation"].verdict is Verdict.undecided  # CC is the same
    assert "'shapes'" in found["generalisation"].conditions
    assert found["phydnn-over-dnn"].verdict is Verdict.untestable


@pytest.mark.parametrize(
    ("lower", "verdict"), [(70, "holds"), (51, "holds in part"), (7, "does not hold")]
)
def test_the_learning_curves(lower: int, verdict: str) -> None:
    """Before and in the warm-up of 30 epochs nothing counts."""
    epochs = np.arange(1, 101)
    dnn = pd.DataFrame({"epoch": epochs, "train_physical": 1.0, "validation_physical": 1.0})
    below = np.where(epochs > 100 - lower, 0.9, 1.1)
    phydnn = dnn.assign(train_physical=below, validation_physical=below)
    found = CLAIMS[NAMES.index("physical-loss")].finding(
        Evidence([], curves={"dnn": dnn, "phydnn": phydnn})
    )
    assert found.verdict == verdict
    assert f"{lower} of 70 epochs" in found.why


def test_pairs_are_of_the_same_frames_whatever_the_order_and_the_run(
    add: Callable[..., None], build: Any
) -> None:
    add("phydnn", 0.02)
    one = build.write()
    build.path, build.samples, build.methods, build.images = one.parent / "other", [], [], {}
    add("dnn", 0.04)
    build.samples[0] = build.samples[0].iloc[::-1]
    assert findings(one, build.write())["phydnn-over-dnn"].verdict is Verdict.holds
    build.samples[0] = build.samples[0].assign(input_hash="another")
    other = findings(one, build.write())["phydnn-over-dnn"]
    assert other.verdict is Verdict.untestable
    assert other.why == "'phydnn' and 'dnn' were not run on the same frames."


@pytest.mark.parametrize(
    ("p99", "verdict"),
    [
        ((20.0, 99.0), Verdict.holds),
        ((20.0, 101.0), Verdict.in_part),
        ((200.0, 101.0), Verdict.fails),
    ],
)
def test_the_frame_rate(
    p99: tuple[float, float], verdict: Verdict, add: Callable[..., None], build: Any
) -> None:
    add("dnn", 0.02, p99[0])
    add("phydnn", 0.02, p99[1])
    found = findings(build.write())["frame-rate"]
    assert found.verdict is verdict
    assert [figure.ours for figure in found.figures] == pytest.approx([1e3 / ms for ms in p99])
    assert f"{p99[0]:.3g} ms (DNN)" in found.why
    assert found.conditions == "one thread of A processor"


def test_a_frame_rate_that_was_not_timed(add: Callable[..., None], build: Any) -> None:
    add("dnn", 0.02, None)
    add("phydnn", 0.02)
    assert findings(build.write())["frame-rate"].verdict is Verdict.untestable


@pytest.mark.parametrize(
    ("ratio", "verdict", "order"),
    [(252.0, "does not hold", "holds"), (6.5, "holds", "holds"),
     (0.9, "does not hold", "does not hold")],
)  # fmt: skip
def test_the_ratio_of_table_i_is_tested_on_both_sides(
    ratio: float, verdict: str, order: str, build_operators: Callable[..., Path]
) -> None:
    """A weak Jacobian makes the ratio large, which confirms nothing."""
    run = build_operators({"surrogate": 1e-3, "jacobian": ratio * 1e-3}, n=N)
    found = findings(run)
    assert (found["table1-ratio"].verdict, found["table1-order"].verdict) == (verdict, order)
    (figure,) = found["table1-ratio"].figures
    assert figure.published == 6.3
    assert figure.ours == pytest.approx(ratio)
    row = found["table1-surrogate"]
    assert row.verdict is Verdict.holds
    assert [figure.published for figure in row.figures] == [0.99498, 2.57e-3]
    assert [figure.verdict for figure in row.figures] == ["holds", None]
    assert "0.26 and 0.29" in row.why  # MSE / (1 - R^2), which a variance of 1 exceeds


def test_the_exact_gradient_is_tested_by_its_time(build_operators: Callable[..., Path]) -> None:
    found = findings(build_operators({"surrogate": 1e-3, "fem": 1e-9}))["exact-gradient"]
    assert (found.verdict, found.figures[0].ours) == (Verdict.fails, 1.0)


def test_a_failed_method_is_not_testable_and_its_own_sentence_says_why(
    build: Any, paper: Dataset
) -> None:
    build.suite = "paper"
    build.add(paper, "phydnn", np.array(paper.conductivity), lost=1)
    build.samples[0]["message"] = "InputError: 'phydnn' has no weights: train them"
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert "1 samples failed" in found.why
    assert found.why.endswith("InputError: 'phydnn' has no weights: train them.")


def test_a_method_that_was_left_out_is_not_testable_and_the_run_says_why(
    add: Callable[..., None], build: Any
) -> None:
    add("dnn", 0.01)
    why = "Scenario 'paper' is left out for 'phydnn': it has no weights."
    build.skipped = {"paper/phydnn": why}
    found = findings(build.write())
    for name in ("table2-phydnn", "phydnn-over-dnn", "frame-rate"):
        assert (found[name].verdict, found[name].why) == (Verdict.untestable, why)


def test_an_unfinished_run_is_no_evidence(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    build.samples[0] = build.samples[0].iloc[:5]
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert f"holds 5 of {N} samples of 'phydnn'" in found.why


def test_another_suite_s_scenario_of_that_name_is_no_evidence(
    add: Callable[..., None], build: Any, build_operators: Callable[..., Path]
) -> None:
    add("phydnn", 0.01)
    build.samples[0]["suite"] = "mine"
    operators = build_operators({"surrogate": 1e-3, "jacobian": 1e-2}, suite="mine")
    for found in findings(build.write(), operators).values():
        assert (found.verdict, found.n) == (Verdict.untestable, None)


def test_two_runs_of_one_method_are_refused(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    one = build.write()
    build.path = one.parent / "other"
    with pytest.raises(InputError, match=r"run and .*other both hold the method 'phydnn'"):
        findings(one, build.write())


def test_the_readings_of_a_row_say_what_they_reproduce(tmp_path: Path) -> None:
    plain = {
        "method": "noser", "frames": "as they are", "axes": "as they are", "background": True,
        "sign": 1, "strength": 1.0, "ssim": 0.6, "cc": 0.84, "rie": 0.06, "psnr": 24.0,
    }  # fmt: skip
    fitted = plain | {"strength": 8.0, "ssim": -0.01, "cc": 0.12, "rie": 1.213, "psnr": -1.5}
    exchanged = plain | {"axes": "exchanged", "cc": 0.125}
    rows = [plain, exchanged, fitted]
    table = pd.DataFrame(rows + [row | {"method": "tv"} for row in rows])
    write_readings(table, 600, tmp_path)
    noser, tv = read_rows(tmp_path)
    assert [reading["name"] for reading in noser["readings"]] == [
        "absolute maps, as scored here", "8 times as strong (fitted to RIE)", "axes exchanged",
    ]  # fmt: skip
    assert [reading["reproduced"] for reading in noser["readings"]] == [
        [], ["ssim", "cc", "psnr"], ["cc"],
    ]  # fmt: skip
    assert "the best reproduce 3 of the four" in noser["says"]
    assert "None reproduces its RIE" in noser["says"]
    assert "the best reproduce 0" in tv["says"]
    (tmp_path / "readings.json").write_text('{"rows": [{}]}')
    with pytest.raises(DataCorruptError, match="damaged"):
        read_rows(tmp_path)


ENDS = st.floats(-1e3, 1e3)


@given(ENDS, ENDS, ENDS, ENDS)
def test_an_interval_holds_or_misses_only_as_a_whole(
    a: float, b: float, c: float, d: float
) -> None:
    low, high = sorted((a, b))
    inside = Range(*sorted((c, d)))
    interval = Interval((low + high) / 2, low, high)
    points = [inside.low <= value <= inside.high for value in np.linspace(low, high, 7)]
    verdict = inside.test(interval, LEAST_SAMPLES)
    if verdict is Verdict.holds:
        assert all(points)
    elif verdict is Verdict.fails:
        assert not any(points)
    assert inside.test(interval, LEAST_SAMPLES - 1) is Verdict.undecided


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.1, 0.3, "holds"), (-0.3, -0.1, "does not hold"), (-0.1, 0.5, "undecided"),
     (0.0, 0.5, "undecided")],
)  # fmt: skip
def test_an_interval_that_holds_0_refutes_nothing(low: float, high: float, verdict: str) -> None:
    interval = Interval((low + high) / 2, low, high)
    assert better("max").test(interval, LEAST_SAMPLES) == verdict
    opposite = {"holds": "does not hold", "does not hold": "holds"}.get(verdict, verdict)
    assert better("min").test(interval, LEAST_SAMPLES) == opposite


@pytest.mark.parametrize(
    ("ours", "best", "verdict"),
    [(0.966, "max", "holds"), (0.965, "max", "does not hold"), (0.99, "max", "holds"),
     (0.985, "min", "holds"), (0.986, "min", "does not hold")],
)  # fmt: skip
def test_margins(ours: float, best: Best, verdict: str) -> None:
    met = towards(best, around(0.9754, absolute=0.01))
    assert met.test(Interval(ours, ours, ours), LEAST_SAMPLES) == verdict
    both = around(0.9754, absolute=0.01).test(Interval(ours, ours, ours), LEAST_SAMPLES)
    assert both == ("holds" if abs(ours - 0.9754) <= 0.01 else "does not hold")


@given(st.lists(st.sampled_from([Verdict.holds, Verdict.fails, Verdict.undecided]), min_size=1))
def test_both_kinds_are_in_part_and_an_open_one_leaves_the_claim_open(found: list[Verdict]) -> None:
    kinds = set(found)
    if {Verdict.holds, Verdict.fails} <= kinds:
        assert together(found) is Verdict.in_part
    else:
        assert together(found) is (found[0] if len(kinds) == 1 else Verdict.undecided)
