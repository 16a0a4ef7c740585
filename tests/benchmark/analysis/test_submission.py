"""A run as it is passes; whatever is edited in it is found."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pandas as pd
import pytest

from eitbench.benchmark.analysis import submission
from eitbench.benchmark.analysis.submission import CHECKS, check_submission
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.reports.tables.leaderboard import ranked_rows, write_leaderboard
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import Suite


@pytest.fixture(scope="module")
def submitted(tmp_path_factory: pytest.TempPathFactory, tiny: Suite) -> Path:
    out = tmp_path_factory.mktemp("runs") / "mine"
    run = start_run(make_plan(tiny, methods=["noser", "tikhonov"]), out).path
    write_leaderboard(ranked_rows([run]), run)
    return run


@pytest.fixture(autouse=True)
def packaged(monkeypatch: pytest.MonkeyPatch, tiny: Suite) -> None:
    monkeypatch.setattr(submission, "suites", lambda: {"tiny": None})
    monkeypatch.setattr(submission, "load_suite", lambda name: tiny)


def test_an_honest_run_passes(submitted: Path) -> None:
    checks = check_submission(submitted)
    assert [check.name for check in checks] == list(CHECKS)
    assert [check.problem for check in checks] == [""] * 7


Edit = Callable[[Path], object]


def edit_samples(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Edit:
    def edit(run: Path) -> None:
        change(pd.read_parquet(run / "samples.parquet")).to_parquet(run / "samples.parquet")

    return edit


def set_in_a_row(name: str, value: object) -> Edit:
    return edit_samples(lambda t: t.assign(**{name: t[name].where(t.index != 2, value)}))


def edit_json(change: Callable[[Any], object], name: str = "manifest.json") -> Edit:
    def edit(run: Path) -> None:
        content = json.loads((run / name).read_text())
        change(content)
        (run / name).write_text(json.dumps(content))

    return edit


def copy_image(source: str, target: str) -> Edit:
    def edit(run: Path) -> None:
        with h5py.File(run / "reconstructions.h5", "a") as file:
            file[f"tiny/{target}/conductivity"][1] = file[f"tiny/{source}/conductivity"][1]

    return edit


def drop_a_method(run: Path) -> None:
    edit_samples(lambda table: table[table["method"] != "noser"])(run)
    edit_json(lambda m: m.update(cells=[c for c in m["cells"] if c["name"] != "noser"]))(run)


def add_a_figure(run: Path) -> None:
    """Figures of methods come from their samples alone: this changes nothing."""
    table = pd.read_parquet(run / "methods.parquet")
    table.assign(score=99.0, repeatability_db=99.0).to_parquet(run / "methods.parquet")
    row = ranked_rows([run])[0]
    assert row["score"] < 10
    assert row["repeatability_db"] is None


@pytest.mark.parametrize(
    ("edit", "failed", "words"),
    [
        (
            set_in_a_row("psnr", 60.0),
            3,
            "1 of 5 samples of 'noser' on 'tiny' do not have the figures",
        ),
        (set_in_a_row("input_hash", "0"), 2, "'noser' was given other frames of 'tiny'"),
        (set_in_a_row("phantom", "another"), 2, "The column 'phantom' of 'noser' on 'tiny'"),
        (
            edit_samples(lambda table: table.drop(index=3)),
            1,
            "'noser' on 'tiny' has 4 rows, not one for each of 5 samples",
        ),
        # An image as good as the truth, without the figures of one.
        (copy_image("truth", "noser"), 3, "do not have the figures of their images: ssim"),
        (copy_image("noser", "truth"), 2, "The truth that is stored of 'tiny' is not ours"),
        (
            edit_json(
                lambda rows: rows[1].update(score=rows[1]["score"] + 0.001), "leaderboard.json"
            ),
            6,
            "leaderboard.json says score",
        ),
        (lambda run: (run / "leaderboard.json").unlink(), 6, "leaderboard.json cannot be read"),
        (lambda run: (run / "reconstructions.h5").unlink(), 3, "cannot be read: resume the run"),
        (edit_json(lambda m: m.update(status="interrupted")), 1, "The run is interrupted"),
        (edit_json(lambda m: m["plan"].update(limit=3)), 1, "limited to 3 samples"),
        (edit_json(lambda m: m["data"]["tiny"].update(hash="0")), 2, "The data of 'tiny' are"),
        (
            edit_json(lambda m: m["plan"]["suite"]["scenarios"][0].update(test=4)),
            0,
            "is not that of this version",
        ),
        (edit_json(lambda m: m.pop("cells")), 1, "lacks something ('cells')"),
        (drop_a_method, 1, "'noser' was not run on 'tiny'"),
        (set_in_a_row("status", "error"), 4, "does not say which of its images are whole"),
        (add_a_figure, 6, ""),
    ],
)
def test_what_was_edited_is_found(
    submitted: Path, tmp_path: Path, edit: Edit, failed: int, words: str
) -> None:
    run = shutil.copytree(submitted, tmp_path / "mine")
    edit(run)
    assert words in check_submission(run)[failed].problem


def test_suites_of_ones_own_and_operators_are_no_submissions(
    submitted: Path, build_operators: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(submission, "suites", lambda: {})
    assert "is not one of eitbench's" in check_submission(submitted)[0].problem
    with pytest.raises(InputError, match="operators"):
        check_submission(build_operators({"fem": 0.1}))
