"""What priors are worth: one thing is taken away at a time, and differences are as by hand."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.metrics.statistics import bootstrap
from eitbench.benchmark.studies import priors
from eitbench.benchmark.studies.priors import PRIORS, Told, worth_of_priors
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.reports.studies.priors import priors_table, write_priors
from eitbench.scenarios import load
from eitbench.scenarios.suites.scenario import TOUCHES
from eitbench.scenarios.suites.suite import scenario_by_name

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_each_prior_takes_away_what_it_says_and_nothing_else() -> None:
    sensor = scenario_by_name("noise-50db").nominal_sensor
    told = Told(sensor, {"weight": 0.5, "variable": "clausius-mossotti"})
    changed = {}
    for name, without in PRIORS.items():
        left = without(told, "noser")
        different = {
            f.name
            for f in fields(sensor)
            if getattr(left.sensor, f.name) != getattr(sensor, f.name)
        }
        changed[name] = (different, left.parameters)
    assert changed["conductivity range"] == ({"conductivity_range"}, told.parameters)
    variable = {"weight": 0.5, "variable": "conductivity"}
    assert changed["Clausius-Mossotti"] == (set(), variable)
    clean = selected_parameters(scenario_by_name("noise-clean"), "noser")
    assert changed["noise level in tuning"] == (set(), clean)
    assert changed["contact impedance"] == ({"electrodes"}, told.parameters)
    wrong = PRIORS["contact impedance"](told, "noser").sensor.electrodes
    for one, other in zip(wrong, sensor.electrodes, strict=True):
        assert one == replace(other, contact_impedance=10 * other.contact_impedance)


@pytest.mark.slow
def test_the_worth_is_the_paired_difference_of_scores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(priors, "CLASSICAL", ("noser", "tikhonov"))
    monkeypatch.setattr(priors, "NETWORKS", ("linear-map",))
    monkeypatch.setattr(priors, "RIVAL", "noser")
    own = priors._scores
    rng = np.random.default_rng(0)
    network = {"noise-50db": rng.normal(9, 1, 6), "shapes": rng.normal(7, 1, 6)}
    monkeypatch.setattr(
        priors,
        "_scores",
        lambda prior, method, scenario, n: (
            network[scenario] if method == "linear-map" else own(prior, method, scenario, n)
        ),
    )
    table = worth_of_priors(samples=6)
    assert list(zip(table["prior"], table["method"], strict=True)) == [
        *((prior, method) for prior in PRIORS for method in ("noser", "tikhonov")),
        ("training phantoms", "linear-map"),
    ]
    told, wide = (
        own(None, "noser", "noise-50db", 6),
        own("conductivity range", "noser", "noise-50db", 6),
    )
    sessions = np.arange(6) // TOUCHES
    (expected,) = bootstrap((told - wide)[:, None], sessions)
    row = table.iloc[0]
    assert (row["known"], row["unknown"]) == pytest.approx((told.mean(), wide.mean()))
    assert (row["worth"], row["low"], row["high"]) == pytest.approx(expected)
    assert row["n"] == len(load("noise-50db", limit=6))
    # The lead of a network over its rival, on known families and on others.
    leads = [network[s] - own(None, "noser", s, 6) for s in ("noise-50db", "shapes")]
    last = table.iloc[-1]
    assert (last["known"], last["unknown"]) == pytest.approx([lead.mean() for lead in leads])
    assert last["worth"] == pytest.approx(leads[0].mean() - leads[1].mean())
    known, unknown = (bootstrap(lead[:, None], sessions)[0] for lead in leads)
    below = np.hypot(known.value - known.low, unknown.high - unknown.value)
    above = np.hypot(known.high - known.value, unknown.value - unknown.low)
    assert last["worth"] - last["low"] == pytest.approx(below)
    assert last["high"] - last["worth"] == pytest.approx(above)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    stored = pd.read_csv(DOCS / "studies" / "priors" / "priors.csv")
    assert set(stored["prior"]) == {*PRIORS, priors.PHANTOMS}
    write_priors(stored, tmp_path)
    table = (tmp_path / "priors.md").read_text()
    assert table == priors_table(stored)
    assert priors_table(pd.read_csv(tmp_path / "priors.csv")) == table
