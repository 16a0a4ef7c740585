"""Figures of the ceiling: of the posterior mean of every frame, and how far draws can be trusted.

The mean of the posterior has the least expected squared error of all estimates (Lehmann and
Casella, Theory of Point Estimation, 1998, 4.1). The mean of draws that have not converged has a
larger one. The product of two samplers' errors is the error of the posterior mean and what both
samplers err by alike; what is chance, of one sampler alone, cancels on average. (Only samplers
that err in opposite directions would make it too small.) SSIM, CC, RIE, place and the mean of the
frames' PSNR have optima of their own, and the figures of the same mean are a reference there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from eitbench.benchmark.ceiling.agreement import (
    AGREED,
    ROUNDING,
    TRACES,
    greatest_rhat,
    traces,
)
from eitbench.benchmark.ceiling.drawing import (
    RUNS,
    SEEDS,
    VERSION,
    draws_of,
    priors_of,
    told,
)
from eitbench.benchmark.ceiling.models import images
from eitbench.benchmark.ceiling.moves import PROPOSALS, Proposals
from eitbench.benchmark.ceiling.record import (
    CURVES,
    recorded_frames,
    recorded_runs,
    traces_held,
)
from eitbench.benchmark.ceiling.sampler import CORRECTED, LIBRARY, PARTICLES, Draws
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.image_metrics import psnr_of_mean
from eitbench.benchmark.metrics.statistics import bootstrap, means
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY, kept_of_draws, sample_figures
from eitbench.benchmark.rundir.manifest import environment
from eitbench.methods.method import DRAWS
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json
from eitbench.scenarios.suites.scenario import Scenario

FIGURES = ("psnr", "ssim", "cc", "rie", "localisation_mm")
STATED = tuple(name for name in UNCERTAINTY if name != "uncertainty_ms")


def frames_table(
    folder: Path,
    scenarios: Sequence[Scenario],
    samples: int,
    *,
    record: bool = False,
) -> pd.DataFrame:
    """One row for each of the first `samples` frames of scenarios of which `folder` holds draws.

    With `record`, rows of the others that the product's own record has are taken from there.

    Columns: `scenario`, `sample`, `version` of the sampler, `input_hash`, `cluster`, `family`,
    `snr_db` and `touch_snr_db` of the frame; `FIGURES` of the mean of both samplers' means; squared
    errors over the square of the sensor's data range: `mse` of the posterior mean, estimated by the
    product of both samplers' errors, in which the chance of their draws cancels, `mse_<proposals>`
    of each alone, and `expected_mse`, the variance of the posterior; `rhat`, the greatest of the
    traces; `effective`, of the draws of either sampler the lesser (`Draws.effective`);
    `surpassed`, see `Posterior`, which frames by versions up to 8 lack;
    `rank_<trace>`, the share of draws below the truth, and of those equal to it but for rounding as
    many as chance says; `true_<trace>` and `sd_<trace>`, the truth
    and the posterior's standard deviation; `likely_<family>`, the probabilities; `STATED`, the
    figures of the posterior as an uncertainty, and its curves as texts of numbers, see
    `record.curves_of`.

    Raises:
        InputError: none of these frames has draws.
    """
    rows = []
    for scenario in map(told, scenarios):
        data = load(scenario, "test", samples)
        recorded = recorded_frames(scenario.name, scenario.data_hash("test") if record else None)
        recorded = recorded[recorded["sample"] < samples]
        truth = data.conductivity
        assert truth is not None
        families = [prior.parameters for prior in priors_of(scenario)]
        found, estimates, which = [], [], []
        for sample in range(len(data)):
            drawn = draws_of(folder, scenario.name, sample, data.frame_hashes[sample])
            if drawn is None:
                continue
            row, mean = _frame(data, sample, truth[sample], drawn.draws, families)
            found.append(row | {"surpassed": drawn.surpassed})
            estimates.append(mean)
            which.append(sample)
        of_scenario = [recorded[~recorded["sample"].isin(which)]]
        if found:
            filled = np.full((len(data), *data.sensor.image_shape), data.sensor.background)
            filled[which] = np.array(estimates)
            scored = evaluate(data, filled).iloc[which].reset_index(drop=True)
            of_scenario.append(pd.concat([pd.DataFrame(found), scored[list(FIGURES)]], axis=1))
        if there := [table for table in of_scenario if len(table)]:
            rows.append(pd.concat(there).sort_values("sample"))
    if not rows:
        raise InputError(f"{folder} holds no draws of these scenarios: draw some first.")
    return pd.concat(rows, ignore_index=True)


def _frame(
    data: Dataset,
    sample: int,
    truth: Array,
    drawn: Mapping[Proposals, Draws],
    families: list[Parameters],
) -> tuple[dict[str, object], Array]:
    """Figures of one frame, and its posterior mean (H, W) [S/m]."""
    background = data.sensor.background
    painted = {k: background * images(families, d.families, d.vectors) for k, d in drawn.items()}
    weights = {k: d.weights / d.weights.sum() for k, d in drawn.items()}
    alone = {k: np.tensordot(weights[k], painted[k], axes=1) for k in PROPOSALS}
    mean = np.mean([alone[k] for k in PROPOSALS], axis=0)
    pixels = data.sensor.mask
    squares = [weights[k] @ ((painted[k] - mean)[:, pixels] ** 2).mean(axis=1) for k in PROPOSALS]
    errors = {k: (alone[k] - truth)[pixels] / data.sensor.data_range for k in PROPOSALS}
    traced = {k: traces(painted[k], data.sensor) for k in PROPOSALS}
    both = np.concatenate([traced[k] for k in PROPOSALS])
    weight = np.concatenate([weights[k] for k in PROPOSALS]) / len(PROPOSALS)
    (true,) = traces(truth[None], data.sensor)
    chance = generator("ceiling", "ties", data.scenario, sample).random(len(TRACES))
    near = ROUNDING * np.abs(both).max(axis=0)
    below = weight @ (both < true - near) + chance * (weight @ (np.abs(both - true) <= near))
    deviations = np.sqrt(weight @ (both - weight @ both) ** 2)
    family = np.concatenate([drawn[k].families for k in PROPOSALS])
    likely = dict.fromkeys((of.family.name for of in families), 0.0)
    for of, share in zip(families, np.bincount(family, weight, len(families)), strict=True):
        likely[of.family.name] += float(share)
    chance_of = generator("ceiling", "draws", data.scenario, sample)
    chosen = chance_of.choice(len(weight), DRAWS, p=weight / weight.sum())
    draws = np.concatenate([painted[k] for k in PROPOSALS])[chosen].astype(np.float32)
    kept = kept_of_draws(
        truth[None], draws[None], mean[None].astype(np.float32), data.sensor, placed=True
    )
    stated = sample_figures(kept, kept["places"], locate(truth[None] - background, data.sensor))
    about = data.samples.iloc[sample]
    return {
        "scenario": data.scenario,
        "sample": sample,
        "version": VERSION,
        "input_hash": data.frame_hashes[sample],
        "cluster": about["cluster"],
        "family": about["family"],
        "snr_db": about["snr_db"],
        "touch_snr_db": about["touch_snr_db"],
        "mse": float(np.mean(np.prod(list(errors.values()), axis=0))),
        **{f"mse_{k}": float(np.square(error).mean()) for k, error in errors.items()},
        "expected_mse": float(np.mean(squares)) / data.sensor.data_range**2,
        "rhat": greatest_rhat(*zip(*((traced[k], weights[k]) for k in PROPOSALS), strict=True)),
        "effective": min(d.effective for d in drawn.values()),
        **{f"rank_{name}": float(below[t]) for t, name in enumerate(TRACES)},
        **{f"true_{name}": float(value) for name, value in zip(TRACES, true, strict=True)},
        **{f"sd_{name}": float(deviations[t]) for t, name in enumerate(TRACES)},
        **{f"likely_{name}": share for name, share in likely.items()},
        **{name: float(values[0]) for name, values in stated.items() if name in STATED},
        **{name: " ".join(f"{value:.3g}" for value in kept[name][0].flat) for name in CURVES},
    }, mean  # fmt: skip


def trusted(frames: pd.DataFrame) -> pd.Series:
    """True where both samplers agree on all traces of a frame."""
    return frames["rhat"] < AGREED


def exactly_weighted(frames: pd.DataFrame) -> pd.Series:
    """True where the draws of both samplers are of the exact model; see `sampler`."""
    return frames["effective"] >= CORRECTED


def summary(frames: pd.DataFrame) -> pd.DataFrame:
    """One row per scenario of a table of frames.

    Columns: `scenario`, `snr_db` and `n`; means of `FIGURES`, of the place the median;
    `psnr_of_mse` [dB] with its 95 % interval `low` and `high`; `expected_psnr` [dB], the same by
    the variance of the posterior, and `image_psnr`, that of the mean image itself; `apart_db`, how
    far that of one sampler is above that of the other, `apart_low` and `apart_high`; `agreed`, the
    share of trusted frames, and `exact`, of those with exact weights, and `agreed_psnr` and
    `exact_psnr` [dB] as `psnr_of_mse` of these frames alone; `worst`, the share of the squared
    error that one frame has; `within_50`, `within_80` and `within_95`, the share of true traces
    within central intervals of the posterior; `uniform_p`, the least p-value of Kolmogorov and
    Smirnov's test that the ranks of a trace are uniform, times the number of traces; `width_p`, the
    same of the distances of ranks from the middle, which tells draws that are too sure or too wide
    from right ones with fewer frames.
    """
    return pd.DataFrame(
        [_summary(str(name), of) for name, of in frames.groupby("scenario", sort=False)]
    )


def _summary(scenario: str, of: pd.DataFrame) -> dict[str, object]:
    errors = of[["mse", *(f"mse_{k}" for k in PROPOSALS)]].to_numpy()
    whole, apart = bootstrap(errors, of["cluster"], _decibels)
    ranks = of[[f"rank_{name}" for name in TRACES]].to_numpy()
    uniform_p, width_p = (
        min(1.0, len(TRACES) * min(stats.kstest(column, "uniform").pvalue for column in table.T))
        for table in (ranks, np.abs(2 * ranks - 1))
    )
    return {
        "scenario": scenario,
        "snr_db": float(of["snr_db"].iloc[0]),
        "n": len(of),
        **{name: float(of[name].mean()) for name in FIGURES if name != "localisation_mm"},
        "localisation_mm": float(of["localisation_mm"].median()),
        **dict(zip(("psnr_of_mse", "low", "high"), whole, strict=True)),
        "expected_psnr": psnr_of_mean(of["expected_mse"]),
        "image_psnr": psnr_of_mean(10 ** (-of["psnr"] / 10)),
        **dict(zip(("apart_db", "apart_low", "apart_high"), apart, strict=True)),
        "agreed": float(trusted(of).mean()),
        "exact": float(exactly_weighted(of).mean()),
        "agreed_psnr": psnr_of_mean(of["mse"][trusted(of)]),
        "exact_psnr": psnr_of_mean(of["mse"][exactly_weighted(of)]),
        "worst": float(of["mse"].max() / of["mse"].sum()),
        **{f"within_{level}": traces_held(of, level) for level in (50, 80, 95)},
        "uniform_p": uniform_p,
        "width_p": width_p,
    }


def _decibels(counts: Array, errors: Array) -> Array:
    """PSNR (b, 2) of the first mean of `errors` (n, 3), and of the second over the third."""
    mean = means(counts, errors)
    return -10 * np.log10(np.stack([mean[:, 0], mean[:, 1] / mean[:, 2]], axis=1))


def write_record(
    draws: Path,
    suite: str,
    scenarios: Sequence[Scenario],
    samples: int,
    out: Path,
    *,
    record: bool = False,
) -> pd.DataFrame:
    """Write `SUITE.csv` and `SUITE.json` into the folder `out`, from draws; returns the frames.

    For `record` see `frames_table`.

    Raises:
        InputError: no draws of the scenarios' frames.
    """
    frames = frames_table(draws, scenarios, samples, record=record)
    named = ",".join(scenario.name for scenario in scenarios)
    runs = recorded_runs(suite) if record else []
    earlier = [run for run in runs if run["sampler"]["version"] in set(frames["version"])]
    about = {
        "command": f"eitbench ceiling {suite} --scenarios {named} --samples {samples} "
        f"{'--record ' * record}--out DIR",
        "sampler": {
            "version": VERSION,
            "particles_per_term": PARTICLES,
            "library": LIBRARY,
            "runs": RUNS,
            "seeds": SEEDS,
        },
        "data": {
            of.name: of.data_hash("test")
            for of in map(told, scenarios)
            if of.name in set(frames["scenario"])
        },
        **environment(),
        # Other runs by the samplers whose frames stand in the table.
        "earlier": earlier,
    }
    table = frames.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    atomic_write(out / f"{suite}.csv", table.encode())
    atomic_write_json(out / f"{suite}.json", about)
    return frames
