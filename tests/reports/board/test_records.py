"""Records of the leaderboard: small, whole in their tables, and shown like the runs they are of."""

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest
from tests.support.reports import report_data
from typer.testing import CliRunner

from eitbench.benchmark.analysis.comparison import compare, read_results
from eitbench.benchmark.analysis.leaderboard import SAME, leaderboard_rows
from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import BUSY, read_run
from eitbench.benchmark.findings.acuity import acuity_of
from eitbench.benchmark.findings.acuity_seen import SEEN_FILE
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.rundir.few_bytes import DIGITS, FRAME_DIGITS, packed, unpacked
from eitbench.benchmark.rundir.kinds import RUN_KINDS, RunKind
from eitbench.benchmark.rundir.manifest import commits
from eitbench.benchmark.rundir.run_arrays import Scene
from eitbench.benchmark.submissions.submission import FOLDER
from eitbench.benchmark.submissions.sums import SUMS
from eitbench.benchmark.tuning.outdated import outdated
from eitbench.commands.results import app as results
from eitbench.reports.board import records
from eitbench.reports.board.changes import (
    REASONS,
    changes,
    in_words,
    last_before,
    reasons,
    version_key,
)
from eitbench.reports.board.records import (
    PLACE_STEP,
    SPEEDS,
    STEPS,
    cost,
    picture_step,
    write_record,
)
from eitbench.reports.page.images import shown_samples
from eitbench.reports.site.site import write_site
from eitbench.reports.tables.boards import notes
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.phantoms.acuity import Acuity
from eitbench.scenarios.suites.scenario import SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import Suite

BOARD = Path(__file__).parents[3] / "reports" / "board"
SCENARIO = SimulatedScenario(
    name="n", image_shape=(20, 20), families=("circle", "ring"), noise=SplitNoise(test=40.0),
    train=0, validation=2, test=30,
)  # fmt: skip
SUITE = Suite(name="mine", title="Mine", methods=("noser", "greit"), scenarios=(SCENARIO,))


IDLE_MS = 20.0
"""Calibration solve of a machine that does nothing else."""


def with_solves(run: Path, solves: dict[str, float]) -> Path:
    """The run, as if the calibration solve had taken so long [ms] beside these methods."""
    cells = pd.read_parquet(run / "methods.parquet")
    cells["calibration_ms"] = [solves.get(name, IDLE_MS) for name in cells["method"]]
    cells["load"] = 0.0  # whatever else runs beside the test
    cells.to_parquet(run / "methods.parquet", index=False)
    with edited_manifest(run) as content:
        content["calibration_ms"] = IDLE_MS
    return run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = start_run(make_plan(SUITE), tmp_path_factory.mktemp("r") / "run").path
    return with_solves(made, {})


