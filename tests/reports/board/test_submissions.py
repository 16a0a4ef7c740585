"""Submissions: folders with the figures of their images, and what their authors have to say."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.run import prior_knowledge
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.submissions import run_checks
from eitbench.benchmark.submissions.check import check_submission
from eitbench.benchmark.submissions.hidden import Gap, HiddenRecord, write_hidden
from eitbench.benchmark.submissions.rerun import note_reproduced, rerun
from eitbench.benchmark.submissions.statement import STATEMENT
from eitbench.benchmark.submissions.submission import FILES, open_submission
from eitbench.benchmark.submissions.sums import SUMS
from eitbench.benchmark.submissions.tiers import tier
from eitbench.reports.board import submissions
from eitbench.reports.board.records import write_record
from eitbench.reports.board.submissions import TOLERANCE, write_submission
from eitbench.reports.tables.boards import notes
from eitbench.reports.tables.leaderboard import ranked_rows, write_leaderboard
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.phantoms.phantom import contents
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite, load_suite, suites

SCENARIO = SimulatedScenario(
    name="n", image_shape=(40, 40), families=("circle", "ring"), noise=SplitNoise(test=40.0),
    train=2, validation=2, test=12,
)  # fmt: skip
SUITE = Suite(name="mine", title="Mine", methods=("noser",), scenarios=(SCENARIO,))
MARK = Path("no-plugin-is-run")
PLUGIN = """
from pathlib import Path
from eitbench.methods import create, Method, register
MARK = Path({mark!r})
if MARK.is_dir():
    raise RuntimeError("it was run")
@register("gentle")
class Gentle(Method):
    def fit(self, problem):
        self.inner = create("noser")
        self.inner.fit(problem)
    def reconstruct(self, voltages):
        return self.inner.reconstruct(voltages)
