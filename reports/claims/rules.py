"""Rules that test the published claims on the evidence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest

from eitbench.benchmark.metrics.metric_spec import Best
from eitbench.benchmark.metrics.operator_metrics import OPERATOR_METRICS
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import (
    LEVEL,
    Interval,
    bootstrap,
    means,
    medians,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, OPERATOR_RUNS
from eitbench.reports.claims.claim import (
    LEAST_SAMPLES,
    Figure,
    Judgement,
    Range,
    Verdict,
    around,
    better,
    together,
    towards,
)
from eitbench.reports.claims.evidence import (
    SCENARIO,
    Evidence,
    Measured,
    NotMeasuredError,
    same_machine,
)
from eitbench.reports.studies.summaries import training_budget
from eitbench.reports.tables.published import BETA, BETA_OF_MEANS, RATIO, TABLE_I, TABLE_II

IMAGE_METRICS = ("ssim", "cc", "rie", "psnr")
SHAPE_METRICS = ("edge", "artefacts")
TOLERANCES: Mapping[str, Mapping[str, float]] = {
    "ssim": {"absolute": 0.01},
    "cc": {"absolute": 0.01},
    "rie": {"relative": 0.1},
    "psnr": {"absolute": 1.0},
}
R_TOLERANCE = {"absolute": 0.005}
RATIO_TOLERANCE = {"relative": 0.1}
FRAMES_PER_SECOND = 10.0
PROHIBITIVE = 10.0
"""Times the cost of the learned operator's gradient that is called prohibitive."""
CLASSICAL = ("noser", "tv")
LABELS = {"noser": "NOSER", "tv": "TV", "dnn": "DNN", "phydnn": "PhyDNN"}
WARM_UP_EPOCHS = 30


def best_of(name: str) -> Best:
    """Return the better direction of an image metric; of edges the sharper one, as claims say."""
    best: Best = "max" if name == "edge" else METRICS[name].best
    if best is None:
        raise ValueError(f"{name!r} has no better or worse.")
    return best


def row_figures(method: str) -> tuple[Figure, ...]:
    """Return the figures of a row of Table II."""
    return tuple(Figure(METRICS[name].heading, TABLE_II[method][name]) for name in IMAGE_METRICS)


def operator_figures(name: str) -> tuple[Figure, ...]:
    """Return the figures of a row of Table I."""
    return Figure("R", TABLE_I[name]["r"]), Figure("MSE", TABLE_I[name]["mse"])


def difference_figures(*pairs: str, metrics: Sequence[str] = IMAGE_METRICS) -> tuple[Figure, ...]:
    """Return a figure for each of the metrics of every pair, such as "PhyDNN minus DNN"."""
    return tuple(
        Figure(f"{METRICS[name].heading}, {pair}", None) for pair in pairs for name in metrics
    )


_ONE_TRAINING = (
    "One training of each network is compared: how much another seed changes is not in these "
    "intervals."
)
NEARLY_ALL = 0.95
"""Share that is called "every case" or "consistently"."""

RATIO_FIGURE = Figure("MSE of the Jacobian / of the surrogate", round(RATIO, 2))
ERROR_FIGURE = Figure("MSE, surrogate minus Jacobian", None)
BETA_FIGURE = Figure("best beta", BETA)
RATES = tuple(Figure(f"{LABELS[n]} [frames/s]", FRAMES_PER_SECOND) for n in ("dnn", "phydnn"))
CASES_FIGURE = Figure("share of samples where PhyDNN is the best by all four metrics", 1.0)
COST_FIGURE = Figure("gradient of the exact model / of the surrogate", None)
UNSUPERVISED = (
    Figure("dip, a fit to every frame [frames/s]", None),
    Figure("PhyDNN, the network that alpha = 0 would train [frames/s]", None),
)
PLACE_FIGURE = Figure("error of the place, PhyDNN minus DNN [mm]", None)
FORCE_FIGURES = {
    scenario: Figure(f"relative error of the force, PhyDNN minus DNN, on {scenario}", None)
    for scenario in ("shapes", "presses")
}


_Array = NDArray[np.float64]


def _intervals(
    values: ArrayLike,
    clusters: ArrayLike,
    statistic: Callable[[_Array, _Array], _Array] = means,
) -> list[Interval]:
    """As `bootstrap`; of a single sample nothing is measured."""
    if len(np.asarray(values)) < 2:
        raise NotMeasuredError("One sample has no interval: run more of them.")
    return bootstrap(values, clusters, statistic)