@pytest.fixture(scope="module")
def record(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_record(run, tmp_path_factory.mktemp("board") / "2026.1" / "mine")


def test_every_figure_of_a_record_is_that_of_its_run(run: Path, record: Path) -> None:
    """To the digits that are kept of each sample; costs of cells, which are few, exactly."""
    kept, made = read_run(record), read_run(run)
    least = 2.0**-DIGITS
    samples = made.samples.assign(input_hash=made.samples["input_hash"].str[:FRAME_DIGITS])
    found = ["found_x_m", "found_y_m"]
    places, exact = (of[found].to_numpy() for of in (kept.samples, samples))
    assert np.abs(places - exact).max() <= 0.51 * PLACE_STEP
    assert not (places % PLACE_STEP).any()
    pd.testing.assert_frame_equal(
        kept.samples.drop(columns=found), samples.drop(columns=found), rtol=least, atol=0
    )
    assert not kept.samples["psnr"].equals(made.samples["psnr"])
    pd.testing.assert_frame_equal(kept.cells[made.cells.columns], made.cells)
    for one, other in zip(leaderboard_rows([kept]), leaderboard_rows([made]), strict=True):
        assert one.keys() == other.keys()
        for name, value in one.items():
            if isinstance(value, float):
                assert value == pytest.approx(other[name], rel=least), name
            elif name != "run":
                assert value == other[name], name


@pytest.mark.parametrize("contrast", [0.001, 0.04, 3.0])
def test_faint_images_without_a_truth_keep_their_contrast(contrast: float) -> None:
    """Touches of a real skin change it by a few per cent, less than a step of the data range."""
    scene = Scene(
        bounds=(0.0, 0.0, 0.1, 0.1), background=1.0, data_range=1.0, mask=np.ones((8, 8), bool),
        sample=np.arange(2), truth=None, has_classes=False,
    )  # fmt: skip
    images = 1 - contrast * np.random.default_rng(0).uniform(size=(2, 8, 8))
    images[1, 0] = np.nan
    step = picture_step(images, scene, STEPS)
    found = unpacked(packed(images, step), step)
    assert np.nanmax(np.abs(found - images)) <= max(0.51 * contrast / STEPS, 2**-14)
    assert np.isnan(found[1, 0]).all()
    assert picture_step(np.ones((1, 8, 8)), scene, STEPS) == scene.data_range / STEPS


def test_images_are_those_that_a_page_shows_rounded(run: Path, record: Path) -> None:
    whole, kept = read_run(run), read_run(record)
    shown = shown_samples(whole, "n")
    assert 2 <= len(shown) <= 6
    for name in ("noser", "greit"):
        made, left = whole.estimates("n", name, shown), kept.estimates("n", name, shown)
        assert made is not None
        assert left is not None
        np.testing.assert_allclose(left, made, atol=0.5 / STEPS + 1e-3)
    (board,) = report_data([record])["boards"]
    assert board["images"] is not None
    assert board["images"]["samples"] == shown
    assert board["sensitivity"] == []  # which takes images of other samples
    assert (record / "reconstructions.h5").stat().st_size < 0.5 * (
        run / "reconstructions.h5"
    ).stat().st_size


def test_cases_without_images_are_left_out(record: Path, tmp_path: Path) -> None:
    """As in a record of a version that showed other cases."""
    (shown,) = report_data([record])["boards"]
    assert shown["images"] is not None
    lacking = Path(shutil.copytree(record, tmp_path / "record"))
    kept: list[int] = shown["images"]["samples"][:1]
    for left in (kept, []):
        with h5py.File(lacking / "reconstructions.h5", "r+") as file:
            for group in file["n"].values():
                rows = np.flatnonzero(np.isin(group["sample"][:], left))
                for name in group.keys() - {"mask"}:
                    values, attributes = group[name][:][rows], dict(group[name].attrs)
                    del group[name]
                    group.create_dataset(name, data=values).attrs.update(attributes)
        images = report_data([lacking])["boards"][0]["images"]
        assert (images["samples"] if images else []) == left


def test_a_site_is_built_from_records_alone(record: Path, tmp_path: Path) -> None:
    assert write_site(record.parent, tmp_path / "site")
    assert "noser" in (tmp_path / "site" / "index.html").read_text()


def test_a_record_is_compared_with_a_run_of_the_same_frames(run: Path, record: Path) -> None:
    """A record keeps the first digits of the hashes of frames."""
    found = compare(read_results(record), read_results(run), {})
    assert not found.missing
    assert len(found.changes) == 2
    assert all(abs(change.difference) < 1e-4 for change in found.changes)


def test_a_site_of_a_board_with_a_damaged_record_is_refused(record: Path, tmp_path: Path) -> None:
    version = Path(shutil.copytree(record.parent, tmp_path / "board" / "2026.1"))
    (version / "mine" / "samples.parquet").write_bytes(b"PAR1")
    with pytest.raises(DataCorruptError, match="is not the file that SHA256SUMS notes"):
        write_site(version.parent, tmp_path / "site")
    with pytest.raises(InputError, match="holds the runs: give another folder"):
        write_site(version.parent, version.parent)
    assert not (tmp_path / "site").exists()


def test_a_record_is_never_edited_and_never_rescored(run: Path, record: Path) -> None:
    with pytest.raises(InputError, match="never edited"):
        write_record(run, record)
    with pytest.raises(InputError, match="is a record, with images of few samples"):
        rescore(record)


def test_times_beside_something_else_are_left_out(run: Path, record: Path, tmp_path: Path) -> None:
    busy = with_solves(Path(shutil.copytree(run, tmp_path / "run")), {"noser": 1.3 * IDLE_MS})
    kept = write_record(busy, tmp_path / "2026.1" / "mine")
    rows = {row["method"]: row for row in leaderboard_rows([read_run(kept)])}
    times = ("first_frame_ms", "frame_ms_p50", "frame_ms_p95", "frame_solves", "batch_fps")
    assert {name: rows["noser"][name] for name in times} == dict.fromkeys(times)
    whole = {row["method"]: row for row in leaderboard_rows([read_run(record)])}
    assert rows["greit"] == {**whole["greit"], "run": rows["greit"]["run"]}
    assert rows["noser"]["score"] == whole["noser"]["score"]
    (said,) = [note for note in notes(list(rows.values())) if "busy" in note]
    assert said.startswith("no time of noser:")


def test_times_while_other_programs_work_are_left_out(run: Path, tmp_path: Path) -> None:
    busy = Path(shutil.copytree(run, tmp_path / "run"))
    cells = pd.read_parquet(busy / "methods.parquet")
    cells.assign(load=[0.9, 0.4]).to_parquet(busy / "methods.parquet", index=False)
    kept = pd.read_parquet(write_record(busy, tmp_path / "2026.1" / "mine") / "methods.parquet")
    assert kept["busy"].tolist() == [True, False]
    assert kept["frame_ms_p50"].isna().tolist() == [True, False]


def test_a_board_waits_for_the_calm_that_records_know(
    record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(records, "calibration_solves", lambda: [3 * IDLE_MS])
    assert records.calm_ms(record.parents[1]) == BUSY * IDLE_MS
    assert records.calm_ms(tmp_path) == BUSY * 3 * IDLE_MS  # no record knows better


def test_a_slower_machine_alone_is_not_busy(run: Path, tmp_path: Path) -> None:
    slow = Path(shutil.copytree(run, tmp_path / "run"))
    with_solves(slow, {"noser": 2 * IDLE_MS, "greit": 2 * IDLE_MS})
    assert pd.read_parquet(write_record(slow, tmp_path / "2026.1" / "a") / "methods.parquet")[
        "busy"
    ].all()  # the manifest knows a faster solve of it
    with edited_manifest(slow) as content:
        content["calibration_ms"] = 2 * IDLE_MS
    kept = pd.read_parquet(write_record(slow, tmp_path / "b" / "2026.1" / "a") / "methods.parquet")
    assert not kept["busy"].any()
    # Another record tells what the machine can do.
    write_record(run, tmp_path / "c" / "2026.1" / "first")
    kept = pd.read_parquet(write_record(slow, tmp_path / "c" / "2026.2" / "a") / "methods.parquet")
    assert kept["busy"].all()


@pytest.mark.parametrize("kind", RUN_KINDS.values(), ids=lambda kind: kind.name)
def test_no_record_has_a_speed_of_a_busy_machine(kind: RunKind) -> None:
    for path in BOARD.glob(f"2*/*/{kind.table}"):
        cells = pd.read_parquet(path)
        speeds = [name for name in SPEEDS if name in cells]
        frame_times = {name for name in map(str, cells) if name.startswith("frame_ms")}
        assert frame_times <= set(kind.costs), path
        if "busy" in cells:
            assert cells.loc[cells["busy"], speeds].isna().all(axis=None), path
            # Where it was idle, they are there, but for what a short run does not measure.
            measured = ~cells["busy"] & cells["calibration_ms"].notna()  # it did not fail
            idle = cells.loc[measured, [name for name in speeds if "p9" not in name]]
            assert idle.notna().any().all() or idle.empty, path


def sums_of(folder: Path) -> list[str]:
    """Lines as `sha256sum` writes them."""
    files = (path for path in sorted(folder.iterdir()) if path.is_file())
    return [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {folder.name}/{path.name}\n"
        for path in files
    ]


def test_nobody_changed_a_file_of_a_record(record: Path) -> None:
    for version in {*(path.parents[1] for path in BOARD.glob("2*/*/manifest.json")), record.parent}:
        folders = [of for of in sorted(version.iterdir()) if of.is_dir() and of.name != FOLDER]
        lines = [line for folder in folders for line in sums_of(folder)]
        assert sorted((version / SUMS).read_text().splitlines(keepends=True)) == sorted(lines)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"methods": ("noser", "greit", "tv")}, "it lacks the method 'tv'"),
        ({"scenarios": (SCENARIO, SCENARIO.model_copy(update={"name": "m"}))}, "the scenario 'm'"),
    ],
)
def test_a_run_of_a_part_of_its_suite_is_no_record(
    run: Path, tmp_path: Path, change: dict[str, object], says: str
) -> None:
    more = SUITE.model_copy(update=change)
    plan = make_plan(more, methods=["noser", "greit"], scenarios=["n"])
    part = start_run(plan, tmp_path / "part").path
    with pytest.raises(InputError, match=says):
        write_record(part, tmp_path / "2026.1" / "record")
    assert not (tmp_path / "2026.1" / "record").exists()


