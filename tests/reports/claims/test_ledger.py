"""The claim ledger in its three forms."""

import json
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import made

from eitbench.benchmark import EitbenchError, InputError
from eitbench.benchmark.studies import architecture
from eitbench.benchmark.studies.readings import write_readings
from eitbench.reports.claims.claim import Verdict
from eitbench.reports.claims.ledger import Ledger, claim_ledger, table
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.page.ledger_page import FILES, to_markdown, write_ledger
from eitbench.scenarios.data.datasets import Dataset

NASTY = "a|b_<img src=x>`c`"
KEYS = {
    "id", "source", "claim", "verdict", "why", "figures", "n", "conditions", "tolerance", "command",
}  # fmt: skip


@pytest.fixture
def runs(
    build: Any, paper: Dataset, build_operators: Callable[..., Path], tmp_path: Path
) -> list[Path]:
    """PhyDNN failed with a nasty message in a nastily named folder; TV was not run."""
    truth = np.array(paper.conductivity)
    build.path, build.suite = tmp_path / "a <b> run", "paper"
    build.add(paper, "noser", 0.5 * (truth - 1) + 1)
    build.add(paper, "dnn", truth)
    build.add(paper, "phydnn", truth, lost=8)
    build.samples[2]["message"] = NASTY
    return [build.write(), build_operators({"surrogate": 1e-3, "jacobian": 0.1})]


@pytest.fixture
def found(runs: list[Path]) -> Ledger:
    return claim_ledger(runs)


class Page(HTMLParser):
    """Collects tags, identifiers, texts and whatever would be loaded from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.names: list[str] = []
        self.loaded: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "img"):
            self.open.append(tag)
        known = dict(attrs)
        self.names += [name for name in [known.get("id")] if name]
        self.loaded += [
            f"{tag} {name}"
            for name, value in known.items()
            if name in ("src", "href") and not str(value).startswith("data:")
        ]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures of networks: they take seconds to draw."""
    monkeypatch.setattr(architecture, "published_networks", dict)


def page_of(
    found: Ledger, runs: list[Path], folder: Path, curves: dict[str, pd.DataFrame] | None = None
) -> Page:
    write_ledger(found, runs, folder, curves)
    text = (folder / "claims.html").read_text(encoding="utf-8").replace("<br>", "")
    return Page(text.removeprefix("<!doctype html>"))


@pytest.mark.slow
def test_figures_of_studies_and_training_stand_beside_the_ledger(
    runs: list[Path], tmp_path: Path
) -> None:
    """Losses need both curves, and a study is one that was given."""
    betas = np.geomspace(1e-4, 0.5, 5)
    rows = [
        {"beta": beta, "score": 7.0, "score_low": 6.9, "score_high": 7.1, "n": 4}
        for beta in map(float, betas)
    ]
    summary = {
        "study": "beta", "suite": "paper", "epochs": 2, "limit": 9, "scored": 4,
        "training_hours": 0.5, "rows": rows,
    }  # fmt: skip
    study = tmp_path / "study"
    study.mkdir()
    (study / "summary.json").write_text(json.dumps(summary))
    curve = pd.DataFrame(
        {"epoch": [1, 2], "train": [2.0, 1.0], "validation": [2.0, 1.5],
         "train_physical": [1.0, 0.5], "validation_physical": [1.0, 0.7]}
    )  # fmt: skip
    found = claim_ledger(runs, [study])
    assert found["studies"] == [summary]
    (claim,) = (c for c in found["claims"] if c["id"] == "best-beta")
    assert claim["figures"][0]["ours"] == betas[0]
    told_of_no_operator = curve.drop(columns=["train_physical", "validation_physical"])
    curves = {"dnn": told_of_no_operator, "phydnn": curve}
    page = page_of(found, runs, tmp_path / "out", curves)
    assert page.tags.count("img") == 2
    assert page.loaded == []
    for stem in ("study-beta", "losses"):
        assert f"({stem}.png)" in (tmp_path / "out" / "claims.md").read_text()
        assert (tmp_path / "out" / f"{stem}.pdf").stat().st_size > 0
    with pytest.raises(InputError, match="eitbench study"):
        claim_ledger(runs, [tmp_path])


def test_plain_values_of_every_claim(found: Ledger) -> None:
    assert [claim["id"] for claim in found["claims"]] == [claim.name for claim in CLAIMS]
    assert all(set(claim) == KEYS for claim in found["claims"])
    assert sum(found["summary"].values()) == len(CLAIMS)
    assert found["summary"]["undecided"] == 6  # of 4 or 8 samples
    by_name = {claim["id"]: claim for claim in found["claims"]}
    assert by_name["table1-ratio"]["verdict"] == "undecided"
    assert by_name["table2-noser"]["n"] == 8
    assert by_name["table2-tv"]["verdict"] == "not testable"
    assert [run["suite"] for run in found["runs"]] == ["paper", "operators"]
    assert found["runs"][0]["data_hash"] == "3f2a1b9c"
    assert found["runs"][0]["weights"] == {"phydnn": "b10b"}