"""
SAID = {
    "name": "Gentle reconstruction", "authors": ["A. Author"], "contact": "a@example.org",
    "code": "https://example.org/gentle", "commit": "a" * 40, "container": "", "licence": "MIT",
    "training_data": "None: it has no parameters that were trained.", "test_split_seen": False,
}  # fmt: skip


@pytest.fixture(autouse=True)
def packaged(monkeypatch: pytest.MonkeyPatch) -> None:
    # The checkout that is tested may be changed.
    monkeypatch.setattr("eitbench.benchmark.rundir.manifest.git_commit", lambda: "a" * 40)
    monkeypatch.setattr(run_checks, "suites", lambda: {"mine": None})
    monkeypatch.setattr(run_checks, "load_suite", lambda name: SUITE)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a plugin, which fails wherever it is loaded while a folder is there."""
    folder = tmp_path_factory.mktemp("runs")
    plugin = folder / "gentle.py"
    plugin.write_text(PLUGIN.format(mark=str(folder / MARK)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eitbench.benchmark.rundir.manifest.git_commit", lambda: "a" * 40)
        made = start_run(make_plan(SUITE, methods=["gentle"], plugins=[plugin]), folder / "run")
    write_leaderboard(ranked_rows([made.path]), made.path)
    return made.path


@pytest.fixture(scope="module")
def blank(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `submission make` writes, before its author has said anything."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_checks, "suites", lambda: {"mine": None})
        patch.setattr(run_checks, "load_suite", lambda name: SUITE)
        out = tmp_path_factory.mktemp("made") / "gentle"
        written = write_submission(run, out)
    assert written.folder == out
    assert written.moved == ""
    assert written.size == sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    return out


@pytest.fixture
def folder(blank: Path, tmp_path: Path) -> Path:
    out = shutil.copytree(blank, tmp_path / "2026.1" / "submissions" / "mine" / "gentle")
    (out / STATEMENT).write_text(json.dumps(SAID))
    return out


def problems(path: Path) -> list[str]:
    return [of.problem for of in check_submission(open_submission(path)) if of.problem]


def test_a_submission_names_no_folder_of_its_author(run: Path, tmp_path: Path) -> None:
    typed = tmp_path / "run"
    shutil.copytree(run, typed)
    with edited_manifest(typed) as content:
        plugin = content["plan"]["plugins"][0]["path"]
        content["command_line"] = (
            f"eitbench run ../client/mine.toml --plugin {plugin} --out={typed} --scheduler tcp://a:1"
            """ --cache 'C:\\Users\\me\\cache' --parameters '{"noser": {"of": "a/b"}}'"""
        )
    out = tmp_path / "out"
    write_submission(typed, out)
    content = json.loads((out / "manifest.json").read_text())
    assert content["plan"]["plugins"][0]["path"] == "gentle.py"
    assert content["command_line"] == (
        "eitbench run mine.toml --plugin gentle.py --out=run --scheduler tcp://a:1"
        """ --cache cache --parameters '{"noser": {"of": "a/b"}}'"""
    )
    for path in out.rglob("*.json"):
        assert str(run.parent) not in path.read_text()
        assert str(tmp_path) not in path.read_text()


def test_a_submission_passes_and_holds_nothing_but_what_is_checked(run: Path, folder: Path) -> None:
    assert problems(folder) == []
    names = {path.name for path in folder.iterdir()}
    assert names == {*FILES, "plugins"} - {"recordings.json"}
    sizes = []
    for path in (run, folder):
        with h5py.File(path / "reconstructions.h5") as file:
            sizes.append(file["n/gentle/conductivity"].id.get_storage_size())
    assert sizes[1] < 0.6 * sizes[0]


def test_figures_are_those_of_the_rounded_images_and_near_those_of_the_run(
    run: Path, folder: Path
) -> None:
    one, other = (read_run(path).estimates("n", "gentle", range(12)) for path in (run, folder))
    assert one is not None
    assert other is not None
    largest = np.abs(one - 1).max(axis=(1, 2))
    moved = np.abs(one - other).max(axis=(1, 2))
    assert (moved > 0).all()
    assert (moved <= largest / 2048 + 1e-7).all()
    (before,), (after,) = ranked_rows([run]), ranked_rows([folder])
    assert after["score"] != before["score"]
    for name in ("score", "psnr", "ssim", "cc", "rie", "localisation_mm"):
        assert after[name] == pytest.approx(before[name], rel=TOLERANCE, abs=TOLERANCE)


def test_images_stay_whole_where_rounding_moves_a_figure(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("TOLERANCE", "TOLERANCE_MM"):
        monkeypatch.setattr(submissions, name, 1e-12)
    written = write_submission(run, tmp_path / "whole")
    assert "of 'gentle' on 'n' by" in written.moved
    one, other = (
        read_run(path).estimates("n", "gentle", range(12)) for path in (run, tmp_path / "whole")
    )
    np.testing.assert_array_equal(one, other)
    pd.testing.assert_frame_equal(
        pd.read_parquet(tmp_path / "whole" / "samples.parquet"),
        pd.read_parquet(run / "samples.parquet"),
    )
    assert problems(tmp_path / "whole") == ["submission.json does not say 'name': fill it in."]


@pytest.mark.parametrize(
    ("changed", "moved"),
    [
        ({"score": 5.0005}, ""),
        ({"score": 5.01}, "score of 'm' on 'n' by 0.01"),
        ({"localisation_mm": 3.05}, ""),
        ({"localisation_mm": 3.2}, "localisation_mm of 'm' on 'n' by 0.2"),
        ({"score": 5.01, "localisation_mm": 3.2}, "localisation_mm of 'm' on 'n' by 0.2"),
        ({"within_5_mm": 0.78, "contact_count_error": 0.53}, ""),  # one of 36 frames
    ],
)
def test_what_ranks_decides_whether_images_are_rounded(
    monkeypatch: pytest.MonkeyPatch, changed: dict[str, float], moved: str
) -> None:
    figures = {"score": 5.0, "localisation_mm": 3.0, "within_5_mm": 0.75, "ktc_score": None}
    row = {"scenario": "n", "method": "m", "cc": None, "repeatability_db": None, **figures}
    rows = {"run": row, "rounded": row | changed}
    monkeypatch.setattr(submissions, "ranked_rows", lambda paths: [rows[str(paths[0])]])
    assert submissions._moved(Path("run"), Path("rounded")) == moved


def test_what_check_refuses_is_not_made_and_for_the_same_reason(run: Path, tmp_path: Path) -> None:
    edited = shutil.copytree(run, tmp_path / "edited")
    table = pd.read_parquet(edited / "samples.parquet")
    table.assign(psnr=table["psnr"] + 1).to_parquet(edited / "samples.parquet")
    (found, *_) = problems(edited)
    with pytest.raises(InputError) as refused:
        write_submission(edited, tmp_path / "out")
    assert str(refused.value) == found
    assert not list(tmp_path.glob("*out*"))
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="is there already"):
        write_submission(run, tmp_path / "there")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"name": " "}, "does not say 'name'"),
        ({"authors": []}, "does not say 'authors'"),
        ({"authors": [" "]}, "does not say 'authors'"),
        ({"contact": ""}, "does not say 'contact'"),
        ({"code": ""}, "does not say 'code'"),
        ({"licence": ""}, "does not say 'licence'"),
        ({"training_data": ""}, "does not say 'training_data'"),
        ({"commit": ""}, "neither a 'commit' nor a 'container'"),
        ({"test_split_seen": None}, "does not say 'test_split_seen'"),
        ({"test_split_seen": True}, "test data were learned from"),
        ({"code": "javascript:alert(1)"}, "code: "),
        ({"code": "https://a b"}, "code: "),
        ({"commit": "main"}, "commit: it has to be a git commit of 40 or 64 hex digits"),
        ({"container": "ghcr.io/me/mine:latest"}, "container: it has to be an image by its digest"),
        ({"name": "\x1b[2J"}, "name: it holds the invisible character U+001B, leave it out."),
        ({"name": "\u202egpj.exe"}, "name: it holds the invisible character U+202E, leave it out."),
        ({"authors": ["A", "B\u200b"]}, "authors.1: it holds the invisible character U+200B"),
        ({"contact": "a@b\x85"}, "contact: it holds the invisible character U+0085"),
        ({"licence": "as is"}, "licence: it has to be an SPDX expression, such as MIT"),
        ({"licence": "MIT\u2028"}, "licence: it holds the invisible character U+2028"),
        ({"training_data": "no\u2066ne"}, "training_data: it holds the invisible character U+2066"),
        ({"code": 'https://x"><script>'}, 'code: an address has no ", leave it out.'),
        ({"code": "https://x/<script>"}, "code: an address has no <, leave it out."),
        ({"contact": "A <a@b.org>"}, "contact: an address has no <, leave it out."),
        ({"name": "x" * 201}, "name: "),
        ({"authors": ["x"] * 51}, "authors: "),
        ({"test_split_seen": "no"}, "test_split_seen: "),
        ({"tier": "reproduced"}, "tier: nothing of this name belongs here."),
    ],
)
def test_its_author_says_what_is_asked_and_nothing_else(
    folder: Path, change: dict[str, object], says: str
) -> None:
    (folder / STATEMENT).write_text(json.dumps(SAID | change))
    (found,) = problems(folder)
    assert says in found
    assert "\x1b" not in found


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, "null", '{"name": 1e999999}'])
def test_a_statement_of_another_form_is_a_sentence(folder: Path, text: str) -> None:
    (folder / STATEMENT).write_text(text)
    assert len(problems(folder)) == 1