def test_a_record_makes_no_record_and_is_left_as_it_is(record: Path, tmp_path: Path) -> None:
    before = sums_of(record)
    with pytest.raises(InputError, match="it is a record itself, with images of few samples"):
        write_record(record, tmp_path / "2026.1" / "mine")
    assert sums_of(record) == before
    of_recordings = BOARD / "2026.2" / "quick"  # whose notes would be worked out again
    before = sums_of(of_recordings)
    with pytest.raises(InputError, match="it is a record itself"):
        write_record(of_recordings, tmp_path / "2026.1" / "mine")
    assert sums_of(of_recordings) == before


def test_a_method_that_failed_on_all_samples_makes_no_record(run: Path, tmp_path: Path) -> None:
    failed = tmp_path / "run"
    shutil.copytree(run, failed)
    samples = pd.read_parquet(failed / "samples.parquet")
    samples.loc[samples["method"] == "noser", "status"] = "error"
    samples.to_parquet(failed / "samples.parquet", index=False)
    with pytest.raises(InputError, match="'noser' failed on all samples of 'n'"):
        write_record(failed, tmp_path / "2026.1" / "mine")
    assert not (tmp_path / "2026.1" / "mine").exists()


def test_a_limited_run_is_no_record(tmp_path: Path) -> None:
    limited = start_run(make_plan(SUITE, limit=3), tmp_path / "run").path
    with pytest.raises(InputError, match="limited to some test samples"):
        write_record(limited, tmp_path / "2026.1" / "record")


