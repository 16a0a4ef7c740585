"""Tables on pages are those of the stored runs."""

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
        ("generator/families", 20),
        ("priors/priors", 120),
        ("traps/traps", 120),
        ("peers/quick", 36),
    ):
        assert (pd.read_csv(DOCS / "studies" / f"{name}.csv")["n"] == n).all()