def test_names_are_written_in_any_script(folder: Path) -> None:
    said = SAID | {"name": "Méthode d’Été", "authors": ["王小明", "Ольга И."]}
    (folder / STATEMENT).write_text(json.dumps(said))
    assert problems(folder) == []


def test_a_container_stands_for_a_commit(folder: Path) -> None:
    image = f"ghcr.io/me/mine@sha256:{'0' * 64}"
    (folder / STATEMENT).write_text(json.dumps(SAID | {"commit": "", "container": image}))
    assert problems(folder) == []


@pytest.mark.parametrize(
    "name", ["report", "logs", "recordings.json/", "model.pkl", "leaderboard.md", "conftest.py"]
)
def test_a_submission_holds_no_other_files(folder: Path, name: str) -> None:
    """Git has empty folders, too: what it adds as a submodule."""
    folder_wanted = "." not in name or name.endswith("/")
    name = name.strip("/")
    (folder / name).mkdir() if folder_wanted else (folder / name).write_text("")
    (found,) = problems(folder)
    assert f"{name!r}" in found


@pytest.mark.parametrize("content", [None, "", "import os", PLUGIN])
def test_the_copy_of_a_plugin_is_the_one_that_was_run(folder: Path, content: str | None) -> None:
    (copy,) = (folder / "plugins").iterdir()
    copy.unlink() if content is None else copy.write_text(content)
    assert problems(folder) == [
        f"The copy plugins/{copy.name} of a plugin is missing or was changed: send what the run "
        "wrote."
    ]


def test_a_run_without_plugins_has_no_folder_of_them(folder: Path) -> None:
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    content["plan"]["plugins"] = []
    path.write_text(json.dumps(content))
    shutil.rmtree(folder / "plugins")
    (folder / "plugins").mkdir()
    assert problems(folder) == ["A submission has no 'plugins': delete it."]


