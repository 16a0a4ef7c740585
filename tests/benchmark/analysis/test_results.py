import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.run_arrays import kept_open, read_scene
from eitbench.scenarios.errors import DataCorruptError, InputError


def board(run: Path, scenario: str) -> dict[str, dict[str, Any]]:
    rows = leaderboard_rows([read_run(run)])
    return {row["method"]: row for row in rows if row["scenario"] == scenario}


def test_figures_are_means_over_all_samples_and_localisation_the_median(full_run: Path) -> None:
    rows = board(full_run, "conductivity-set")
    table = pd.read_parquet(full_run / "samples.parquet")
    of = table[(table["scenario"] == "conductivity-set") & (table["method"] == "sharp")]
    assert rows["sharp"]["n"] == 8
    assert rows["sharp"]["coverage"] == 0.75
    assert rows["sharp"]["ssim"] == pytest.approx(of["ssim"].mean())
    assert rows["sharp"]["localisation_mm"] == pytest.approx(of["localisation_mm"].median())
    assert rows["sharp"]["setup_s"] == 0.25
    assert rows["sharp"]["train_s"] is None


def test_what_failed_is_charged_what_the_untouched_sensor_gets(full_run: Path) -> None:
    table = pd.read_parquet(full_run / "samples.parquet")
    of = table[table["scenario"] == "conductivity-set"]
    sharp, constant = (
        of[of["method"] == name].set_index("sample") for name in ("sharp", "constant")
    )
    figures = ["ssim", "cc", "rie", "psnr", "score", "localisation_mm", "iou"]
    lost = sharp.index[sharp["status"] != "ok"]
    assert len(lost) == 2
    pd.testing.assert_frame_equal(sharp.loc[lost, figures], constant.loc[lost, figures])
    rows = board(full_run, "conductivity-set")
    valid = sharp.drop(index=lost)["score"].mean()
    assert rows["constant"]["score"] < rows["sharp"]["score"] < valid


@pytest.mark.parametrize(
    ("scenario", "figure"),
    [
        ("position-set", "localisation_mm"),
        ("classes-set", "cc"),
        ("none-set", "repeatability_db"),
    ],
)
def test_rank_follows_what_is_known(full_run: Path, scenario: str, figure: str) -> None:
    rows = board(full_run, scenario)
    assert rows["sharp"][figure] is not None
    ranks = sorted(rows.values(), key=lambda row: int(row["rank"]))
    assert ranks[0]["method"] in ("sharp", "blurred")
    assert ranks[-1]["method"] == "constant"
    assert all(row["score"] is None for row in ranks)


def test_strength_and_response_are_figures_of_the_whole_cell(full_run: Path) -> None:
    assert board(full_run, "position-set")["sharp"]["strength_spearman"] == pytest.approx(1)
    assert board(full_run, "position-set")["constant"]["strength_spearman"] == 0
    assert board(full_run, "none-set")["constant"]["repeatability_db"] is None


def test_equals_share_a_rank_and_lost_methods_come_last(build: Any, dataset_of: Any) -> None:
    dataset = dataset_of("conductivity", 4)
    images = 0.9 * (dataset.conductivity - 1) + 1
    for name, lost in (("a", 0), ("b", 0), ("c", 4), ("d", 1)):
        build.add(dataset, name, images, lost)
    rows = board(build.write(), "conductivity-set")
    assert {name: row["rank"] for name, row in rows.items()} == {"a": 1, "b": 1, "d": 3, "c": 4}
    assert rows["c"]["coverage"] == 0
    assert rows["c"]["score"] is None


def test_images_of_chosen_samples(full_run: Path) -> None:
    run = read_run(full_run)
    images = run.estimates("conductivity-set", "sharp", [1, 4, 7])
    assert images is not None
    with h5py.File(full_run / "reconstructions.h5") as file:
        stored = file["conductivity-set/sharp/conductivity"][:]
    np.testing.assert_array_equal(images, stored[[1, 4, 7]])
    assert np.isnan(images[2]).all()
    assert run.estimates("conductivity-set", "sharp", [99]) is None
    scene = run.scene("classes-set", [2, 3])
    assert scene.has_classes
    assert scene.truth is not None
    assert set(np.unique(scene.truth)) == {-1.0, 0.0}
    assert run.scene("position-set", [0]).truth is None


@pytest.mark.parametrize("column", ["status", "track", "cluster", "suite"])
def test_a_column_of_labels_without_any_is_no_surprise(full_run: Path, column: str) -> None:
    run = read_run(full_run)
    rows = leaderboard_rows([run])
    none = leaderboard_rows([replace(run, samples=run.samples.assign(**{column: None}))])
    # Nothing is grouped by a missing track or suite; frames without a status are not valid ones.
    assert len(none) == (0 if column in ("track", "suite") else len(rows))
    if column == "status":
        assert {row["coverage"] for row in none} == {0.0}


