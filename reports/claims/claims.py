"""The published claims and the rules of their verdicts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import Interval, bootstrap_means
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, OPERATOR_RUNS
from eitbench.reports.claims.claim import Claim, Figure, Finding
from eitbench.reports.claims.evidence import SCENARIO, Evidence, Measured, NotMeasuredError
from eitbench.reports.claims.verdicts import (
    Best,
    Tolerance,
    Verdict,
    agrees,
    reaches,
    surely_better,
    together,
)
from eitbench.reports.studies.summaries import budget
from eitbench.reports.tables.published import BETA, RATIO, SSIM_IN_WORDS, TABLE_I, TABLE_II

IMAGE_METRICS = ("ssim", "cc", "rie", "psnr")
TOLERANCES: Mapping[str, Tolerance] = {
    "ssim": Tolerance(absolute=0.01),
    "cc": Tolerance(absolute=0.01),
    "rie": Tolerance(relative=0.1),
    "psnr": Tolerance(absolute=1.0),
}
_WITHIN = "SSIM and CC within 0.01, RIE within 10 %, PSNR within 1 dB"
NEAR_ZERO = 0.05  # what "near or below 0" is taken to mean
FRAMES_PER_SECOND = 10.0
_EXACT = Tolerance()
_BETA_FACTOR = 2.0
_BETA_FIGURE = Figure("best beta", BETA)


def title(name: str) -> str:
    """An image metric with its unit."""
    return METRICS[name].heading


def agreeing(method: str, figures: Mapping[str, float]) -> dict[str, bool]:
    """Which of `figures` are as the published row of `method` has them, of those known to us."""
    kept = {
        name: agrees(figures[name], published, TOLERANCES[name])
        for name, published in TABLE_II[method].items()
    }
    return kept if "ssim" in kept else {"ssim": figures["ssim"] <= NEAR_ZERO} | kept


def _published_row(method: str) -> tuple[Figure, ...]:
    known = TABLE_II[method]
    row = tuple(Figure(title(name), published) for name, published in known.items())
    return row if "ssim" in known else (Figure(title("ssim"), SSIM_IN_WORDS), *row)


def _best(name: str) -> Best:
    best = METRICS[name].best
    if best is None:
        raise ValueError(f"{name!r} has no better or worse.")
    return best


def _of(measured: Measured, verdict: Verdict, figures: Sequence[Figure], why: str) -> Finding:
    return Finding(verdict, tuple(figures), why, len(measured.samples), measured.conditions)


def _operator_row(name: str, evidence: Evidence) -> Finding:
    measured = evidence.of(OPERATOR_RUNS, name)
    figures = [
        replace(figure, ours=measured.row[key])
        for key, figure in zip(TABLE_I[name], _operator_figures(name), strict=True)
    ]
    return _of(
        measured,
        Verdict.untestable,
        figures,
        "MSE and R depend on how voltages are standardised, which the paper does not state, and on "
        "its phantoms; only their ratio between operators compares.",
    )


def _operator_figures(name: str) -> tuple[Figure, ...]:
    mse, r = TABLE_I[name].values()
    return Figure("MSE, standardised", mse), Figure("R", r)


_RATIO_FIGURE = Figure("MSE of the Jacobian / of the surrogate", round(RATIO, 2))


def _ratio(evidence: Evidence) -> Finding:
    surrogate, jacobian = (evidence.of(OPERATOR_RUNS, name) for name in ("surrogate", "jacobian"))
    ratio = jacobian.row["mse"] / surrogate.row["mse"]
    kept = reaches(ratio, RATIO, Tolerance(relative=0.1), "max")
    return _of(
        surrogate,
        together([kept, ratio > 1]),
        [replace(_RATIO_FIGURE, ours=ratio, kept=kept)],
        f"The Jacobian's error is {ratio:.3g} times the surrogate's; published were {RATIO:.2g} "
        "times.",
    )


def _learned_row(method: str, evidence: Evidence) -> Finding:
    measured = evidence.of(METHOD_RUNS, method)
    figures = [
        replace(
            figure,
            ours=measured.row[name],
            kept=reaches(measured.row[name], published, TOLERANCES[name], _best(name)),
        )
        for (name, published), figure in zip(
            TABLE_II[method].items(), _published_row(method), strict=True
        )
    ]
    kept = [bool(figure.kept) for figure in figures]
    return _of(
        measured,
        together(kept),
        figures,
        f"{sum(kept)} of its {len(kept)} figures are as good as published, within the tolerance; "
        "the phantoms' sizes and strengths are ours, since the paper does not state its own.",
    )


def _classical_row(method: str, evidence: Evidence) -> Finding:
    measured = evidence.of(METHOD_RUNS, method)
    row = measured.row
    agreed = agreeing(method, row)
    figures = [
        replace(figure, ours=row[name], kept=kept)
        for (name, kept), figure in zip(agreed.items(), _published_row(method), strict=True)
    ]
    return _of(
        measured,
        together(list(agreed.values())),
        figures,
        f"Scored as absolute maps, as every method is here, its images reach PSNR "
        f"{row['psnr']:.1f} dB and CC {row['cc']:.2f}. What the published figures are consistent "
        "with is shown under Two readings.",
    )


_DIFFERENCES = tuple(Figure(f"{title(name)} difference", None) for name in IMAGE_METRICS)


def _differences(intervals: Sequence[Interval]) -> list[Figure]:
    """The figures of a difference between methods, one of each of `IMAGE_METRICS`."""
    return [
        replace(
            figure,
            ours=interval.value,
            interval=(interval.low, interval.high),
            kept=surely_better(interval, _best(name)),
        )
        for name, figure, interval in zip(IMAGE_METRICS, _DIFFERENCES, intervals, strict=True)
    ]


def _phydnn_over_dnn(evidence: Evidence) -> Finding:
    measured, differences = evidence.paired("phydnn", "dnn", IMAGE_METRICS)
    intervals = bootstrap_means(differences)
    figures = _differences(intervals)
    kept = [bool(figure.kept) for figure in figures]
    return _of(
        measured,
        together(kept),
        figures,
        f"PhyDNN is better beyond the chance of the samples by {sum(kept)} of {len(kept)} metrics. "
        "One training of each is compared: `eitbench study physics` trains with several seeds.",
    )


def _phydnn_with_seeds(evidence: Evidence) -> Finding:
    study = evidence.study("physics")
    rows = {
        row["metric"]: row
        for row in study["rows"]
        if row["scenario"] == SCENARIO and row["physics"] == "surrogate"
    }
    intervals = [
        Interval(rows[name]["difference"], rows[name]["low"], rows[name]["high"])
        for name in IMAGE_METRICS
    ]
    figures = _differences(intervals)
    kept = [bool(figure.kept) for figure in figures]
    seeds = len(rows["psnr"]["each_seed"])
    return Finding(
        together(kept),
        tuple(figures),
        f"Over {seeds} trainings of each that differ in their seed only, PhyDNN is surely better "
        f"by {sum(kept)} of {len(kept)} metrics. What other data and the exact operator say is "
        "shown under Studies.",
        rows["psnr"]["n"],
        budget(study),
    )


def _best_beta(evidence: Evidence) -> Finding:
    study = evidence.study("beta")
    rows = sorted((r for r in study["rows"] if "score" in r), key=lambda row: row["beta"])
    betas, scores = (np.array([row[key] for row in rows]) for key in ("beta", "score"))
    best = int(np.argmax(scores))
    published = int(np.argmin(np.abs(np.log(betas / BETA))))
    lead = float(scores[best] - scores[published])
    # Neighbours differ by the chance of training and hardly by beta.
    chance = float(np.median(np.abs(np.diff(scores))))
    near = bool(max(betas[best] / BETA, BETA / betas[best]) <= _BETA_FACTOR)
    return Finding(
        together([near, lead <= chance]),
        (replace(_BETA_FIGURE, ours=float(betas[best]), kept=near),),
        f"S is {scores[best]:.3f} at its best and {scores[published]:.3f} at the published beta; "
        f"neighbours on the grid of {len(rows)} differ by {chance:.3f} in the median, and all of "
        f"it spans {scores.min():.3f} to {scores.max():.3f}.",
        rows[best]["n"],
        budget(study),
    )


_LEARNED = {"dnn": "DNN", "phydnn": "PhyDNN"}
_RATES = tuple(Figure(f"{name} [frames/s]", FRAMES_PER_SECOND) for name in _LEARNED.values())


def _frame_rate(evidence: Evidence) -> Finding:
    both = [evidence.of(METHOD_RUNS, name) for name in _LEARNED]
    if any(measured.row["frame_ms_p99"] is None for measured in both):
        raise NotMeasuredError("No warm single frame was timed.")
    slowest = [measured.row["frame_ms_p99"] for measured in both]
    figures = [
        replace(
            figure,
            ours=1e3 / ms,
            kept=reaches(1e3 / ms, FRAMES_PER_SECOND, _EXACT, "max"),
        )
        for figure, ms in zip(_RATES, slowest, strict=True)
    ]
    times = " and ".join(
        f"{ms:.3g} ms ({name})" for name, ms in zip(_LEARNED.values(), slowest, strict=True)
    )
    return Finding(
        together([bool(figure.kept) for figure in figures]),
        tuple(figures),
        f"99 % of warm single frames take at most {times}; the board's own time is not in them.",
        conditions=f"one thread of {both[0].machine}",
    )


CLAIMS = (
    Claim(
        "table1-ratio",
        "Table I",
        "The learned surrogate predicts voltages better than the Jacobian does.",
        (_RATIO_FIGURE,),
        "holds: the ratio is at least 90 % of the published one; in part: above 1",
        "eitbench run operators --operators surrogate,jacobian",
        _ratio,
    ),
    *(
        Claim(
            f"table1-{name}",
            "Table I",
            f"The {label} predicts standardised voltages with this error.",
            _operator_figures(name),
            "none: the standardisation is not published",
            f"eitbench run operators --operators {name}",
            partial(_operator_row, name),
        )
        for name, label in (("surrogate", "learned surrogate"), ("jacobian", "Jacobian"))
    ),
    Claim(
        "table2-phydnn",
        "Table II",
        "PhyDNN reconstructs clean test frames this well.",
        _published_row("phydnn"),
        f"as good as published or better: {_WITHIN}; holds: all figures; in part: some",
        "eitbench run paper --methods phydnn",
        partial(_learned_row, "phydnn"),
    ),
    *(
        Claim(
            f"table2-{name}",
            "Table II",
            f"{name.upper()}'s images of clean test frames score this.",
            _published_row(name),
            f"as published, neither better nor worse: {_WITHIN}, SSIM near or below 0 meaning at "
            f"most {NEAR_ZERO}; holds: all figures; in part: some",
            f"eitbench run paper --methods {name}",
            partial(_classical_row, name),
        )
        for name in ("noser", "tv")
    ),
    Claim(
        "phydnn-over-dnn",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, the same network without it.",
        _DIFFERENCES,
        "PhyDNN minus DNN, sample by sample: the whole 95 % bootstrap interval of the mean lies on "
        "PhyDNN's side of 0; holds: all four; in part: some",
        "eitbench run paper --methods dnn,phydnn",
        _phydnn_over_dnn,
    ),
    Claim(
        "phydnn-over-dnn-seeds",
        "Table II",
        "The physical loss makes PhyDNN better than DNN, whatever the seed of the training.",
        _DIFFERENCES,
        "PhyDNN minus DNN, paired by seed and sample: the whole 95 % interval of the mean over "
        "both lies on PhyDNN's side of 0; holds: all four; in part: some",
        "eitbench study physics --out runs/physics && eitbench reproduce --study runs/physics",
        _phydnn_with_seeds,
    ),
    Claim(
        "best-beta",
        "beta sweep",
        "The weight beta of the physical loss is best at 0.0029.",
        (_BETA_FIGURE,),
        "two rules: the best beta lies within a factor of 2 of the published one; S there is "
        "better than at the published beta by no more than neighbours on the grid differ in the "
        "median; holds: both; in part: one",
        "eitbench study beta --out runs/beta && eitbench reproduce --study runs/beta",
        _best_beta,
    ),
    Claim(
        "frame-rate",
        "speed",
        "The networks reconstruct 10 frames per second.",
        _RATES,
        "at least 10 frames per second at the 99th percentile of single warm frames; holds: both "
        "networks; in part: one",
        "eitbench run paper --methods dnn,phydnn",
        _frame_rate,
    ),
)