def test_the_documentation_names_the_suites_that_take_no_submissions() -> None:
    text = (Path(__file__).parents[3] / "docs" / "board.md").read_text()
    (names,) = re.findall(r"Suites that rank images take submissions\. Those of (.*) rank", text)
    none = {name for name in suites() if load_suite(name).ranks != "methods"}
    assert set(re.findall("`(.*?)`", names)) == none


def test_it_stands_where_its_suite_is(folder: Path) -> None:
    moved = folder.parents[1] / "other" / "gentle"
    shutil.copytree(folder, moved)
    assert problems(moved) == ["It belongs into submissions/mine, and not other."]


def test_nothing_of_a_submission_is_run_by_a_check(run: Path, folder: Path) -> None:
    mark = run.parent / MARK
    mark.mkdir(exist_ok=True)
    try:
        assert problems(folder) == []
        (found,) = rerun(open_submission(folder), 2)
        assert "it was run" in found.problem  # so a check would have shown it
    finally:
        mark.rmdir()
    assert [of.problem for of in rerun(open_submission(folder), 2)] == [""]


def edit_cells(path: Path, **values: Any) -> None:
    table = pd.read_parquet(path / "methods.parquet")
    table.assign(**values).to_parquet(path / "methods.parquet")
    write_leaderboard(ranked_rows([path]), path, ("json",))


