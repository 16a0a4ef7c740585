"""Tables on pages are those of the stored runs."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest
from docs.tables import TABLES, filled, pages
from docs.tables.drawings import DRAWINGS
from docs.tables.figures import with_figures

from eitbench.scenarios.errors import InputError

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
def test_every_table_is_that_of_its_record() -> None:
    used = []
    for page in pages():
        text = page.read_text()
        assert filled(text) == text, f"{page} differs from its records: run `make tables`"
        used += re.findall(r"<!-- table: (.+?) -->", text)
        assert text.count("<!-- table: ") == text.count("<!-- end of table -->")
    assert sorted(used) == sorted(TABLES)


def test_a_figure_that_was_typed_is_put_right() -> None:
    text = (DOCS / "results" / "priors.md").read_text()
    typed = text.replace("| 5.554 |", "| 5.654 |")
    assert typed != text
    assert filled(typed) == text


def test_a_typed_figure_of_a_sentence_is_put_right() -> None:
    lines = (DOCS / "results" / "learned.md").read_text().splitlines()
    figure = r"(wide/wide.csv each_seen .*? -->)100<"
    (text,) = (line for line in lines if re.search(figure, line))
    typed = re.sub(figure, r"\g<1>10<", text)
    assert typed != text
    assert filled(typed) == text


@pytest.mark.parametrize(
    ("asked", "printed"),
    [
        ("loss/loss.csv psnr .2f loss=mse seed=1", "22.25"),
        ("loss/loss.csv eitbench s loss=mse seed=1", "0.1.0"),
        ("size/summary.json rows.psnr .1f samples=750 backbone=unet", "21.9"),
        ("size/summary.json training_hours g", "0.3"),
        pytest.param(
            "ledger claims.figures.0.interval.1 .3f id=real-presses",
            "0.111",
            marks=pytest.mark.slow,
        ),
        ("scenarios/suites/scenario.py GENERATOR_VERSION d", "2"),
    ],
)
def test_a_figure_is_that_of_its_record(asked: str, printed: str) -> None:
    """Against the files as they were when this was written."""
    text = f"It is <!-- figure: {asked} -->?<!-- end --> here."
    assert with_figures(text) == text.replace("?", printed)


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ("loss/lost.csv psnr .2f", "Python file 'loss/lost.csv'"),
        ("loss/measure.txt x d", "Python file 'loss/measure.txt'"),
        ("loss/loss.csv psnr .2f loss=l1", "No rows fit"),
        ("loss/loss.csv psnr .2f loss=mse", "3 rows fit"),
        ("loss/loss.csv psnr .2f seeds=1", "no column 'seeds'"),
        ("loss/loss.csv pnsr .2f loss=mse seed=1", "no 'pnsr'"),
        ("size/summary.json hours .2f", "no 'hours'"),
        ("scenarios/suites/scenario.py GENERATION d", "no 'GENERATION'"),
        ("loss/loss.csv eitbench .2f loss=mse seed=1", "is not printed as '.2f'"),
        ("loss/loss.csv psnr", "A figure is SOURCE NAME FORMAT"),
    ],
)
def test_a_figure_without_a_record_is_refused(asked: str, why: str) -> None:
    with pytest.raises(InputError, match=re.escape(why)):
        with_figures(f"It is <!-- figure: {asked} -->1<!-- end -->.")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("It is\n<!-- figure: x.csv y d -->1<!-- end -->.", "begins a line"),
        ("- <!-- figure: x.csv y d -->1<!-- end --> of them.", "begins a line"),
        ("It is <!-- figure: loss/loss.csv psnr d -->1 dB.", "has no `<!-- end -->`"),
    ],
)
def test_a_figure_that_would_spoil_its_page_is_refused(text: str, why: str) -> None:
    with pytest.raises(InputError, match=re.escape(why)):
        with_figures(text)


def test_every_drawing_of_a_record_is_on_a_page() -> None:
    shown = {
        name
        for page in pages()
        for name in re.findall(r"!\[.*?\]\(.*?([\w-]+\.\w+)\)", page.read_text())
    }
    assert set(DRAWINGS) <= shown
    assert all((DOCS / name).is_file() for name in DRAWINGS)


def test_runs_behind_the_tables_are_as_large_as_pages_say() -> None:
    for name, n in (
        ("priors/priors", 120),
        ("traps/traps", 120),
        ("peers/quick", 36),
    ):
        assert (pd.read_csv(DOCS / "studies" / f"{name}.csv")["n"] == n).all()


def test_the_sweep_finds_the_best_as_the_page_on_tuning_says() -> None:
    rules = pd.read_csv(DOCS / "studies" / "tuning" / "rules.csv")
    assert (rules["sweep_worst"] == 0).all()
    assert (rules[["tpe", "tpe_after_5"]] > 0).all(axis=None)


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
