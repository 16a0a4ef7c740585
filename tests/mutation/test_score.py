"""The stored score of mutation testing counts its mutants, and every survivor is explained."""

from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
STORED = ROOT / "docs" / "studies" / "mutation"


def test_the_score_counts_the_mutants_and_every_survivor_is_explained() -> None:
    mutants = pd.read_csv(STORED / "mutants.csv")
    score = pd.read_csv(STORED / "score.csv").set_index("module")
    assert mutants.groupby("module")["survived"].sum().to_dict() == score["survived"].to_dict()
    assert mutants.groupby("module").size().to_dict() == score["mutants"].to_dict()
    survivors = pd.read_csv(STORED / "survivors.csv")
    assert len(survivors) == score["survived"].sum()
    assert survivors["why"].notna().all()
    assert all((ROOT / module).is_file() for module in score.index)
