"""Verdicts of every rule, on runs and studies that were made to deserve them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter
from tests.reports.claims.conftest import NAMES, N, findings
from tests.support.made_runs import write_operators

from eitbench.reports.claims.claim import (
    Verdict,
)
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.claims.rules import IMAGE_METRICS
from eitbench.reports.studies.summaries import StudySummary
from eitbench.reports.tables.published import TABLE_II
from eitbench.scenarios.data.datasets import Dataset


def study(name: str, rows: list[dict[str, Any]]) -> StudySummary:
    return StudySummary(
        study=name, suite="paper", epochs=12, limit=4000, scored=500, operator="fem",
        training_hours=1.5, rows=rows,
    )  # fmt: skip


def test_a_small_study_finds_no_best_beta_and_says_why() -> None:
    rows = [{"beta": 1e-3, "score": 7.0, "n": 500}, {"beta": 0.01, "score": 7.1, "n": 500}]
    lost = {"beta": 0.5}  # a training that diverged
    evidence = Evidence([], {"beta": study("beta", [*rows, lost])})
    found = CLAIMS[NAMES.index("best-beta")].judgement(evidence)
    assert (found.verdict, found.figures[0].ours) == (Verdict.untestable, 0.01)
    for reason in ("one seed", "4000 training samples", "12 epochs", "9.4e-05 in our units"):
        assert reason in found.why


@pytest.mark.parametrize(
    ("name", "claim", "why"),
    [("beta", "best-beta", "no training that came to its end"),
     ("physics", "phydnn-over-dnn-seeds", "no 'ssim' of PhyDNN on the suite 'paper'")],
)  # fmt: skip
def test_a_study_without_what_a_claim_needs_is_no_test(name: str, claim: str, why: str) -> None:
    rows = {"beta": [{"beta": 0.5}], "physics": []}[name]
    found = CLAIMS[NAMES.index(claim)].judgement(Evidence([], {name: study(name, rows)}))
    assert found.verdict is Verdict.untestable
    assert why in found.why


@pytest.mark.parametrize(
    ("sides", "verdict"),
    [((1, 1, 1, 1), Verdict.holds), ((1, -1, 0, 0), Verdict.in_part),
     ((-1, 0, -1, 0), Verdict.fails), ((-1, -1, -1, -1), Verdict.fails)],
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
    found = CLAIMS[NAMES.index("phydnn-over-dnn-seeds")].judgement(evidence)
    assert (found.verdict, found.n) == (verdict, 500)
    assert "3 trainings" in found.why


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("softer", "presses", "verdict"),
    [
        (0.002, 0.002, "holds"),
        (-0.002, -0.002, "does not hold"),
        (0.0, 0.0, "undecided"),
        (0.002, -0.002, "holds in part"),
    ],
)
def test_forces_are_compared_on_soft_presses_alone(
    softer: float, presses: float, verdict: str, build: Any, many: Dataset
) -> None:
    """Images with an offset show a wrong force; PhyDNN's is smaller by so much [S/m]."""
    build.suite = "shapes"
    pressure = np.where(np.arange(N) % 6 == 0, np.nan, 10e3)
    truth = np.array(many.conductivity)
    offset = 0.01 + np.random.default_rng(0).normal(0, 0.001, (2, N, 1, 1))
    for scenario, smaller in (("shapes", softer), ("presses", presses)):
        data = replace(many, scenario=scenario, samples=many.samples.assign(pressure_pa=pressure))
        data.__dict__["conductivity"] = truth
        build.add(data, "dnn", truth - offset[0])
        build.add(data, "phydnn", truth - offset[1] + smaller)
    found = findings(build.write())["force"]
    assert (found.verdict, found.n) == (verdict, 100)
    assert found.conditions.startswith(f"100 of all {N} test samples of 'shapes'")


def test_a_run_without_soft_presses_says_nothing_of_forces(build: Any, many: Dataset) -> None:
    build.suite = "shapes"
    shapes = replace(many, scenario="shapes")
    shapes.__dict__["conductivity"] = truth = np.array(many.conductivity)
    for name in ("dnn", "phydnn"):
        build.add(shapes, name, truth)
    assert findings(build.write())["force"].verdict is Verdict.untestable


