"""Run directories that somebody else made: what they hold cannot lead elsewhere or fill memory."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest, made

from eitbench.benchmark.analysis.comparison import read_results
from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir.manifest import read as read_manifest
from eitbench.benchmark.rundir.run_arrays import MOST_BYTES
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.rundir.tables import write_parquet
from eitbench.hardware.recording.exchange import import_recording
from eitbench.reports.page.report import write_report
from eitbench.reports.site.site import write_site
from eitbench.reports.tables.leaderboard import write_leaderboard
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, UnreadableError
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.sensors.sensor import foam16
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.try_reading import try_reading

READERS: dict[str, Callable[[Path], object]] = {
    "leaderboard": read_run,
    "compare": read_results,
    "rescore": rescore,
    "report": lambda run: write_report([run], run / "report"),
}


@pytest.fixture
def run(build: Any) -> Path:
    path: Path = build.add_scaled(made("conductivity", 3), {"some": 0.9}).write()
    return path


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize("name", ["leaderboard.csv", "samples.parquet", "figures", "logs/a.log"])
def test_a_link_in_a_run_is_refused_and_never_followed(
    run: Path, tmp_path: Path, name: str, read: Callable[[Path], object]
) -> None:
    """A shell file behind `leaderboard.csv` was overwritten with a table, and then ran it."""
    mine = tmp_path / "profile"
    mine.write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).symlink_to(mine)
    with pytest.raises(DataCorruptError, match="is a link"):
        read(run)
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("name", ["manifest.json", "samples.parquet", "reconstructions.h5", "x"])
def test_a_pipe_in_a_run_is_refused_at_once(run: Path, name: str) -> None:
    (run / name).unlink(missing_ok=True)
    os.mkfifo(run / name)
    with pytest.raises(EitbenchError, match=r"is a pipe|no manifest"):
        read_run(run)


def test_writing_replaces_a_link(run: Path, tmp_path: Path) -> None:
    mine = tmp_path / "profile"
    mine.write_text("mine")
    for name in ("leaderboard.csv", "leaderboard.md", "leaderboard.json"):
        (run / name).symlink_to(mine)
    write_leaderboard([], run)
    (run / "notes").symlink_to(mine)
    atomic_write(run / "notes", b"ours")
    assert mine.read_text() == "mine"
    assert not any(path.is_symlink() for path in run.iterdir())


def test_a_site_leaves_linked_runs_out(run: Path, tmp_path: Path) -> None:
    (run.parent / "elsewhere").symlink_to(run)
    written = write_site(run.parent, tmp_path / "site").pages
    assert "elsewhere is left out: it is a link" in written[0].read_text()


def change(run: Path, part: str, make: Callable[[h5py.Group, str], object]) -> None:
    """Put something else in the place of a dataset of the images of "some"."""
    with h5py.File(run / "reconstructions.h5", "r+") as file:
        group = file["conductivity-set"]["some"]
        del group[part]
        make(group, part)


def of_variable_length(group: h5py.Group, name: str) -> None:
    group.create_dataset(name, data=np.full(3, "x" * 100, object), dtype=h5py.string_dtype())


def larger_than_said(group: h5py.Group, name: str) -> None:
    shape, chunks = (100_000, 40, 40), (1000, 40, 40)
    group.create_dataset(name, shape, "<f4", chunks=chunks, compression="gzip")


def in_one_large_piece(group: h5py.Group, name: str) -> None:
    """Three images, stored in a chunk of 400 MB that is unpacked to read any of them."""
    group.create_dataset(
        name, (3, 40, 40), "<f4", maxshape=(None, 40, 40), chunks=(62_500, 40, 40), compression=1
    )


def a_soft_link(group: h5py.Group, name: str) -> None:
    group[name] = h5py.SoftLink("/conductivity-set/truth/conductivity")


@pytest.mark.parametrize(
    ("part", "make"),
    [("sample", of_variable_length), ("conductivity", larger_than_said),
     ("conductivity", in_one_large_piece), ("conductivity", a_soft_link)],
)  # fmt: skip
def test_images_are_as_many_and_as_large_as_the_manifest_says(
    run: Path, part: str, make: Callable[[h5py.Group, str], object]
) -> None:
    """12 MB of texts of variable length took 13 GiB, 6.5 MB of gzip 6.5 GiB."""
    change(run, part, make)
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5 is damaged"):
        read_run(run).estimates("conductivity-set", "some", range(3))


@pytest.mark.parametrize(
    ("name", "value"),
    [("bounds", [0.0, 0.0, np.nan, 1.0]), ("bounds", [0.0] * 4), ("background", 0.0)],
)
def test_images_have_a_place_and_a_background(run: Path, name: str, value: object) -> None:
    with h5py.File(run / "reconstructions.h5", "r+") as file:
        file["conductivity-set/truth"].attrs[name] = value
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5 is damaged"):
        read_run(run).scene("conductivity-set", [0])


def test_folders_may_lie_deep(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """1,500 of them ended in a traceback."""
    monkeypatch.chdir(run)
    for _ in range(1500):
        Path("a").mkdir()
        os.chdir("a")
    Path("link").symlink_to("/")
    try:
        with pytest.raises(DataCorruptError, match="/a/a/a/"):
            read_run(run)
    finally:  # who tidies up would go down as deep
        Path("link").unlink()
        for _ in range(1500):
            os.chdir("..")
            Path("a").rmdir()


def test_a_linked_group_is_refused(run: Path) -> None:
    with h5py.File(run / "reconstructions.h5", "r+") as file:
        file.move("conductivity-set/some", "elsewhere")
        file["conductivity-set/some"] = h5py.SoftLink("/elsewhere")
    with pytest.raises(DataCorruptError, match="holds no images"):
        read_run(run).estimates("conductivity-set", "some", range(3))


def test_a_manifest_cannot_ask_for_memory_without_end(run: Path) -> None:
    with edited_manifest(run) as manifest:
        manifest["data"]["conductivity-set"]["n"] = 10**7
    with pytest.raises(DataCorruptError, match=r"data\.conductivity-set\.n"):
        read_run(run)
    with edited_manifest(run) as manifest:
        manifest["data"]["conductivity-set"]["n"] = 10**6
    change(run, "conductivity", larger_than_said)
    change(run, "sample", lambda group, name: group.create_dataset(name, data=np.arange(100_000)))
    with h5py.File(run / "reconstructions.h5", "r+") as file:
        del file["conductivity-set/some/conductivity"], file["conductivity-set/truth/mask"]
        shape = (100_000, 200, 200)
        file["conductivity-set/truth/mask"] = np.ones(shape[1:], bool)
        group = file["conductivity-set/some"]
        group.create_dataset("conductivity", shape, "<f4", chunks=(1, 200, 200))
    assert 4 * np.prod(shape, dtype=float) > MOST_BYTES
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5 is damaged"):
        read_run(run).estimates("conductivity-set", "some", range(100_000))


@pytest.mark.slow
def test_tables_have_no_more_rows_and_text_than_the_run(run: Path) -> None:
    samples = pd.read_parquet(run / SAMPLES)
    write_parquet(pd.concat([samples] * 2), run / SAMPLES)
    with pytest.raises(DataCorruptError, match="has 6 rows, and its run 3"):
        read_run(run)
    write_parquet(samples.assign(message="x" * 20_000_000), run / SAMPLES)
    with pytest.raises(DataCorruptError, match="texts are longer"):
        read_run(run)
    write_parquet(samples.assign(method="x" * 81), run / SAMPLES)
    with pytest.raises(DataCorruptError, match="a name of more than 80 bytes"):
        read_run(run)


def test_a_manifest_holds_unicode_and_short_texts(run: Path) -> None:
    path = run / "manifest.json"
    content = json.loads(path.read_text())
    for versions in ({"eitbench": "\ud800"}, {"eitbench": "1" * 5000}):
        path.write_text(json.dumps(content | {"versions": versions}))
        with pytest.raises(DataCorruptError, match="manifest"):
            read_manifest(run)
    path.write_text(json.dumps(content) + " " * 2**24)
    with pytest.raises(DataCorruptError, match="larger than"):
        read_manifest(run)


def imported(path: Path) -> object:
    return import_recording([str(path)], path.with_name("new.h5"), foam16())


@pytest.mark.parametrize("name", ["frames.csv", "frames.mat", "frames.h5"])
def test_a_pipe_is_no_recording(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    read = read_file if name.endswith(".h5") else imported
    with pytest.raises(UnreadableError, match="is a pipe"):
        read(tmp_path / name)
    assert not (tmp_path / "new.h5").exists()


def test_images_are_tried_first_too(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eitbench.benchmark.analysis.results.read_estimates", lambda *_: crash())
    with pytest.raises(DataCorruptError, match="died of SIGSEGV"):
        read_run(run)


def hang() -> None:
    time.sleep(3600)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def swallow() -> None:
    np.ones(2**40)


@pytest.mark.parametrize(
    ("read", "why"),
    [(hang, "longer than 1 s"), (crash, "died of SIGSEGV"), (swallow, "of memory")],
)
def test_what_reads_a_file_may_die_of_it(
    monkeypatch: pytest.MonkeyPatch, read: Callable[[], None], why: str
) -> None:
    monkeypatch.setattr("eitbench.scenarios.storage.try_reading.TIME_LIMIT_S", 1)
    with pytest.raises(DataCorruptError, match=why):
        try_reading(Path("file"), read)
