"""Standings of 12 methods on 6,000 samples: 2,000 draws of every figure, ranks and pairs.

`pytest tests/speed/test_speed_standings.py --benchmark-only` prints the time; the aim is 10 s
on one core.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.metrics.specs import bounded_score, score
from eitbench.benchmark.rundir.kinds import METHOD_RUNS

SAMPLES, CONTESTANTS = 6000, 12


@pytest.fixture(scope="module")
def run() -> Run:
    rng = np.random.default_rng(0)
    shared = rng.normal(25, 4, SAMPLES)
    cells = []
    for k in range(CONTESTANTS):
        four = {
            "ssim": rng.uniform(0.8, 0.95, SAMPLES),
            "cc": rng.uniform(0.7, 0.95, SAMPLES),
            "rie": rng.uniform(0.03, 0.1, SAMPLES),
            "psnr": shared + 0.05 * k + rng.normal(size=SAMPLES),
        }
        rest = ("localisation_mm", "contact_count_error", "area_error", "iou")
        cells.append(
            pd.DataFrame(
                {
                    "suite": "bench", "scenario": "one", "method": f"method-{k}", "track": "tuned",
                    "sample": np.arange(SAMPLES), "phantom": np.arange(SAMPLES), "status": "ok",
                    **four, "score": score(**four), "bounded": bounded_score(four),
                    **{name: rng.exponential(size=SAMPLES) for name in rest},
                }
            )
        )  # fmt: skip
    table = pd.concat(cells, ignore_index=True)
    whole = table[["scenario", "method", "track"]].drop_duplicates()
    return Run(Path("bench"), METHOD_RUNS, {}, table, whole, {})


@pytest.mark.benchmark(group="standings of 12 methods on 6,000 samples")
def test_standings(benchmark: Any, run: Run) -> None:
    benchmark.pedantic(lambda: standings([run]), rounds=3)