@pytest.mark.slow
def test_a_record_of_acuity_has_the_figures_of_all_images(tmp_path: Path) -> None:
    lattice = Acuity(pressures=(2e3, 1e4, 4e4), distances=(0.2, 0.3, 0.4), step=0.3, draws=1)
    scenario = SimulatedScenario(
        name="n", image_shape=(40, 40), families=("soft-press",), acuity=lattice, train=0,
        validation=2, noise=SplitNoise(test=40.0), phantoms="acuity",
    )  # fmt: skip
    suite = SUITE.model_copy(update={"scenarios": (scenario,), "methods": ("noser",)})
    run = start_run(make_plan(suite), tmp_path / "run").path
    kept = write_record(run, tmp_path / "2026.1" / "mine")
    (made,), (read,) = acuity_of(read_run(run)), acuity_of(read_run(kept))
    assert read.figures == pytest.approx(made.figures, rel=1e-4, nan_ok=True)
    assert np.isfinite(read.figures["noise_figure"])
    pd.testing.assert_frame_equal(read.places, made.places, rtol=1e-4, atol=1e-3)
    table = pd.read_parquet(kept / SEEN_FILE)
    table[:-1].to_parquet(kept / SEEN_FILE)
    with pytest.raises(DataCorruptError, match="lacks images of 'noser'"):
        acuity_of(read_run(kept))
    table.drop(columns="shown").to_parquet(kept / SEEN_FILE)
    with pytest.raises(DataCorruptError, match="does not hold what images show"):
        acuity_of(read_run(kept))


def test_the_description_of_a_frame_takes_space_once(tmp_path: Path) -> None:
    """Each of 30 methods repeats those of 1,000 frames, more rows than a page has by default."""
    frames = pd.DataFrame({"sample": np.arange(1000), "x_m": np.random.default_rng(0).random(1000)})
    sizes = []
    for methods in (1, 30):
        table = pd.concat([frames] * methods, ignore_index=True)
        records._write_rounded(table, path := tmp_path / f"{methods}.parquet")
        np.testing.assert_allclose(pd.read_parquet(path)["x_m"], table["x_m"], rtol=2**-DIGITS)
        sizes.append(path.stat().st_size)
    assert sizes[1] < 1.2 * sizes[0]


def test_the_cost_of_a_suite_is_that_of_its_last_record(record: Path) -> None:
    board = record.parents[1]
    assert "not known" in cost("other", board)
    assert "cost of all methods on 'mine' (other) is not known" in cost(
        "mine", board, [], ["other"]
    )
    assert f"On 'mine' ({SUITE.scenarios[0].name}), all methods took" in cost(
        "mine", board, [], [SUITE.scenarios[0].name]
    )
    said = cost("mine", board)
    assert "for at most 30 frames each in version 2026.1" in said
    size = sum(path.stat().st_size for path in record.iterdir()) / 1e6
    assert f"{size:.1f} MB" in said


def test_the_manifest_of_a_record_says_what_it_is(record: Path) -> None:
    assert json.loads((record / "manifest.json").read_text())["images"] == "shown"


