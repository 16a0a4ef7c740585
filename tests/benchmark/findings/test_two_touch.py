"""Two touches told apart: shares and distances that can be counted by hand."""

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.findings.two_touch import WITHIN_MM, least_distance, told_apart


def touches(distance: float, farthest: list[float], count_error: list[float]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "scenario": "pairs", "method": "noser", "sample": np.arange(len(farthest)),
            "probe_distance_mm": distance, "contacts": 2 if distance else 1,
            "contact_count_error": count_error, "farthest_contact_mm": farthest,
            "localisation_mm": np.array(farthest) / 2,
        }
    )  # fmt: skip


def test_each_contact_is_nearer_than_half_the_distance_and_than_the_limit() -> None:
    found = told_apart(
        pd.concat(
            [
                touches(0, [3, 3], [0, 1]),
                # One contact in the middle is exactly half the distance from both.
                touches(30, [14.9, 15.0, 40.0, 3.0], [0, 1, 0, 2]),
                touches(np.nan, [3.0], [0]),  # recorded, at a distance that nobody noted
                touches(100, [WITHIN_MM - 0.1, WITHIN_MM, 49.0, 3.0], [0, 0, 0, 0]),
            ]
        )
    ).set_index("distance_mm")
    assert found["apart"].tolist()[1:] == [0.5, 0.5]
    assert np.isnan(found["apart"][0.0])
    assert found["counted"].tolist() == [0.5, 0.5, 1.0]
    assert found["n"].tolist() == [2, 4, 4]
    assert found["place_mm"][30.0] == pytest.approx(np.median([14.9, 15.0, 40.0, 3.0]) / 2)
    # Wilson's interval of 2 of 4, from its formula.
    z, n, share = 1.959964, 4, 0.5
    half = z * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    assert found["high"][30.0] - found["low"][30.0] == pytest.approx(2 * half, rel=1e-5)


def test_the_least_distance_holds_for_all_larger_ones() -> None:
    shares = {10.0: 0.9, 20.0: 0.2, 40.0: 0.5, 60.0: 0.8, 0.0: np.nan}
    table = pd.DataFrame({"distance_mm": list(shares), "apart": list(shares.values())})
    apart = table.set_index("distance_mm")["apart"]
    assert least_distance(apart) == 40
    assert np.isnan(least_distance(0 * apart + 0.4))


def test_rows_without_pairs_say_nothing() -> None:
    single = touches(0, [3.0], [0])
    assert told_apart(single).empty
    assert told_apart(single.drop(columns="probe_distance_mm")).empty
    assert told_apart(pd.DataFrame()).empty