def _tested(figure: Figure, interval: Interval, met: Range, n: int) -> Figure:
    ends = [interval.low, interval.high]
    return replace(
        figure,
        ours=interval.value,
        interval=ends if np.isfinite(ends).all() else None,  # samples of one session have none
        verdict=met.test(interval, n),
    )


def _exactly(figure: Figure, value: float, met: Range) -> Figure:
    """Test a figure that has no interval."""
    return replace(
        figure, ours=value, verdict=met.test(Interval(value, value, value), LEAST_SAMPLES)
    )


def _judged(
    figures: Sequence[Figure], why: str, measured: Measured | None = None, conditions: str = ""
) -> Judgement:
    n = None if measured is None else len(measured.samples)
    if n is not None and n < LEAST_SAMPLES:
        why += f" {n} samples are too few to decide: at least {LEAST_SAMPLES} are needed."
    return Judgement(
        together([figure.verdict for figure in figures if figure.verdict is not None]),
        tuple(figures),
        why,
        n,
        conditions or ("" if measured is None else measured.conditions),
    )


def _counted(figures: Sequence[Figure]) -> str:
    """Say how many of the tested figures have which verdict."""
    verdicts = [figure.verdict for figure in figures if figure.verdict is not None]
    met, missed = verdicts.count(Verdict.holds), verdicts.count(Verdict.fails)
    return f"{met} of {len(verdicts)} figures meet the rule, {missed} do not" + (
        f", {len(verdicts) - met - missed} undecided" if met + missed < len(verdicts) else ""
    )


def operator_row(name: str, evidence: Evidence) -> Judgement:
    """Test R of an operator; the unit of the published MSE is not stated."""
    measured = evidence.of(OPERATOR_RUNS, name)
    r, mse = operator_figures(name)
    ends = (measured.row[key] for key in ("r_low", "r_high"))
    interval = Interval(measured.row["r"], *(np.nan if end is None else end for end in ends))
    met = around(TABLE_I[name]["r"], **R_TOLERANCE)
    r = _tested(r, interval, met, len(measured.samples))
    variances = " and ".join(f"{row['mse'] / (1 - row['r'] ** 2):.2f}" for row in TABLE_I.values())
    return _judged(
        [r, replace(mse, ours=measured.row["mse"])],
        "R is taken over the responses to the touch of all samples at once. The published MSE is "
        "in a unit that is not stated. If its R is of the same voltages, all samples at once, they "
        "were not standardised to a variance of 1: an error is at least 1 - R^2 of the variance, "
        f"so that this is at most {variances} by the two rows.",
        measured,
    )


def operator_order(evidence: Evidence) -> Judgement:
    """Test if the surrogate's error is below the Jacobian's, sample by sample."""
    measured, learned, linear = evidence.paired(OPERATOR_RUNS, "surrogate", "jacobian", ["mse"])
    differences = learned - linear
    (interval,) = _intervals(differences, measured.samples["cluster"])
    figure = _tested(ERROR_FIGURE, interval, better("min"), len(differences))
    return _judged([figure], "The errors are compared on the same samples.", measured)


def operator_ratio(evidence: Evidence) -> Judgement:
    """Test the ratio of the errors of the Jacobian and the surrogate, on either side."""
    surrogate, learned, linear = evidence.paired(OPERATOR_RUNS, "surrogate", "jacobian", ["mse"])
    errors = np.hstack([linear, learned])
    (ratio,) = _intervals(errors, surrogate.samples["cluster"], _ratios)
    met = around(RATIO, **RATIO_TOLERANCE)
    figure = _tested(RATIO_FIGURE, ratio, met, len(errors))
    return _judged(
        [figure],
        f"The Jacobian's error is {ratio.value:.3g} times the surrogate's; published were "
        f"{RATIO:.2g} times. A larger ratio confirms nothing: it also says that our Jacobian is "
        "the weaker one.",
        surrogate,
    )