@pytest.mark.slow
def test_readings_are_shown_where_they_were_made(runs: list[Path], tmp_path: Path) -> None:
    plain = {
        "method": "noser", "frames": "as they are", "axes": "as they are", "background": True,
        "sign": 1, "strength": 1.0, "ssim": -0.0127, "cc": 0.84, "rie": 0.06, "psnr": 24.0,
    }  # fmt: skip
    exchanged = plain | {"axes": "exchanged", "cc": 0.1207}
    rows = [row | {"method": name} for name in ("noser", "tv") for row in (plain, exchanged)]
    write_readings(pd.DataFrame(rows), 600, tmp_path)
    found = claim_ledger(runs, [tmp_path])
    text = to_markdown(found)
    assert "| axes exchanged | **-0.0127** | **0.121** | 0.06 | 24 |" in text
    assert "| published | -0.0127 | 0.1207 | 1.213 | -1.0795 |" in text
    assert "axes exchanged" in page_of(found, runs, tmp_path / "out").text


@pytest.mark.slow
def test_the_files(found: Ledger, runs: list[Path], tmp_path: Path) -> None:
    written = write_ledger(found, runs, tmp_path / "new" / "folder")
    assert {path.name for path in written} == set(FILES.values())
    assert json.loads(written[1].read_text()) == found
    with pytest.raises(EitbenchError, match="claim ledger"):
        write_ledger(found, runs, written[0] / "below")


def test_figures_of_one_session_have_no_interval(build: Any, tmp_path: Path) -> None:
    """The first two or three touches of a scenario are of one session."""
    few = made("conductivity", 3, scenario="paper", inverse_crime=True)
    few.samples["cluster"] = "one"
    build.suite = "paper"
    build.add(few, "phydnn", np.array(few.conductivity))
    found = claim_ledger([build.write()])
    write_ledger(found, [build.path], tmp_path / "out")
    (claim,) = (of for of in found["claims"] if of["id"] == "table2-phydnn")
    assert claim["verdict"] == "undecided"
    assert all(of["ours"] is not None and of["interval"] is None for of in claim["figures"])


def test_the_page_needs_nothing_else_and_shows_names_as_they_are(
    found: Ledger, runs: list[Path], tmp_path: Path
) -> None:
    """Here are no figures, so that every tag of one would be a name's."""
    page = page_of(found, runs, tmp_path)
    assert page.open == []
    assert page.loaded == []
    assert not {"img", "script", "link", "iframe"} & set(page.tags)
    assert "a|b_<img src=x>c" in page.text  # what stands between backticks is code
    assert "a <b> run" in page.text
    assert set(page.names) == {claim.name for claim in CLAIMS}
    for claim in found["claims"]:
        assert claim["claim"] in page.text
        assert claim["command"] in page.text
    assert "phydnn (published)" in page.text  # the boards are there
    assert "surrogate (published)" in page.text


def test_markdown_has_one_table_row_per_figure_and_escapes_names(found: Ledger) -> None:
    text = to_markdown(found)
    assert "<img" not in text
    assert "a\\|b\\_&lt;img src=x&gt;\\`c\\`" in text
    lines = text.splitlines()
    for claim in found["claims"]:
        assert text.count(f"\n## {claim['id']}\n") == 1
        assert f"**{claim['verdict']}** – " in text
        if claim["command"]:
            assert f"- Command: `{claim['command']}`" in lines
    plain = text.replace("\\|", "")
    tables = [part for part in plain.split("\n\n") if part.startswith("|")]
    assert len(tables) == 1 + sum(bool(claim["figures"]) for claim in found["claims"])
    for rows in tables:
        assert len({line.count("|") for line in rows.splitlines()}) == 1, rows
    assert "| RIE | 1.213 |" in plain
    assert "424" not in text


def test_the_terminal_shows_every_verdict(found: Ledger) -> None:
    shown = table(found)
    assert list(shown.columns[0].cells) == [claim.name for claim in CLAIMS]
    assert {str(cell) for cell in shown.columns[1].cells} <= {verdict.value for verdict in Verdict}


def test_a_ledger_of_no_runs_and_of_no_run_directory(tmp_path: Path) -> None:
    found = claim_ledger([])
    assert found["summary"]["not testable"] == len(CLAIMS)
    assert page_of(found, [], tmp_path).open == []
    with pytest.raises(InputError, match="nothing"):
        claim_ledger([tmp_path / "nothing"])