@pytest.mark.parametrize(
    ("lower", "verdict"),
    [
        (70, "holds"),
        (67, "holds"),
        (66, "holds in part"),
        (36, "holds in part"),
        (35, "does not hold"),
    ],
)
def test_the_learning_curves(lower: int, verdict: str) -> None:
    """Lower in 95 % of the epochs is consistently; before and in the warm-up nothing counts."""
    epochs = np.arange(1, 101)
    dnn = pd.DataFrame({"epoch": epochs, "train_physical": 1.0, "validation_physical": 1.0})
    below = np.where(epochs > 100 - lower, 0.9, 1.1)
    phydnn = dnn.assign(train_physical=below, validation_physical=below)
    found = CLAIMS[NAMES.index("physical-loss")].judgement(
        Evidence([], curves={"dnn": dnn, "phydnn": phydnn})
    )
    assert found.verdict == verdict
    assert f"{lower} of 70 epochs" in found.why


def test_learning_curves_that_do_not_hold_what_is_compared_test_nothing() -> None:
    short = pd.DataFrame({"epoch": np.arange(1, 31), "train": 1.0, "validation": 1.0})
    evidence = Evidence([], curves={"dnn": short, "phydnn": short})
    for name, why in (
        ("data-loss", "no epoch after the warm-up of 30"),
        ("physical-loss", "The learning curve of 'dnn' has no 'train_physical'"),
    ):
        found = CLAIMS[NAMES.index(name)].judgement(evidence)
        assert (found.verdict, why in found.why) == (Verdict.untestable, True)


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


@pytest.mark.parametrize(
    ("frame_ms", "verdict"),
    [
        ((5000.0, 8.0), Verdict.in_part),
        ((5000.0, 200.0), Verdict.holds),
        ((50.0, 8.0), Verdict.fails),
    ],
)
def test_the_rate_of_schemes_without_true_images(
    frame_ms: tuple[float, float], verdict: Verdict, build: Any, many: Dataset
) -> None:
    build.suite = "objects"
    objects = replace(many, scenario="objects")
    objects.__dict__["conductivity"] = truth = np.array(many.conductivity)
    for name, ms in zip(("dip", "phydnn"), frame_ms, strict=True):
        build.add(objects, name, truth)
        build.methods[-1]["frame_ms_p50"] = ms
    found = findings(build.write())["unsupervised-rate"]
    assert found.verdict is verdict
    assert [figure.ours for figure in found.figures] == pytest.approx([1e3 / ms for ms in frame_ms])


def test_times_that_were_taken_beside_other_cells_say_so(
    add: Callable[..., None], build: Any
) -> None:
    for name, timed in (("dnn", "shared"), ("phydnn", "pinned")):
        add(name, 0.02)
        build.methods[-1]["timed"] = timed
    found = findings(build.write())["frame-rate"]
    assert found.conditions == "one thread of A processor, which other cells shared"


def test_times_name_their_own_machine_and_those_of_two_are_not_compared(
    add: Callable[..., None], build: Any
) -> None:
    """Rows that are added to a record may be of another machine than its first ones."""
    for name in ("dnn", "phydnn"):
        add(name, 0.02)
        build.methods[-1]["machine"] = "Another processor"
    found = findings(build.write())["frame-rate"]
    assert found.conditions == "one thread of Another processor"
    build.methods[0]["machine"] = "A third one"
    found = findings(build.write())["frame-rate"]
    assert found.verdict is Verdict.untestable
    assert found.why.startswith("Times of A third one and of Another processor do not compare")


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


def test_errors_of_other_frames_have_no_ratio(tmp_path: Path) -> None:
    runs = [
        write_operators(tmp_path / name, {name: 1e-3}, n=n)
        for name, n in (("surrogate", N), ("jacobian", N - 20))
    ]
    found = findings(*runs)["table1-ratio"]
    assert found.verdict is Verdict.untestable
    assert found.why == "'surrogate' and 'jacobian' were not run on the same frames."


def test_the_exact_gradient_is_tested_by_its_time(build_operators: Callable[..., Path]) -> None:
    found = findings(build_operators({"surrogate": 1e-3, "fem": 1e-9}))["exact-gradient"]
    assert (found.verdict, found.figures[0].ours) == (Verdict.fails, 1.0)