def test_records_name_no_folder_of_the_machine_that_made_them(run: Path, tmp_path: Path) -> None:
    typed = Path(shutil.copytree(run, tmp_path / "run"))
    with edited_manifest(typed) as content:
        content["command_line"] = f"eitbench board mine --runs {tmp_path}"
        later = {"time": "2026-01-01", "git_commit": None, "jobs": 2}
        content["resumed"] = [{"command_line": content["command_line"], **later}]
    kept = write_record(typed, tmp_path / "2026.1" / "mine") / "manifest.json"
    assert json.loads(kept.read_text())["resumed"] == [
        {"command_line": "eitbench board mine --runs RUNS", **later}
    ]
    for manifest in (kept, *BOARD.glob("2*/*/manifest.json")):
        content = json.loads(manifest.read_text())
        for entry in (content, *content["resumed"]):
            # The first records say no folder.
            again = entry["command_line"].removesuffix(" --runs RUNS")
            assert again == f"eitbench board {manifest.parent.name}", manifest
        assert not re.search(r'[" ](/|[A-Z]:)[\w.]', manifest.read_text()), manifest


def changed_run(run: Path, psnr: float) -> Path:
    """The run with other times, and with the PSNR of one sample changed by this share."""
    table = pd.read_parquet(run / "samples.parquet")
    for time in ("frame_ms", "uncertainty_ms"):  # no figures of that kind
        table[time] = table[time].fillna(1.0) * 2
    (row,) = table.index[(table["method"] == "noser") & (table["sample"] == 7)]
    table.loc[row, "psnr"] *= 1 + psnr
    table.to_parquet(run / "samples.parquet")
    return run_again(run)


def run_again(run: Path) -> Path:
    """The run, as if it had been made another time."""
    with edited_manifest(run) as content:
        content["started"] = "2099-01-01T00:00:00+00:00"
    return run


@pytest.mark.parametrize(
    ("psnr", "says"),
    [
        pytest.param(0.01, "1 of 30 samples of n", marks=pytest.mark.slow),
        (2.0**-52, "the last bits of psnr on n"),
    ],
)
def test_what_changed_is_found_to_the_last_bit(
    run: Path, record: Path, tmp_path: Path, psnr: float, says: str
) -> None:
    first = Path(shutil.copytree(record, tmp_path / "2026.9" / "mine"))
    other = changed_run(Path(shutil.copytree(run, tmp_path / "run")), psnr)
    newer = write_record(other, tmp_path / "2026.10" / "mine")
    assert last_before(first) is None
    assert last_before(newer) == first
    found = changes(first, newer)
    assert (found.exact, found.kept) == (True, ["greit"])
    assert found.changed == {"noser": says}
    taken = changes(first, write_record(run, tmp_path / "2026.12" / "mine"))
    assert (taken.kept, taken.taken) == ([], ["greit", "noser"])
    again = run_again(Path(shutil.copytree(run, tmp_path / "again")))
    same = write_record(again, tmp_path / "2026.11" / "mine")
    assert changes(first, same).kept == ["greit", "noser"]
    # The first records kept no checksums, but exact numbers.
    exact = Path(shutil.copytree(run, tmp_path / "2026.8" / "mine"))
    assert changes(exact, newer).changed == {"noser": says}
    assert changes(exact, same).kept == ["greit", "noser"]
    with edited_manifest(newer) as content:
        content["machine"]["cpu"] = "another"
    elsewhere = changes(first, newer)
    small = psnr < SAME
    assert (elsewhere.exact, "noser" in elsewhere.kept) == (False, small)
    # A figure of small numbers is compared as closely as others.
    samples = pd.read_parquet(newer / "samples.parquet")
    weaker = samples.assign(crps=samples["crps"].where(samples["method"] != "noser", 1e-9))
    weaker.to_parquet(newer / "samples.parquet", index=False)
    assert changes(first, newer).changed == {"noser": "30 of 30 samples of n"}
    samples.to_parquet(newer / "samples.parquet", index=False)
    with edited_manifest(newer) as content:
        content["data"]["n"]["hash"] = "0" * 64
    unlike = changes(first, newer)
    assert (unlike.unlike, unlike.kept, unlike.exact) == (["n"], [], False)


def test_what_a_newer_record_lacks_is_told(record: Path, tmp_path: Path) -> None:
    first, newer = (
        Path(shutil.copytree(record, tmp_path / version / "mine"))
        for version in ("2026.1", "2026.2")
    )
    samples, cells = (
        pd.read_parquet(newer / name) for name in ("samples.parquet", "methods.parquet")
    )
    samples = samples[samples["method"] != "noser"].drop(columns="crps")
    samples.to_parquet(newer / "samples.parquet", index=False)
    cells[cells["method"] != "noser"].to_parquet(newer / "methods.parquet", index=False)
    found = changes(first, newer)
    assert found.gone == ["noser on n", "the figure crps"]
    said = in_words(found, {"noser on n": "it was broken"})
    assert "Since 2026.1, the figure crps is gone: why is not said." in said
    assert "Since 2026.1, noser on n is gone: it was broken." in said


