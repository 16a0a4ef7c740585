"""Reports of studies: paired differences, means, a figure."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark import InputError
from eitbench.benchmark.studies.training_study import METRICS
from eitbench.reports.studies.training_study import write_study

RNG = np.random.default_rng(0)


def stored(folder: Path, name: str, rows: list[dict[str, Any]]) -> list[Path]:
    """Write the report of a study with these rows."""
    pd.DataFrame(rows).to_parquet(folder / "samples.parquet")
    asked = {"study": name, "suite": "tiny", "epochs": 2, "limit": 9, "scored": 3}
    (folder / "study.json").write_text(json.dumps({**asked, "operator": "fem"}))
    return write_study(folder)


def figures(score: float, **others: float) -> dict[str, float]:
    return dict.fromkeys(METRICS, 0.5) | {"score": score, "train_s": 1800.0} | others


def summary(folder: Path) -> Any:
    return json.loads((folder / "summary.json").read_text())


def test_differences_are_paired_by_seed_and_sample(tmp_path: Path) -> None:
    """The effect shows, although samples and seeds differ by far more."""
    rows = []
    for scenario, effect in (("easy", 0.2), ("hard", -0.1)):
        for seed in range(3):
            for sample in RNG.permutation(40):
                level = 10 * sample + 100 * seed
                rows += [
                    {"physics": p, "seed": seed, "scenario": scenario, "sample": int(sample)}
                    | figures(0.0, psnr=level + (p != "none") * (effect + 0.01 * seed))
                    for p in ("fem", "none")
                ]
    written = stored(tmp_path, "physics", rows)
    assert all(path.stat().st_size > 0 for path in written)
    assert {path.name for path in written} == {
        "summary.json", "summary.md", "study.png", "study.pdf",
    }  # fmt: skip
    found = {(r["scenario"], r["metric"]): r for r in summary(tmp_path)["rows"]}
    assert len(found) == 2 * len(METRICS)
    for scenario, effect in (("easy", 0.2), ("hard", -0.1)):
        row = found[scenario, "psnr"]
        assert row["each_seed"] == pytest.approx([effect, effect + 0.01, effect + 0.02])
        assert row["difference"] == pytest.approx(effect + 0.01)
        half = 4.302653 * 0.01 / np.sqrt(3)  # Student's t with 2 degrees of freedom
        assert row["low"] == pytest.approx(effect + 0.01 - half, abs=1e-6)
        assert row["high"] == pytest.approx(effect + 0.01 + half, abs=1e-6)
        assert (row["physics"], row["n"]) == ("fem", 40)
    assert summary(tmp_path)["training_hours"] == 3.0  # six trainings of half an hour
    assert "| easy | fem | psnr |" in (tmp_path / "summary.md").read_text()

    # A training that diverged is stored as a row without figures.
    lost = {"physics": "fem", "seed": 3, "scenario": "", "sample": 0, "train_s": 60.0}
    alone = [row | {"seed": 3} for row in rows if row["physics"] == "none" and row["seed"] == 0]
    stored(tmp_path, "physics", [*rows, lost, *alone])
    assert {(r["scenario"], r["metric"]): r for r in summary(tmp_path)["rows"]} == found
    with pytest.raises(InputError, match="those of all seeds diverged"):
        stored(tmp_path, "physics", [lost, *alone])


def test_the_mean_of_every_choice_has_its_interval_and_a_lost_one_stands_empty(
    tmp_path: Path,
) -> None:
    rows: list[dict[str, Any]] = [
        {"beta": beta, "scenario": "tiny", "sample": k, "cluster": f"tiny {k // 3}"}
        | figures(7 - beta + 0.1 * (k % 2))
        for beta in (0.001, 0.1)
        for k in range(20)
    ]
    rows.append({"beta": 0.5, "scenario": ""})
    stored(tmp_path, "beta", rows)
    found = summary(tmp_path)["rows"]
    assert [row["beta"] for row in found] == [0.001, 0.1, 0.5]
    assert found[0]["score"] == pytest.approx(7.049)
    assert found[0]["score_low"] < 7.049 < found[0]["score_high"]
    assert "score" not in found[2]


def test_what_is_no_finished_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="eitbench study"):
        write_study(tmp_path)
