"""Leaderboards of operators: ranks, small numbers, the published table beside ours."""

import csv
import io
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import write_operators

from eitbench.reports.figures.image_grid import write_figures
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.reports.tables.published import RATIO, TABLE_I
from eitbench.scenarios.errors import InputError

N = 4
MSE = {"surrogate": 8e-4, "fem": 3e-24, "jacobian": 1.62e-2, "halved": 5e-4}
CONTRACT = {
    "scenario", "operator", "n", "coverage", "mse", "r", "rel_error", "grad_cosine", "forward_ms",
    "grad_ms", "setup_s", "memory_mb", "train_s", "rank",
}  # fmt: skip


@pytest.fixture(scope="module")
def operator_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of operators, of which "halved" lost half of its samples."""
    path = write_operators(tmp_path_factory.mktemp("runs") / "operators", MSE)
    samples = pd.read_parquet(path / "samples.parquet")
    samples = samples.assign(rel_error=1e-3, grad_cosine=0.98765)
    lost = (samples["operator"] == "halved") & (samples["sample"] >= N // 2)
    samples.loc[lost, "status"] = "error"
    samples.loc[lost, ["mse", "rel_error", "grad_cosine"]] = np.nan
    samples.to_parquet(path / "samples.parquet")
    cells = pd.read_parquet(path / "operators.parquet")
    trained = cells["operator"] == "surrogate"
    cells.assign(
        r=[1 - 31 * mse for mse in MSE.values()],
        forward_ms=0.123456,
        grad_ms=2.5,
        setup_s=1e-5,
        memory_mb=312.7,
        train_s=np.where(trained, 7200.0, 0.0),
        trained_on=np.where(trained, "one GPU", ""),
    ).to_parquet(path / "operators.parquet")
    return path


def test_rows_hold_the_contract_ranked_by_mse(operator_run: Path) -> None:
    rows = ranked_rows([operator_run])
    assert all(set(row) >= CONTRACT for row in rows)
    assert [row["operator"] for row in rows] == ["fem", "surrogate", "jacobian", "halved"]
    assert [row["rank"] for row in rows] == [1, 2, 3, 4]
    assert rows[3]["coverage"] == 0.5  # and so after those that lost nothing
    assert rows[1]["mse"] == pytest.approx(MSE["surrogate"])
    assert rows[1]["r"] == pytest.approx(1 - 31 * MSE["surrogate"])
    assert (rows[1]["train_s"], rows[1]["trained_on"]) == (7200.0, "one GPU")
    assert json.loads(FORMATS["json"](rows)) == rows
    read = list(csv.DictReader(io.StringIO(FORMATS["csv"](rows))))
    assert [float(line["mse"]) for line in read] == [row["mse"] for row in rows]


@pytest.mark.parametrize("form", ["md", "latex", "html", "terminal"])
def test_the_published_table_stands_beside_ours(
    form: str, operator_run: Path, printed: Callable[..., str]
) -> None:
    text = printed(ranked_rows([operator_run]), form)
    for figure in ("1.62e-2", "8.00e-4", "3.00e-24", "2.57e-3", "0.99498", "0.97123", "0.97520"):
        assert figure in text
    plain = re.sub(r"\\", "", text)
    assert plain.count("surrogate (published)") == plain.count("jacobian (published)") == 1
    said = " ".join(plain.replace("&#x27;", "'").split())
    assert "standardised over the clean voltages of the validation split" in said
    assert "the surrogate's MSE is 20.2 times lower than the Jacobian's (published: 6.3)" in said
    assert "inverse crime" in said
    assert "PhyDNN" in said


def test_published_figures_are_not_results(operator_run: Path) -> None:
    rows = ranked_rows([operator_run])
    for form in ("json", "csv"):
        assert "published" not in FORMATS[form](rows)
    assert pytest.approx(6.3, abs=0.01) == RATIO
    assert TABLE_I["surrogate"] == {"mse": 2.57e-3, "r": 0.99498}
    line = next(x for x in FORMATS["md"](rows).splitlines() if "surrogate (published)" in x)
    assert "**" not in line


def test_without_both_there_is_no_ratio(operator_run: Path, printed: Callable[..., str]) -> None:
    rows = [row for row in ranked_rows([operator_run]) if row["operator"] != "jacobian"]
    text = printed(rows, "md")
    assert "times lower" not in text
    assert "(published)" in text


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_narrow_terminal_shows_the_ranking(
    width: int, operator_run: Path, printed: Callable[..., str]
) -> None:
    text = printed(ranked_rows([operator_run]), "terminal", width)
    assert max(map(len, text.splitlines())) <= width
    assert "8.00e-4" in text
    assert "surrogate (published)" in text


def test_operators_have_no_figures(operator_run: Path) -> None:
    assert write_figures(operator_run) == []
    assert not (operator_run / "figures").exists()


def test_methods_and_operators_are_not_ranked_together(operator_run: Path, full_run: Path) -> None:
    with pytest.raises(InputError, match=r"operators ranks operators and .*full methods: ask for"):
        ranked_rows([operator_run, full_run])


def test_runs_of_one_name_and_a_run_given_twice_are_refused(
    operator_run: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=rf"^{re.escape(str(operator_run))} is given twice\.$"):
        ranked_rows([operator_run, operator_run])
    other = shutil.copytree(operator_run, tmp_path / "x" / operator_run.name)
    said = f"same name 'operators' ({operator_run}, {other}): rename one."
    with pytest.raises(InputError, match=re.escape(said)):
        ranked_rows([operator_run, other])
