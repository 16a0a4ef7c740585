"""Quality against noise: the same phantoms at several levels, the ceiling and the untouched sensor.

Figures are PSNR of the mean squared error, which the ceiling is about. All are over the same
phantoms: those that every method has at every level, and of them, where the ceiling is known, those
that it is known for. A method with less than a tenth of the phantoms would decide for all, and has
no curve.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.benchmark.metrics.image_metrics import psnr_of_mean
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.suites.scenario import SimulatedScenario

LEVELS = 3
"""Fewer levels of noise are no curve."""
LEAST_SHARE = 0.1
"""Of the phantoms that the others have: a method with fewer has no curve."""
CEILING, UNTOUCHED = "ceiling", "untouched sensor"


@dataclass(frozen=True, eq=False)
class NoiseCurves:
    """Quality against noise.

    Attributes:
        psnr: [dB] of the mean squared error: a row for each method, the ceiling and the untouched
            sensor, a column for each level [dB]; clean frames are the infinite one, which have no
            ceiling. NaN where not known.
        n: number of phantoms.
    """

    psnr: pd.DataFrame
    n: int


def noise_curves(run: Run) -> NoiseCurves | None:
    """The curves of a run; None where it has fewer than `LEVELS` levels of the same phantoms."""
    ran = run.scenarios()
    if run.kind is not METHOD_RUNS or len(ran) < LEVELS:
        return None
    declared = run.manifest["plan"]["suite"]["scenarios"]
    levels_of = {str(of.get("noise", {}).get("test")) for of in declared if of["name"] in ran}
    if len(levels_of) < LEVELS:
        return None
    of: dict[str, list[SimulatedScenario]] = {}
    for scenario in suite_of(run.manifest).scenarios:
        if (
            scenario.name in ran
            and isinstance(scenario, SimulatedScenario)
            and scenario.acuity is None
            and scenario.noise.test != "mixture"
        ):
            # Of the same phantoms, sensors and meshes.
            same = json.dumps([scenario.clean_parameters("test"), scenario.calibrated])
            of.setdefault(same, []).append(scenario)
    levels = max(of.values(), key=len, default=[])
    if len({scenario.noise.test for scenario in levels}) < LEVELS:
        return None
    return _curves(run, levels)


def _curves(run: Run, scenarios: list[SimulatedScenario]) -> NoiseCurves:
    hashes = [run.manifest["data"][s.name]["hash"] for s in scenarios]
    known = [recorded_frames(s.name, of)["mse"] for s, of in zip(scenarios, hashes, strict=True)]
    cells = run.samples[run.samples["scenario"].isin([s.name for s in scenarios])]
    cells = _with_enough(cells[cells["psnr"].notna()])
    samples = set.intersection(
        *(set(of["sample"]) for _, of in cells.groupby(["scenario", "method"]))
    )
    for errors in known:
        # A record of none of these phantoms is as good as none.
        samples = samples & set(errors.index) or samples
    kept = sorted(samples)
    cells = cells[cells["sample"].isin(kept)]
    rows: dict[str, dict[float, float]] = {}
    for scenario, data_hash, least in zip(scenarios, hashes, known, strict=True):
        noise = scenario.noise.test
        level = float("inf") if isinstance(noise, str) else noise
        of = cells[cells["scenario"] == scenario.name]
        for method, cell in of.groupby("method"):
            rows.setdefault(str(method), {})[level] = psnr_of_mean(10 ** (-cell["psnr"] / 10))
        if set(kept) <= set(least.index):
            rows.setdefault(CEILING, {})[level] = psnr_of_mean(least.reindex(kept))
        if data_hash == scenario.data_hash("test"):  # else they are hidden, or of older data
            rows.setdefault(UNTOUCHED, {})[level] = _untouched(scenario, kept)
    table = pd.DataFrame.from_dict(rows, orient="index").sort_index(axis=1)
    return NoiseCurves(table, len(kept))


def _with_enough(cells: pd.DataFrame) -> pd.DataFrame:
    """The rows of the methods that have `LEAST_SHARE` of the phantoms, at one level at least."""
    count = cells.groupby(["method", "scenario"]).size().groupby("method").max()
    return cells[cells["method"].isin(count.index[count / count.max() >= LEAST_SHARE])]


def _untouched(scenario: SimulatedScenario, samples: list[int]) -> float:
    """PSNR [dB] of images that are the background."""
    sensor = scenario.nominal_sensor
    errors = []
    for sample in samples:
        truth = rasterise(phantom(scenario, "test", sample), sensor)
        errors.append(np.mean((truth - sensor.background)[sensor.mask] ** 2))
    return psnr_of_mean(np.array(errors) / sensor.data_range**2)