def knows(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    (text,) = pd.read_parquet(path / "methods.parquet")["prior_knowledge"]
    known = json.loads(text)
    change(known)
    edit_cells(path, prior_knowledge=json.dumps(known))


def test_who_learned_from_test_samples_is_refused(folder: Path) -> None:
    edit_cells(folder, overlap=3.0)
    assert problems(folder) == [
        "3 of 12 test samples of 'n' are among those that 'gentle' learned from."
    ]
    edit_cells(folder, overlap=0.0, actions=json.dumps({"test data": ["n/test-000.safetensors"]}))
    assert problems(folder) == ["'gentle' on 'n' asked for test data (n/test-000.safetensors)."]


def test_who_states_the_test_split_as_training_data_is_refused(folder: Path) -> None:
    test = SCENARIO.data_hash("test")
    given = {"split": "train", "scenario": "n", "samples": 12, "data_hash": test}
    knows(folder, lambda known: known.update(given=[given]))
    assert problems(folder) == ["'gentle' says that it learned from the test split of 'n'."]
    said = {"scenario": "n", "train_data": test, "train_samples": "12"}
    knows(folder, lambda known: known.update(given=[], trained_on=said))
    assert problems(folder) == ["'gentle' says that it learned from the test split of 'n'."]


def test_training_data_that_weights_state_are_drawn_again_and_compared(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An author may edit the count of the overlap away."""
    said = {"scenario": "n", "train_data": SCENARIO.data_hash("train"), "train_samples": "2"}
    knows(folder, lambda known: known.update(trained_on=said))
    assert problems(folder) == []
    leaked = contents(load(SCENARIO).phantoms[:2], None)
    monkeypatch.setattr(prior_knowledge, "training_contents", lambda *args: leaked)
    assert problems(folder) == [
        "2 of 12 test samples of 'n' are among those that 'gentle' learned from."
    ]
    hostile = said | {"train_data": "../../../etc/passwd"}
    knows(folder, lambda known: known.update(trained_on=hostile))
    assert problems(folder) == []  # they are not known here, and `check` says so


ADAPTS = (
    PLUGIN
    + """
import numpy as np
@register("adapts")
class Adapts(Method):
    def fit(self, problem):
        self.inner, self.seen = create("noser"), []
        self.inner.fit(problem)
    def reconstruct(self, voltages):
        images = self.inner.reconstruct(voltages)
        self.seen += list(images)
        return images + 0.1 * (np.mean(self.seen, axis=0) - 1)
"""
)


@pytest.mark.slow
def test_a_method_that_learns_from_test_frames_is_found_frame_by_frame(tmp_path: Path) -> None:
    plugin = tmp_path / "adapts.py"
    plugin.write_text(ADAPTS.format(mark=str(tmp_path / MARK)))
    plan = make_plan(SUITE, methods=["gentle", "adapts"], plugins=[plugin])
    made = start_run(plan, tmp_path / "run").path
    write_leaderboard(ranked_rows([made]), made)
    assert problems(made) == []  # its images and figures are what they are
    honest, adapting = rerun(open_submission(made), 12)
    assert honest.problem == ""
    assert "an image depends on other frames" in adapting.problem


def record_of(run: Run, code: str | None) -> HiddenRecord:
    """A fall by 1 from the figure that the open run has."""
    data = {"n": (run.manifest["data"]["n"]["hash"], "1" * 64)}
    here = float(run.cell("n", "gentle")["score"].mean())
    gap = Gap(
        scenario="n", method="gentle", code=code, figure="score", n=12, clusters=4, open=here,
        hidden=here - 1, difference=-1.0, low=-1.5, high=-0.5, p=0.001, falls=True,
    )  # fmt: skip
    return HiddenRecord(
        suite="mine", key="2" * 64, made="2026-01-01", eitbench="0.2.0", git_commit=None, data=data,
        gaps=(gap,),
    )  # fmt: skip


def test_a_submission_rises_from_tier_to_tier(folder: Path) -> None:
    found = read_run(folder)
    assert tier(found, "n", "gentle").tier == "self-reported"
    (told,) = [note for note in notes(ranked_rows([folder])) if "tier" in note]
    assert told == "tier of gentle: self-reported (its times are self-reported)"
    note_reproduced(open_submission(folder), 12)
    assert tier(found, "n", "gentle").tier == "reproduced"
    (told,) = [note for note in notes(ranked_rows([folder])) if "tier" in note]
    assert "reproduced on 12 of 12 samples" in told

    board = folder.parents[2]
    other = record_of(found, "0" * 64)  # of other code
    (board.parent / "hidden.toml").write_text(
        f'[[keys]]\nversion = "{board.name}"\nsuite = "mine"\nsha256 = "{other.key}"\n'
    )
    write_hidden(other, board)
    assert tier(found, "n", "gentle").tier == "reproduced"
    (board / "hidden" / "mine-1.json").unlink()
    (plugin,) = found.manifest["plan"]["plugins"]
    write_hidden(record_of(found, plugin["sha256"]), board)
    standing = tier(found, "n", "gentle")
    assert standing.tier == "hidden"
    assert standing.gap is not None
    assert standing.reproduced_on == "12 of 12 samples"
    below = notes(ranked_rows([folder]))
    assert (
        "tier of gentle: hidden, falls by more than chance (its times are self-reported)" in below
    )
    assert "on the hidden set, minus here: gentle -1.000 (-1.500 to -0.500)" in below
    (folder.parent / "reproduced.json").unlink()
    assert tier(found, "n", "gentle").tier == "self-reported"  # its open images are still unknown


@pytest.mark.parametrize("name", ["My_Method", "mine.", "ü"])
def test_a_folder_that_the_workflow_refuses_is_not_written(
    run: Path, tmp_path: Path, name: str
) -> None:
    with pytest.raises(InputError, match="cannot name a submission"):
        write_submission(run, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_submission_has_not_the_name_of_its_suite(run: Path, tmp_path: Path) -> None:
    """The site shows both in one list."""
    with pytest.raises(InputError, match="'mine' is the name of the suite"):
        write_submission(run, tmp_path / "mine")
    assert not list(tmp_path.iterdir())
    folder = write_submission(run, tmp_path / "submissions" / "mine" / "other").folder
    renamed = folder.rename(folder.with_name("mine"))
    problems = [of.problem for of in check_submission(open_submission(renamed))]
    assert "It has the name of its suite, 'mine': rename the folder." in problems


def test_a_run_has_no_tier_and_a_record_was_run_by_us(run: Path, tmp_path: Path) -> None:
    assert not [note for note in notes(ranked_rows([run])) if "tier" in note]
    whole = start_run(make_plan(SUITE), tmp_path / "run").path
    record = write_record(whole, tmp_path / "2026.1" / "mine")
    (told,) = [note for note in notes(ranked_rows([record])) if "tier" in note]
    assert told == "tier of noser: reproduced on all samples, by the maintainers"
    with (record / "manifest.json").open("a") as file:
        file.write(" ")  # by somebody else
    with pytest.raises(DataCorruptError, match=r"mine/manifest\.json is not the file that"):
        notes(ranked_rows([record]))
    (record.parent / SUMS).write_bytes(b"\xff\x00 no text")
    with pytest.raises(DataCorruptError, match="is not noted in SHA256SUMS"):
        notes(ranked_rows([record]))
