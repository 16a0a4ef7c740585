"""Runs that were made to deserve the verdicts on the published claims."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.made_runs import made

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.claims.claim import Judgement
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.scenarios.data.datasets import Dataset

N = 120
"""As many samples as decide something."""
NAMES = [claim.name for claim in CLAIMS]
Judgements = Callable[..., dict[str, Judgement]]


def findings(*runs: Path) -> dict[str, Judgement]:
    """The finding on every claim, by its name."""
    evidence = Evidence([read_run(run) for run in runs])
    return {claim.name: claim.judgement(evidence) for claim in CLAIMS}


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