def test_a_file_of_images_that_is_kept_open_is_opened_once(
    full_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays, run = full_run / "reconstructions.h5", read_run(full_run)
    expected = run.estimates("conductivity-set", "sharp", [1, 4])
    opened: list[Path] = []
    really = h5py.File

    def noted(path: Path, mode: str) -> h5py.File:
        opened.append(path)
        return really(path, mode)

    monkeypatch.setattr(h5py, "File", noted)
    with kept_open(arrays), kept_open(arrays):
        for _ in range(2):
            found = run.estimates("conductivity-set", "sharp", [1, 4])
            np.testing.assert_array_equal(found, expected)
    assert opened == [arrays]
    run.scene("classes-set", [2])
    assert opened == [arrays] * 2
    # What is not there is told by whoever reads from it.
    with kept_open(tmp_path / "none.h5"), pytest.raises(DataCorruptError, match=r"none\.h5"):
        read_scene(tmp_path / "none.h5", "a", [], 1)


def test_an_unfinished_run_is_to_be_resumed(full_run: Path, tmp_path: Path) -> None:
    path = shutil.copytree(full_run, tmp_path / "stopped")
    (path / "samples.parquet").unlink()
    with edited_manifest(path) as content:
        content["status"] = "interrupted"
    with pytest.raises(InputError, match=r"no results yet: finish it with `.*--resume"):
        read_run(path)


@pytest.mark.parametrize(
    ("name", "content", "error", "words"),
    [
        ("manifest.json", None, InputError, "run directory"),
        ("samples.parquet", None, DataCorruptError, "lacks samples.parquet, though its run was"),
        ("methods.parquet", b"PAR1", DataCorruptError, "methods.parquet"),
    ],
)
def test_a_damaged_run_is_refused(
    full_run: Path,
    tmp_path: Path,
    name: str,
    content: bytes | None,
    error: type[Exception],
    words: str,
) -> None:
    path = shutil.copytree(full_run, tmp_path / "spoilt")
    (path / name).unlink()
    if content is not None:
        (path / name).write_bytes(content)
    with pytest.raises(error, match=words):
        read_run(path)


def test_rows_of_data_that_the_manifest_does_not_know_are_refused(
    full_run: Path, tmp_path: Path
) -> None:
    path = shutil.copytree(full_run, tmp_path / "spoilt")
    with edited_manifest(path) as content:
        del content["data"]["classes-set"]
        content["data"]["none-set"]["n"] = 1000  # else it has too many rows first of all
    with pytest.raises(DataCorruptError, match="says nothing of the data of 'classes-set'"):
        read_run(path)


def test_damaged_or_missing_images_are_named(full_run: Path, tmp_path: Path) -> None:
    run = read_run(shutil.copytree(full_run, tmp_path / "spoilt"))
    with pytest.raises(DataCorruptError, match="'nobody'"):
        run.estimates("none-set", "nobody", [0])
    images = run.path / "reconstructions.h5"
    images.write_bytes(images.read_bytes()[:500])
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5"):
        run.scene("none-set", [0])


@pytest.mark.parametrize(
    ("data", "ranks"),
    [({}, [1, 1, 3, 3, 5, 5]), ({"hash": "77c0"}, [1, 2, 3] * 2), ({"n": 9}, [1, 2, 3] * 2)],
)
def test_several_runs_are_ranked_together_if_their_data_are_alike(
    full_run: Path, tmp_path: Path, data: dict[str, object], ranks: list[int]
) -> None:
    other = shutil.copytree(full_run, tmp_path / "other")
    content = json.loads((other / "manifest.json").read_text())
    content["data"]["conductivity-set"] |= data
    for cell in content["cells"]:
        cell["parameters"] = {"weight": 1.0}  # else it repeats the first
    (other / "manifest.json").write_text(json.dumps(content))
    rows = leaderboard_rows([read_run(full_run), read_run(other)])
    simulated = [row for row in rows if row["scenario"] == "conductivity-set"]
    assert [row["rank"] for row in simulated] == ranks
    assert sorted(row["run"] for row in simulated) == ["full"] * 3 + ["other"] * 3
    assert [row["rank"] for row in rows if row["scenario"] == "classes-set"][-1] >= 5


def test_what_is_known_of_recorded_data_is_in_their_rows(full_run: Path, tmp_path: Path) -> None:
    path = shutil.copytree(full_run, tmp_path / "noted")
    notes = {"position-set": {"guess_mm": 35.5, "reciprocity_error": None, "repeat_noise": 1e-3}}
    (path / "recordings.json").write_text(json.dumps(notes))
    for row in leaderboard_rows([read_run(path)]):
        known = (row["guess_mm"], row["reciprocity_error"], row["repeat_noise"])
        assert known == ((35.5, None, 1e-3) if row["scenario"] == "position-set" else (None,) * 3)
