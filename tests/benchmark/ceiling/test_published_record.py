"""The published draws of the ceiling: as many truths are in their intervals as these say."""

import pandas as pd
import pytest

from eitbench.benchmark.ceiling.record import RECORDS
from eitbench.benchmark.metrics.statistics import bootstrap

STATED = [f"{of}coverage_{level}" for of in ("", "place_") for level in (50, 80, 95)]


@pytest.mark.parametrize("level", ["clean-at-70db", "60db", "50db", "40db", "30db"])
def test_intervals_of_the_ceiling_of_noise_hold_what_they_say(level: str) -> None:
    frames = pd.read_csv(RECORDS / "noise.csv")
    frames = frames[frames["scenario"] == f"noise-{level}"]
    assert len(frames) == 200
    for name in STATED:
        known = frames[frames[name].notna()]
        (share,) = bootstrap(known[[name]], known["cluster"])
        assert share.low <= int(name.rpartition("_")[2]) / 100 <= share.high, name