def test_damaged_checksums_are_one_sentence(record: Path, tmp_path: Path) -> None:
    damaged = Path(shutil.copytree(record, tmp_path / "2026.2" / "mine"))
    cells = pd.read_parquet(damaged / "methods.parquet").assign(checksums="[1]")
    cells.to_parquet(damaged / "methods.parquet", index=False)
    with pytest.raises(DataCorruptError, match=r"column 'checksums' of .* is damaged"):
        changes(record, damaged)


def test_reasons_are_texts_by_method(tmp_path: Path) -> None:
    assert reasons(tmp_path) == {}
    (tmp_path / REASONS).write_text('tv = "it stops later"')
    assert reasons(tmp_path) == {"tv": "it stops later"}
    (tmp_path / REASONS).write_text("tv = 3")
    with pytest.raises(InputError, match="should hold lines such as"):
        reasons(tmp_path)


def test_what_a_later_run_leaves_out_has_neither_rows_nor_images(
    record: Path, tmp_path: Path
) -> None:
    """It cannot run there, whatever the record before holds of it."""
    part = start_run(make_plan(SUITE, methods=("greit",)), tmp_path / "part").path
    with edited_manifest(part) as content:
        content["skipped"] = {"n/noser": "Scenario 'n' is left out for 'noser': it cannot."}
    kept = read_run(write_record(part, tmp_path / "2026.2" / "mine", record))
    assert {*read_run(record).cells["method"]} == {"greit", "noser"}
    assert {*kept.cells["method"]} == {*kept.samples["method"]} == {"greit"}
    assert [cell["name"] for cell in kept.manifest["cells"]] == ["greit"]
    assert list(kept.manifest["skipped"]) == ["n/noser"]
    with h5py.File(kept.path / "reconstructions.h5") as file:
        assert {*file["n"]} == {"truth", "greit"}


@pytest.mark.slow
def test_methods_that_come_later_stand_beside_the_rows_of_the_record_before(
    record: Path, tmp_path: Path
) -> None:
    """As in a record of a run of all, but for times; `greit` is run again, `noser` is not."""
    names = ("greit", "noser", "tikhonov")
    suite = SUITE.model_copy(update={"methods": names})
    part = start_run(make_plan(suite, methods=("greit", "tikhonov")), tmp_path / "part").path
    with pytest.raises(InputError, match="lacks the method 'noser'"):
        write_record(part, tmp_path / "2026.1" / "mine")
    grown = read_run(write_record(part, tmp_path / "2026.2" / "mine", record))
    whole = start_run(make_plan(suite), tmp_path / "whole").path
    every = read_run(write_record(whole, tmp_path / "2026.3" / "mine"))
    figures = ["scenario", "method", "sample", "input_hash", "psnr", "ssim", "score"]
    # Rows stand in the order of the suite, whatever run they are from.
    one, other = (of.samples[figures].reset_index(drop=True) for of in (grown, every))
    pd.testing.assert_frame_equal(one, other)
    assert grown.cells["method"].tolist() == every.cells["method"].tolist() == list(names)
    sums = [dict(zip(of.cells["method"], of.cells["checksums"], strict=True)) for of in
            (read_run(record), grown, every)]  # fmt: skip
    assert sums[1] == sums[2]
    assert sums[1]["noser"] == sums[0]["noser"]
    before = read_run(record)
    shown = before.scene("n", range(SCENARIO.test)).sample.tolist()
    for name in names:
        images = grown.estimates("n", name, shown)
        assert images is not None
        assert np.isfinite(images).all()
        if name != "tikhonov":
            np.testing.assert_array_equal(images, before.estimates("n", name, shown))
    (added,) = grown.manifest["added"]
    assert (added["cells"], added["same_bits"]) == (["n/greit", "n/tikhonov"], True)
    assert grown.manifest["started"] == before.manifest["started"]
    assert grown.manifest["plan"]["names"] == ["noser", "greit", "tikhonov"]
    assert {row["method"] for row in leaderboard_rows([grown])} == set(names)
    # Another kind of processor gives the frames other last bits: the record names them as before.
    samples = pd.read_parquet(part / "samples.parquet")
    samples["input_hash"] = samples["input_hash"].str[::-1]
    samples.to_parquet(part / "samples.parquet")
    elsewhere = read_run(write_record(part, tmp_path / "2026.5" / "mine", record))
    assert elsewhere.manifest["added"][0]["same_bits"] is False
    assert elsewhere.samples.equals(grown.samples)
    # What comes later still replaces what it was run again for.
    third = start_run(make_plan(suite, methods=("tikhonov",)), tmp_path / "third").path
    last = read_run(write_record(third, tmp_path / "2026.4" / "mine", grown.path))
    assert [of["cells"] for of in last.manifest["added"]] == [["n/greit"], ["n/tikhonov"]]


