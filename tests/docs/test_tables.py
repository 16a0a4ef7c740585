"""Tables on pages are those of the stored runs."""

import json
import re
from pathlib import Path

import pandas as pd
from docs.tables import TABLES, filled, pages

DOCS = Path(__file__).parents[2] / "docs"


def test_every_table_is_that_of_its_record() -> None:
    used = []
    for page in pages():
        text = page.read_text()
        assert filled(text) == text, f"{page} differs from its records: run `make tables`"
        used += re.findall(r"<!-- table: (.+?) -->", text)
        assert text.count("<!-- table: ") == text.count("<!-- end of table -->")
    assert sorted(used) == sorted(TABLES)


def test_a_figure_that_was_typed_is_put_right() -> None:
    text = (DOCS / "results" / "data.md").read_text()
    typed = text.replace("30.42", "32.42")
    assert typed != text
    assert filled(typed) == text


def test_runs_behind_the_tables_are_as_large_as_pages_say() -> None:
    for name, n in (
        ("generator/generators", 120),
        ("noise/boards", 120),
        ("noise/families", 20),
        ("priors/priors", 120),
        ("traps/traps", 120),
        ("peers/quick", 36),
    ):
        assert (pd.read_csv(DOCS / "studies" / f"{name}.csv")["n"] == n).all()


def test_bounds_beside_real_skins_are_as_the_page_says() -> None:
    """What docs/design.md says in words of the ratios and orders in its tables."""
    record = json.loads((DOCS / "studies" / "design" / "record.json").read_text())
    by = {(row["predicted"], row["measured"]): row for row in record["over_skins"]}
    assert all(row["ratio_least"] > 1 for row in by.values())
    learned, image = by["noise", "kernel_ridge"], by["noise", "noser"]
    assert learned["spearman"] > 0.8
    assert learned["ratio_most"] < 5
    assert image["ratio_least"] > 4
    assert image["p"] > 0.05
    assert all(row["over_places"] < row["over_places_possible"] / 2 for row in by.values())
    skins = pd.read_csv(DOCS / "studies" / "design" / "skins.csv")
    beaten = skins["noise_with_outliers_mm"] > skins["kernel_ridge_mm"]
    assert 0 < beaten.sum() < len(skins) / 2
    assert len(skins) == image["skins"]
    assert skins["signal_to_noise"].corr(skins["kernel_ridge_mm"], method="spearman") < -0.8
    much = skins["explained"] > 0.1
    better = skins["likely_misfit_mm"] / skins["likely_noise_mm"]
    assert better[much].max() < 0.5
    assert better[~much].median() > 1


def test_the_doctor_answers_as_its_page_says() -> None:
    """What docs/wiring.md says in words: sure with a known frame, refused for skins without."""
    stored = pd.read_csv(DOCS / "studies" / "wiring" / "wiring.csv")
    known = (
        stored[stored["evidence"] == "known frame"].groupby("set")[["n", "right", "wrong"]].sum()
    )
    assert (known["wrong"] < 0.01 * known["n"]).all()
    assert (known["right"] >= 0.95 * known["n"]).all()
    skin = stored["set"].str.match("ohmc|superpose|hydrogel")
    alone = stored[skin & (stored["evidence"] == "model")]
    assert (alone["refused"] == alone["n"]).all()
    misfits = pd.read_csv(DOCS / "studies" / "wiring" / "misfits.csv")
    on_skin = misfits["set"].str.match("ohmc|superpose|hydrogel")
    assert (misfits["right"] > misfits["best"])[on_skin].all()
    assert (misfits["right"] == misfits["best"])[~on_skin].all()
