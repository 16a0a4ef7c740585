"""The rules that test the published claims on the evidence."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import Interval, bootstrap
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, OPERATOR_RUNS
from eitbench.reports.claims.claim import (
    Best,
    Figure,
    Finding,
    Tolerance,
    Verdict,
    agrees,
    reaches,
    surely_better,
    together,
)
from eitbench.reports.claims.evidence import SCENARIO, Evidence, Measured, NotMeasuredError
from eitbench.reports.studies.summaries import training_budget
from eitbench.reports.tables.published import BETA, RATIO, SSIM_IN_WORDS, TABLE_I, TABLE_II

IMAGE_METRICS = ("ssim", "cc", "rie", "psnr")
TOLERANCES: Mapping[str, Tolerance] = {
    "ssim": Tolerance(absolute=0.01),
    "cc": Tolerance(absolute=0.01),
    "rie": Tolerance(relative=0.1),
    "psnr": Tolerance(absolute=1.0),
}
NEAR_ZERO = 0.05  # the largest SSIM that counts as "near or below 0"
FRAMES_PER_SECOND = 10.0
_BETA_FACTOR = 2.0
_NETWORKS = {"dnn": "DNN", "phydnn": "PhyDNN"}


def published_row(method: str) -> tuple[Figure, ...]:
    """Return the figures of a row of Table II, as far as they are known to us."""
    known = TABLE_II[method]
    row = tuple(Figure(METRICS[name].heading, published) for name, published in known.items())
    return row if "ssim" in known else (Figure(METRICS["ssim"].heading, SSIM_IN_WORDS), *row)


def operator_figures(name: str) -> tuple[Figure, ...]:
    """Return the figures of a row of Table I."""
    mse, r = TABLE_I[name].values()
    return Figure("MSE, standardised", mse), Figure("R", r)


BETA_FIGURE = Figure("best beta", BETA)
RATIO_FIGURE = Figure("MSE of the Jacobian / of the surrogate", round(RATIO, 2))
DIFFERENCES = tuple(Figure(f"{METRICS[name].heading} difference", None) for name in IMAGE_METRICS)
RATES = tuple(Figure(f"{name} [frames/s]", FRAMES_PER_SECOND) for name in _NETWORKS.values())


def agreeing(method: str, figures: Mapping[str, float]) -> dict[str, bool]:
    """Return, for each known figure of the row of `method`, True if that of `figures` agrees."""
    met = {
        name: agrees(figures[name], published, TOLERANCES[name])
        for name, published in TABLE_II[method].items()
    }
    return met if "ssim" in met else {"ssim": figures["ssim"] <= NEAR_ZERO} | met


def _best(name: str) -> Best:
    best = METRICS[name].best
    if best is None:
        raise ValueError(f"{name!r} has no better or worse.")
    return best


def _with_ours(
    figures: Sequence[Figure], ours: Sequence[float], met: Sequence[bool]
) -> tuple[Figure, ...]:
    return tuple(
        replace(figure, ours=value, met=is_met)
        for figure, value, is_met in zip(figures, ours, met, strict=True)
    )


def _of_samples(
    measured: Measured, verdict: Verdict, figures: tuple[Figure, ...], why: str
) -> Finding:
    return Finding(verdict, figures, why, len(measured.samples), measured.conditions)


def operator_row(name: str, evidence: Evidence) -> Finding:
    """Put our figures of an operator beside its row of Table I; the claim is not testable."""
    measured = evidence.of(OPERATOR_RUNS, name)
    figures = tuple(
        replace(figure, ours=measured.row[column])
        for column, figure in zip(TABLE_I[name], operator_figures(name), strict=True)
    )
    why = (
        "MSE and R depend on how voltages are standardised, which the paper does not state, and on "
        "its phantoms; only their ratio between operators compares."
    )
    return _of_samples(measured, Verdict.untestable, figures, why)


def operator_ratio(evidence: Evidence) -> Finding:
    """Test the ratio of the errors of the Jacobian and the surrogate."""
    surrogate, jacobian = (evidence.of(OPERATOR_RUNS, name) for name in ("surrogate", "jacobian"))
    ratio = jacobian.row["mse"] / surrogate.row["mse"]
    met = reaches(ratio, RATIO, Tolerance(relative=0.1), "max")
    return _of_samples(
        surrogate,
        together([met, ratio > 1]),
        _with_ours([RATIO_FIGURE], [ratio], [met]),
        f"The Jacobian's error is {ratio:.3g} times the surrogate's; published were {RATIO:.2g} "
        "times.",
    )


def learned_row(method: str, evidence: Evidence) -> Finding:
    """Test if a learned method is as good as its row of Table II, or better."""
    measured = evidence.of(METHOD_RUNS, method)
    published = TABLE_II[method]
    ours = [measured.row[name] for name in published]
    met = [
        reaches(value, published[name], TOLERANCES[name], _best(name))
        for name, value in zip(published, ours, strict=True)
    ]
    return _of_samples(
        measured,
        together(met),
        _with_ours(published_row(method), ours, met),
        f"{sum(met)} of its {len(met)} figures are as good as published, within the tolerance; "
        "the phantoms' sizes and strengths are ours, since the paper does not state its own.",
    )


def classical_row(method: str, evidence: Evidence) -> Finding:
    """Test if a classical method agrees with its row of Table II."""
    measured = evidence.of(METHOD_RUNS, method)
    row = measured.row
    met = agreeing(method, row)
    return _of_samples(
        measured,
        together(list(met.values())),
        _with_ours(published_row(method), [row[name] for name in met], list(met.values())),
        f"Scored as absolute maps, as every method is here, its images reach PSNR "
        f"{row['psnr']:.1f} dB and CC {row['cc']:.2f}. What the published figures are consistent "
        "with is shown under Two readings.",
    )


def _differences(intervals: Sequence[Interval]) -> tuple[tuple[Figure, ...], list[bool]]:
    """Return the differences between methods, and for each of `IMAGE_METRICS` if it is sure."""
    sure = [
        surely_better(interval, _best(name))
        for name, interval in zip(IMAGE_METRICS, intervals, strict=True)
    ]
    figures = _with_ours(DIFFERENCES, [interval.value for interval in intervals], sure)
    return tuple(
        replace(figure, interval=(interval.low, interval.high))
        for figure, interval in zip(figures, intervals, strict=True)
    ), sure


def phydnn_over_dnn(evidence: Evidence) -> Finding:
    """Test PhyDNN minus DNN, sample by sample."""
    measured, differences = evidence.paired("phydnn", "dnn", IMAGE_METRICS)
    figures, sure = _differences(bootstrap(differences))
    return _of_samples(
        measured,
        together(sure),
        figures,
        f"PhyDNN is better beyond the chance of the samples by {sum(sure)} of {len(sure)} metrics. "
        "One training of each is compared: `eitbench study physics` trains with several seeds.",
    )


def phydnn_over_dnn_with_seeds(evidence: Evidence) -> Finding:
    """Test PhyDNN minus DNN over seeds and samples, from the study `physics`."""
    study = evidence.study("physics")
    rows = {
        row["metric"]: row
        for row in study["rows"]
        if row["scenario"] == SCENARIO and row["physics"] == "surrogate"
    }
    figures, sure = _differences([
        Interval(rows[name]["difference"], rows[name]["low"], rows[name]["high"])
        for name in IMAGE_METRICS
    ])  # fmt: skip
    seeds = len(rows["psnr"]["each_seed"])
    return Finding(
        together(sure),
        figures,
        f"Over {seeds} trainings of each that differ in their seed only, PhyDNN is surely better "
        f"by {sum(sure)} of {len(sure)} metrics. What other data and the exact operator say is "
        "shown under Studies.",
        rows["psnr"]["n"],
        training_budget(study),
    )


def best_beta(evidence: Evidence) -> Finding:
    """Test the best weight of the physical loss, from the study `beta`."""
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
        _with_ours([BETA_FIGURE], [float(betas[best])], [near]),
        f"S is {scores[best]:.3f} at its best and {scores[published]:.3f} at the published beta; "
        f"neighbours on the grid of {len(rows)} differ by {chance:.3f} in the median, and all of "
        f"it spans {scores.min():.3f} to {scores.max():.3f}.",
        rows[best]["n"],
        training_budget(study),
    )


def frame_rate(evidence: Evidence) -> Finding:
    """Test the rate of single frames, at their 99th percentile."""
    both = [evidence.of(METHOD_RUNS, name) for name in _NETWORKS]
    if any(measured.row["frame_ms_p99"] is None for measured in both):
        raise NotMeasuredError("No warm single frame was timed.")
    slowest = [measured.row["frame_ms_p99"] for measured in both]
    rates = [1e3 / ms for ms in slowest]
    met = [reaches(rate, FRAMES_PER_SECOND, Tolerance(), "max") for rate in rates]
    times = " and ".join(
        f"{ms:.3g} ms ({name})" for name, ms in zip(_NETWORKS.values(), slowest, strict=True)
    )
    return Finding(
        together(met),
        _with_ours(RATES, rates, met),
        f"99 % of warm single frames take at most {times}; the board's own time is not in them.",
        conditions=f"one thread of {both[0].machine}",
    )