@pytest.mark.slow
def test_a_scenario_that_is_run_again_leaves_the_others_as_they_were(tmp_path: Path) -> None:
    second = SCENARIO.model_copy(update={"name": "m", "families": ("triangle",), "test": 12})
    suite = SUITE.model_copy(update={"scenarios": (SCENARIO, second)})
    made = start_run(make_plan(suite), tmp_path / "whole").path
    before = read_run(write_record(made, tmp_path / "2026.1" / "mine"))
    parameters = {"greit": {"weight": 0.5}}
    plan = make_plan(suite, methods=("greit",), scenarios=("m",), parameters=parameters)
    part = start_run(plan, tmp_path / "part").path
    grown = read_run(write_record(part, tmp_path / "2026.2" / "mine", before.path))
    found = changes(before.path, grown.path)
    assert (found.taken, list(found.changed)) == (["noser"], ["greit"])
    assert "12 of 12 samples of m" in found.changed["greit"]
    assert "samples of n" not in found.changed["greit"]
    for of in (before, grown):
        assert list(of.cells["scenario"] + "/" + of.cells["method"]) == [
            "n/noser", "n/greit", "m/noser", "m/greit"
        ]  # fmt: skip
    for scenario in ("n", "m"):
        shown = before.scene(scenario, range(30)).sample.tolist()
        assert grown.scene(scenario, range(30)).sample.tolist() == shown
        one, other = (of.estimates(scenario, "greit", shown) for of in (before, grown))
        assert one is not None
        assert other is not None
        assert np.array_equal(one, other) == (scenario == "n")


@pytest.mark.slow
def test_rows_of_a_scenario_that_changed_are_not_taken(tmp_path: Path) -> None:
    """Nor are scenarios and methods that the suite has no more."""
    second = SCENARIO.model_copy(update={"name": "m", "test": 6})
    suite = SUITE.model_copy(update={"scenarios": (SCENARIO, second)})
    made = start_run(make_plan(suite), tmp_path / "whole").path
    before = write_record(made, tmp_path / "2026.1" / "mine")
    noisier = second.model_copy(update={"noise": SplitNoise(test=30.0)})
    changed = suite.model_copy(update={"scenarios": (SCENARIO, noisier)})
    part = start_run(make_plan(changed, methods=("greit",), scenarios=("n",)), tmp_path / "n").path
    with pytest.raises(InputError, match=r"frames of 'm' are others than in .*: run it with all"):
        write_record(part, tmp_path / "2026.2" / "mine", before)
    new = second.model_copy(update={"name": "k"})
    other = suite.model_copy(update={"scenarios": (SCENARIO, new)})
    part = start_run(make_plan(other, methods=("greit",), scenarios=("k",)), tmp_path / "k").path
    with pytest.raises(InputError, match="it lacks the method 'noser' on 'k'"):
        write_record(part, tmp_path / "2026.2" / "mine", before)
    alone = start_run(make_plan(SUITE, methods=("greit",)), tmp_path / "alone").path
    kept = read_run(write_record(alone, tmp_path / "2026.2" / "mine", before))
    assert set(kept.cells["scenario"]) == {"n"}
    assert list(kept.manifest["data"]) == ["n"]


def test_cells_of_another_machine_are_compared_to_its_rounding(
    run: Path, record: Path, tmp_path: Path
) -> None:
    part = start_run(make_plan(SUITE, methods=("greit",)), tmp_path / "part").path
    with edited_manifest(part) as content:
        content["machine"]["cpu"] = "another"
    samples = pd.read_parquet(part / "samples.parquet")
    samples["psnr"] *= 1 + 1e-12
    samples.to_parquet(part / "samples.parquet")
    newer = write_record(part, tmp_path / "2026.2" / "mine", record)
    found = changes(record, newer)
    assert (found.kept, found.taken, found.changed) == (["greit"], ["noser"], {})
    assert not found.exact


def test_notes_of_scenarios_that_are_not_run_again_are_kept(record: Path, tmp_path: Path) -> None:
    noted = Path(shutil.copytree(record, tmp_path / "2026.1" / "mine"))
    (noted / "recordings.json").write_text(json.dumps({"elsewhere": {"repeat_noise": 0.5}}))
    part = start_run(make_plan(SUITE, methods=("greit",)), tmp_path / "part").path
    newer = read_run(write_record(part, tmp_path / "2026.2" / "mine", noted))
    assert newer.notes == {"elsewhere": {"repeat_noise": 0.5}}