def _ratios(counts: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = (counts @ values).T
    return np.asarray(first / second)[:, None]


def table_row(method: str, evidence: Evidence) -> Judgement:
    """Test the row of a method in Table II.

    A learned method is to be as good as published or better; a classical one, whose row is worse
    than a constant image, is to agree on either side.
    """
    measured = evidence.of(METHOD_RUNS, method)
    figures = []
    samples = measured.samples
    intervals = _intervals(samples[list(IMAGE_METRICS)].to_numpy(), samples["cluster"])
    for name, figure, interval in zip(IMAGE_METRICS, row_figures(method), intervals, strict=True):
        met = around(TABLE_II[method][name], **TOLERANCES[name])
        if method not in CLASSICAL:
            met = towards(best_of(name), met)
        figures.append(_tested(figure, interval, met, len(measured.samples)))
    why = f"{_counted(figures)}."
    if method in CLASSICAL:
        why += (
            " Our images are scored as absolute maps. The table of readings of the published rows "
            "shows which simple mistakes would give which of its figures."
        )
    return _judged(figures, why, measured)


def _sides(
    pair: str, intervals: Sequence[Interval], n: int, metrics: Sequence[str] = IMAGE_METRICS
) -> list[Figure]:
    """Test the differences of the metrics between two methods."""
    figures = difference_figures(pair, metrics=metrics)
    return [
        _tested(figure, interval, better(best_of(name)), n)
        for name, figure, interval in zip(metrics, figures, intervals, strict=True)
    ]


def better_than(
    pairs: Sequence[tuple[str, str]],
    evidence: Evidence,
    *,
    scenarios: Sequence[str] = (SCENARIO,),
    metrics: Sequence[str] = IMAGE_METRICS,
) -> Judgement:
    """Test if the first method of each pair is better than the second, sample by sample."""
    figures: list[Figure] = []
    every: list[Measured] = []
    for scenario in scenarios:
        for first, second in pairs:
            measured, one, other = evidence.paired(METHOD_RUNS, first, second, metrics, scenario)
            differences = one - other
            pair = f"{LABELS[first]} minus {LABELS[second]}"
            if len(scenarios) > 1:
                pair += f" on {scenario}"
            found = _intervals(differences, measured.samples["cluster"])
            figures += _sides(pair, found, len(differences), metrics)
            every.append(measured)
    return _judged(
        figures,
        f"{_counted(figures)}. {_ONE_TRAINING}",
        min(every, key=lambda one: len(one.samples)),
        "; ".join(dict.fromkeys(one.conditions for one in every)),
    )


def phydnn_over_dnn_with_seeds(evidence: Evidence) -> Judgement:
    """Test PhyDNN minus DNN over seeds and samples, from the study `physics`."""
    study = evidence.study("physics")
    rows = {
        row["metric"]: row
        for row in study["rows"]
        if row["scenario"] == SCENARIO and row["physics"] == "surrogate"
    }
    if lacking := [name for name in IMAGE_METRICS if name not in rows]:
        raise NotMeasuredError(
            f"The study 'physics' has no {lacking[0]!r} of PhyDNN on the suite {SCENARIO!r}."
        )
    n = rows["psnr"]["n"]
    figures = _sides(
        "PhyDNN minus DNN",
        [
            Interval(rows[name]["difference"], rows[name]["low"], rows[name]["high"])
            for name in IMAGE_METRICS
        ],
        n,
    )
    seeds = len(rows["psnr"]["each_seed"])
    judgement = _judged(
        figures,
        f"Over {seeds} trainings of each that differ in their seed only, {_counted(figures)}. What "
        "other data and the exact operator say is shown under Studies.",
        conditions=training_budget(study),
    )
    return replace(judgement, n=n)


def every_case(evidence: Evidence) -> Judgement:
    """Test the share of samples where PhyDNN is the best of four methods by all four metrics."""
    ahead: list[NDArray[np.bool_]] = []
    signs = [1 if best_of(name) == "max" else -1 for name in IMAGE_METRICS]
    for other in ("noser", "tv", "dnn"):
        measured, ours, theirs = evidence.paired(METHOD_RUNS, "phydnn", other, IMAGE_METRICS)
        ahead.append(np.all(np.array(signs) * (ours - theirs) > 0, axis=1))
    n, count = len(ahead[0]), int(np.all(ahead, axis=0).sum())
    ends = binomtest(count, n).proportion_ci(LEVEL, method="wilson")
    interval = Interval(count / n, float(ends.low), float(ends.high))
    figure = _tested(CASES_FIGURE, interval, Range(low=NEARLY_ALL), n)
    return _judged([figure], f"It is the best of the four in {count} of {n} samples.", measured)


def real_presses(evidence: Evidence) -> Judgement:
    """Test PhyDNN minus DNN in the place of real presses."""
    return _median_differences(
        evidence,
        {"ohmc16": PLACE_FIGURE},
        "localisation_mm",
        "The published recordings are not available. These are a robot's presses on another skin, "
        "with networks trained in simulation for it; shapes are not known there, places are.",
    )


def force(evidence: Evidence) -> Judgement:
    """Test PhyDNN minus DNN in the force of simulated soft presses."""
    return _median_differences(
        evidence,
        FORCE_FIGURES,
        "force_error",
        "The paper prints no force. These are simulated presses on a foam whose law from pressure "
        "to conductivity is known, on a sensor whose networks were trained on other shapes, and on "
        "one whose networks were trained on such presses.",
    )


def _median_differences(
    evidence: Evidence, figures: Mapping[str, Figure], metric: str, why: str
) -> Judgement:
    """Test the median of PhyDNN minus DNN, over the samples for which the metric is defined.

    `figures` by scenario.
    """
    tested, every, conditions = [], [], []
    for scenario, figure in figures.items():
        measured, one, other = evidence.paired(METHOD_RUNS, "phydnn", "dnn", [metric], scenario)
        differences = one - other
        known = ~np.isnan(differences[:, 0])
        if not known.any():
            raise NotMeasuredError(f"{measured.run.path} holds no sample with a {metric!r}.")
        samples = measured.samples[known]
        (interval,) = _intervals(differences[known], samples["cluster"], medians)
        tested.append(_tested(figure, interval, better(best_of(metric)), len(samples)))
        every.append(replace(measured, samples=samples))
        share = f"{len(samples)} of " if len(samples) < len(known) else ""
        conditions.append(f"{share}{measured.conditions}")
    fewest = min(every, key=lambda one: len(one.samples))
    judgement = _judged(tested, why, fewest, "; ".join(conditions))
    return replace(judgement, why=f"{judgement.why} {_ONE_TRAINING}")


def loss_curves(columns: Sequence[str], evidence: Evidence) -> Judgement:
    """Test in how many epochs after the warm-up the losses of PhyDNN are below those of DNN."""
    curves = {name: curve.set_index("epoch") for name, curve in evidence.curves().items()}
    figures, told = [], []
    for figure, column in zip(curve_figures(columns), columns, strict=True):
        if lacking := [name for name, curve in curves.items() if column not in curve]:
            raise NotMeasuredError(f"The learning curve of {lacking[0]!r} has no {column!r}.")
        both = (curves["phydnn"][column] - curves["dnn"][column]).loc[WARM_UP_EPOCHS + 1 :].dropna()
        if both.empty:
            raise NotMeasuredError(
                f"The learning curves have no epoch after the warm-up of {WARM_UP_EPOCHS}: train "
                "for more epochs."
            )
        lower = float((both < 0).mean())
        figures.append(replace(figure, ours=lower, verdict=_of_share(lower)))
        told.append(f"{int((both < 0).sum())} of {len(both)} epochs ({column.replace('_', ' ')})")
    return _judged(
        figures,
        f"It is lower in {' and '.join(told)} after the warm-up. One training of each.",
        conditions="the learning curves of the weights in use",
    )


def curve_figures(columns: Sequence[str]) -> tuple[Figure, ...]:
    """Return a figure for every loss of the learning curves."""
    return tuple(
        Figure(f"share of epochs with the lower {column.replace('_', ' ')} loss", 1.0)
        for column in columns
    )


def _of_share(share: float) -> Verdict:
    """Judge "consistently": nearly always, mostly, or not."""
    if share >= NEARLY_ALL:
        return Verdict.holds
    return Verdict.in_part if share > 1 / 2 else Verdict.fails


def exact_gradient(evidence: Evidence) -> Judgement:
    """Test if the gradient of the exact model costs so much more than the surrogate's."""
    exact, learned = (evidence.of(OPERATOR_RUNS, name) for name in ("fem", "surrogate"))
    if exact.row["grad_ms"] is None or learned.row["grad_ms"] is None:
        raise NotMeasuredError("No gradient was timed.")
    ratio = exact.row["grad_ms"] / learned.row["grad_ms"]
    figure = _exactly(COST_FIGURE, ratio, Range(low=PROHIBITIVE))
    error = OPERATOR_METRICS["grad_cosine"].heading.lower()
    return _judged(
        [figure],
        "EIDORS and pyEIT were not timed. The exact model is differentiable here, at "
        f"{ratio:.2g} times the surrogate's time "
        f"({exact.row['grad_ms']:.2g} against {learned.row['grad_ms']:.2g} ms); the surrogate's "
        f"{error} with it is {learned.row['grad_cosine']:.3f}.",
        conditions=f"one thread of {same_machine(exact, learned)}",
    )


def frame_rate(evidence: Evidence) -> Judgement:
    """Test the rate of single frames, at their 99th percentile."""
    both = [evidence.of(METHOD_RUNS, name) for name in ("dnn", "phydnn")]
    if any(measured.row["frame_ms_p99"] is None for measured in both):
        raise NotMeasuredError(
            "The 99th percentile needs 1,000 warm single frames: run at least 1,000 samples with "
            "--jobs 1 on an idle machine."
        )
    slowest = [measured.row["frame_ms_p99"] for measured in both]
    figures = [
        _exactly(figure, 1e3 / ms, Range(low=FRAMES_PER_SECOND))
        for figure, ms in zip(RATES, slowest, strict=True)
    ]
    times = " and ".join(
        f"{ms:.3g} ms ({name})" for name, ms in zip(("DNN", "PhyDNN"), slowest, strict=True)
    )
    return _judged(
        figures,
        f"99 % of warm single frames take at most {times}; the board's own time is not in them.",
        conditions=f"one thread of {same_machine(*both)}",
    )


def unsupervised_rate(evidence: Evidence) -> Judgement:
    """Test if schemes that learn from voltages alone are too slow for the sensor's frame rate."""
    # The suite `objects` gives a method a minute for a frame; others stop `dip` on slow machines.
    both = [evidence.of(METHOD_RUNS, name, "objects") for name in ("dip", "phydnn")]
    if any(measured.row["frame_ms_p50"] is None for measured in both):
        raise NotMeasuredError("No warm single frame was timed.")
    rates = [1e3 / measured.row["frame_ms_p50"] for measured in both]
    slower = Range(high=FRAMES_PER_SECOND)
    return _judged(
        [_exactly(fig, rate, slower) for fig, rate in zip(UNSUPERVISED, rates, strict=True)],
        f"`dip` minimises the published loss with alpha = 0 for every frame, through the exact "
        f"model: {rates[0]:.2g} frames per second. A network that is trained with alpha = 0 is "
        f"PhyDNN's, and takes its time: {rates[1]:.2g}. The sensor makes {FRAMES_PER_SECOND:.0f}.",
        conditions=f"one thread of {same_machine(*both)}",
    )


def best_beta(evidence: Evidence) -> Judgement:
    """Say what the study `beta` found; smaller studies than the published one test nothing."""
    study = evidence.study("beta")
    rows = sorted((r for r in study["rows"] if "score" in r), key=lambda row: row["beta"])
    if not rows:
        raise NotMeasuredError("The study 'beta' has no training that came to its end.")
    betas, scores = (np.array([row[key] for row in rows]) for key in ("beta", "score"))
    best = int(np.argmax(scores))
    lacking = ["one seed"]
    if study["limit"] is not None:
        lacking.append(f"{study['limit']} training samples")
    if study["epochs"] is not None:
        lacking.append(f"{study['epochs']} epochs")
    if np.abs(np.log(betas / BETA_OF_MEANS)).min() > 0.01:
        lacking.append(f"no value within 1 % of {BETA_OF_MEANS:.2g}")
    return Judgement(
        Verdict.untestable,
        (replace(BETA_FIGURE, ours=float(betas[best])),),
        "The published loss sums squares over 6,400 pixels and 208 measurements, ours takes means: "
        f"the published {BETA} is {BETA_OF_MEANS:.2g} in our units, if their voltages have "
        "a variance of 1. "
        f"The study is too small to find a best value ({', '.join(lacking)}): S is "
        f"{scores[best]:.3f} at its best, and all of its {len(rows)} values span "
        f"{scores.min():.3f} to {scores.max():.3f}.",
        rows[best]["n"],
        training_budget(study),
    )