def test_the_leaderboard_is_of_the_parameters_that_are_chosen_now() -> None:
    of_version = sorted(BOARD.glob("2*/*/manifest.json"), key=lambda p: version_key(p.parts[-3]))
    newest = {record.parent.name: record for record in of_version}
    for suite, record in newest.items():
        assert outdated(json.loads(record.read_text())) == [], suite


def test_the_same_weights_learned_from_the_same_data() -> None:
    """Rows by an older version of a method that said less of its training are run again."""
    version = max(BOARD.glob("2*"), key=lambda path: version_key(path.name))
    learned: dict[tuple[str, str], dict[str, list[str]]] = {}
    for path in sorted(version.glob("*/methods.parquet")):
        cells = json.loads((path.parent / "manifest.json").read_text())["cells"]
        weights = {(of["scenario"], of["name"]): of["weights"] for of in cells}
        table = pd.read_parquet(path)
        for row in table.to_dict("records") if "prior_knowledge" in table else ():
            of = str(row["method"]), weights[str(row["scenario"]), str(row["method"])]
            said = json.dumps(json.loads(str(row["prior_knowledge"]))["trained_on"])
            where = f"{path.parent.name}/{row['scenario']}"
            learned.setdefault(of, {}).setdefault(said, []).append(where)
    assert len(learned) > 20
    assert {of: said for of, said in learned.items() if of[1] and len(said) > 1} == {}


def test_records_name_commits_of_the_history() -> None:
    """A commit that makes a record again."""
    root = Path(__file__).parents[3]
    git = ["git", "-C", str(root)]
    shallow = [*git, "rev-parse", "--is-shallow-repository"]
    told = subprocess.run(shallow, capture_output=True, text=True, check=False).stdout
    if told.strip() != "false":
        pytest.skip("the history of this checkout is not whole")
    made = set[str | None]()
    for record in BOARD.glob("2*/*/manifest.json"):
        content = json.loads(record.read_text())
        made.update(c for of in [content, *content.get("added", [])] for c in commits(of))
    listed = subprocess.run([*git, "rev-list", "HEAD"], capture_output=True, text=True, check=True)
    history = {*listed.stdout.split()}
    if not made & history:
        pytest.skip("this checkout has another history")
    assert not made - history


def test_methods_on_other_frames_do_not_stand_beside_a_record(record: Path, tmp_path: Path) -> None:
    noisier = SCENARIO.model_copy(update={"noise": SplitNoise(test=30.0)})
    suite = SUITE.model_copy(update={"scenarios": (noisier,)})
    part = start_run(make_plan(suite, methods=("greit",)), tmp_path / "part").path
    with pytest.raises(InputError, match=r"frames of 'n' are others than in .*: run it with all"):
        write_record(part, tmp_path / "2026.2" / "mine", record)
    assert not (tmp_path / "2026.2").exists()
    whole = start_run(make_plan(suite), tmp_path / "whole").path
    made = write_record(whole, tmp_path / "2026.2" / "mine", record)
    alone = write_record(whole, tmp_path / "alone" / "2026.2" / "mine")
    joint, single = read_run(made), read_run(alone)
    assert joint.manifest["data"] == single.manifest["data"]
    pd.testing.assert_frame_equal(joint.samples, single.samples)
    with (
        h5py.File(made / "reconstructions.h5") as found,
        h5py.File(alone / "reconstructions.h5") as new,
    ):
        for name in new["n"]:
            np.testing.assert_array_equal(
                found[f"n/{name}/conductivity"], new[f"n/{name}/conductivity"]
            )


def test_every_change_of_the_leaderboard_has_its_reason() -> None:
    """Methods that nobody changed keep their figures, to the last bit on one kind of machine."""
    for manifest in BOARD.glob("2*/*/manifest.json"):
        if (older := last_before(manifest.parent)) is not None:
            found = changes(older, manifest.parent)
            assert found.changed.keys() | set(found.gone) <= reasons(manifest.parents[1]).keys()


@pytest.mark.slow
@pytest.mark.parametrize(
    "record",
    sorted(path.parent for path in BOARD.glob("2*/*/manifest.json")),
    ids=lambda path: f"{path.parent.name}-{path.name}",
)
def test_every_record_has_a_board_that_prints(record: Path) -> None:
    done = CliRunner().invoke(results, ["leaderboard", str(record), "--format", "md"])
    assert done.exception is None
    assert any(tier in done.stdout for tier in ("all samples, by the maintainers", ": hidden"))
