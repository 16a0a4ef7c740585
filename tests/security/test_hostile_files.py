"""Files made to harm: bombs, ways into other files, nesting without end. Each costs a sentence."""

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest, write_manifest

from eitbench.benchmark.analysis.results import Run, read_table
from eitbench.benchmark.rundir.cells import Batch, Cell
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import read as read_manifest
from eitbench.benchmark.rundir.store import RunStore
from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import sensor
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings.files.csv_mat import read_csv
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.sensors.sensor_file import read_sensor
from eitbench.scenarios.suites.suite import read_suite

CELL = Cell("s", "m")


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    store = RunStore(tmp_path / "run", METHOD_RUNS)
    values = {"conductivity": np.ones((1, 4, 4))}
    store.save_batch(CELL, "test", Batch(0, ["ok"], [""], values, "{}"))
    return store


def part_of(store: RunStore) -> Path:
    (path,) = store.path.rglob("*.npz")
    return path


def archive(members: dict[str, bytes], way: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", way) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return out.getvalue()


def members_of(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def resumed(store: RunStore) -> RunStore:
    """The same directory for a run that is continued, which wrote none of its parts."""
    return RunStore(store.path, store.kind)


@pytest.mark.slow
def test_a_zip_bomb_is_not_unpacked(store: RunStore) -> None:
    path = part_of(store)
    zeros = io.BytesIO()
    np.save(zeros, np.zeros(25_000_000))
    members = members_of(path) | {"bomb.npy": zeros.getvalue()}
    path.write_bytes(archive(members, zipfile.ZIP_DEFLATED))
    assert path.stat().st_size < 300_000
    with pytest.raises(DataCorruptError, match="more than the file"):
        resumed(store).batch(CELL, "test", 0)


def test_names_in_an_archive_lead_nowhere(store: RunStore, tmp_path: Path) -> None:
    path = part_of(store)
    before = sorted(tmp_path.rglob("*"))
    array = members_of(path)["conductivity.npy"]
    names = dict.fromkeys(["../../../up.npy", "/root/up.npy", "C:\\up.npy"], array)
    path.write_bytes(archive(members_of(path) | names, zipfile.ZIP_STORED))
    assert "../../../up" in resumed(store).batch(CELL, "test", 0).values
    assert sorted(tmp_path.rglob("*")) == before


def test_objects_in_an_archive_are_not_unpickled(store: RunStore, tmp_path: Path) -> None:
    path = part_of(store)

    class Touch:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "touched",)

    array = io.BytesIO()
    np.save(array, np.array([Touch()], dtype=object))
    path.write_bytes(archive(members_of(path) | {"x.npy": array.getvalue()}, zipfile.ZIP_STORED))
    with pytest.raises(DataCorruptError, match="Object arrays cannot be loaded"):
        resumed(store).batch(CELL, "test", 0)
    assert not (tmp_path / "touched").exists()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    foam = sensor("foam16")
    with Recorder(tmp_path / "sound.h5", foam, "fake") as recorder:
        for k in range(3):
            recorder.append(Frame(k, float(k), float(k), np.ones(foam.n_measurements)))
    return tmp_path / "sound.h5"


def outside_data(file: h5py.File, folder: Path) -> None:
    (folder / "secret").write_bytes(bytes(range(256)) * 30)
    file.create_dataset("frames/time_s", (3,), "<f8", external=[(folder / "secret", 0, 24)])


def outside_link(file: h5py.File, folder: Path) -> None:
    with h5py.File(folder / "other.h5", "w") as other:
        other["times"] = np.arange(3.0)
    file["frames/time_s"] = h5py.ExternalLink(str(folder / "other.h5"), "/times")


def outside_source(file: h5py.File, folder: Path) -> None:
    with h5py.File(folder / "other.h5", "w") as other:
        other["times"] = np.arange(3.0)
    layout = h5py.VirtualLayout((3,), "<f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "times", (3,))
    file.create_virtual_dataset("frames/time_s", layout)


@pytest.mark.parametrize("lead", [outside_data, outside_link, outside_source])
def test_a_recording_does_not_read_other_files(
    recording: Path, tmp_path: Path, lead: Callable[[h5py.File, Path], None]
) -> None:
    with h5py.File(recording, "r+") as file:
        del file["frames/time_s"]
        lead(file, tmp_path)
    with pytest.raises(DataCorruptError, match=r"'frames/time_s' (leads|is a link)"):
        read_file(recording)


def images(path: Path, size: int) -> Run:
    """A run whose file of arrays claims `size` images of which none was ever written."""
    with h5py.File(path / METHOD_RUNS.arrays, "w") as file:
        group = file.create_group("s/m")
        group["sample"] = np.arange(3)
        group.create_dataset("conductivity", (3, size, size), "<f4", chunks=(1, 64, 64))
        file["s/truth/mask"] = np.ones((64, 64), bool)
    return Run(path, METHOD_RUNS, {"data": {"s": {"n": 3}}}, pd.DataFrame(), pd.DataFrame(), {})


def test_images_that_were_never_written_take_no_memory(tmp_path: Path) -> None:
    assert images(tmp_path, 64).estimates("s", "m", range(3)) is not None
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5 is damaged"):
        images(tmp_path, 100_000).estimates("s", "m", range(3))


@pytest.mark.parametrize(
    "table",
    [
        {"data": {"a": np.zeros(8_000_000)}, "compression": "zstd"},
        {"data": {"a": np.zeros(40_000_000, np.int8)}, "compression": "snappy"},
        {"data": {"a": ["x" * 100_000] * 1_000}, "compression": "snappy"},
    ],
)
def test_tables_much_larger_than_their_file_are_refused(
    tmp_path: Path, table: dict[str, Any]
) -> None:
    path = tmp_path / "bomb.parquet"
    pd.DataFrame(table["data"]).to_parquet(path, compression=table["compression"])
    with pytest.raises(DataCorruptError, match=r"bomb\.parquet"):
        read_table(path)


@pytest.mark.parametrize(
    "text",
    [
        f"a{'.a' * 80_000} = 1",
        f"[a{'.a' * 80_000}]",
        f"x = {{a{' . a' * 40_000} = 1}}",
        "'a'" + """."\\"" . 'a'""" * 15_000 + " = 1",
    ],
)
def test_dotted_keys_cost_no_quadratic_time(tmp_path: Path, text: str) -> None:
    """Reading the first took hours: the time of a key grows with the square of its length."""
    (tmp_path / "dots.toml").write_text(text)
    with pytest.raises(InputError, match="a key of more than 32 parts"):
        read_sensor(tmp_path / "dots.toml")


def test_long_words_and_many_numbers_are_looked_through_at_once(tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text(f"{'a' * 190_000} = 1")
    with pytest.raises(InputError, match="unknown field"):
        read_sensor(tmp_path / "long.toml")
    (tmp_path / "large.toml").write_text("a = 1\n" + "# 1.5, 2.5\n" * 100_000)
    with pytest.raises(InputError, match="larger than 200 kB"):
        read_sensor(tmp_path / "large.toml")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    """Nobody writes to it, and opening it would wait for ever."""
    for name in ("pipe.toml", "pipe.h5"):
        os.mkfifo(tmp_path / name)
    suite = """
name = "s"
title = "t"
methods = ["noser"]
[[scenarios]]
name = "a"
"""
    for field in (
        'kind = "simulated"\nsensor = "pipe.toml"',
        'kind = "recorded"\nrecording = "pipe.h5"',
    ):
        (tmp_path / "suite.toml").write_text(suite + field)
        with pytest.raises(InputError, match="it is a pipe or a device, not a file"):
            read_suite(tmp_path / "suite.toml")
    with pytest.raises(InputError, match="it is a pipe or a device, not a file"):
        read_suite(tmp_path / "pipe.toml")


DEEP = "[" * 100_000


def test_nesting_without_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(f"a = {DEEP}")
    with pytest.raises(InputError, match=r"deep\.toml"):
        read_sensor(tmp_path / "deep.toml")
    (tmp_path / "long.toml").write_text(f"a = {'9' * 10_000}")
    with pytest.raises(InputError, match="number"):
        read_sensor(tmp_path / "long.toml")
    (tmp_path / "manifest.json").write_text(DEEP)
    with pytest.raises(DataCorruptError, match="cannot be read"):
        read_manifest(tmp_path)
    (tmp_path / "deep.csv").write_text(f"# eitbench recording 2\n# sensor: {DEEP}\n")
    with pytest.raises(DataCorruptError, match="sensor"):
        read_csv(tmp_path / "deep.csv")


PLAN: dict[str, Any] = {
    "suite": {"name": "mine", "scenarios": []},
    "names": [],
    "scenarios": [],
    "limit": None,
    "plugins": [],
}


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ({"data": {"s": 3}}, "data.s"),
        ({"calibration_ms": "fast"}, "calibration_ms"),
        ({"calibration_ms": 0}, "calibration_ms"),
        ({"plan": PLAN | {"plugins": [{"path": 3}]}}, "plan.plugins.0.path"),
        ({"plan": PLAN | {"suite": {"name": "mine"}}}, "plan.suite.scenarios"),
        ({"skipped": ["a"]}, "skipped"),
    ],
)
def test_a_manifest_of_other_kinds_is_refused(
    tmp_path: Path, content: dict[str, Any], field: str
) -> None:
    write_manifest(tmp_path, "mine", {}, [])
    with edited_manifest(tmp_path) as manifest:
        manifest |= content
    with pytest.raises(DataCorruptError, match=field):
        read_manifest(tmp_path)


@pytest.mark.parametrize("name", ["status", "plan", "cells", "data", "skipped", "machine"])
def test_a_manifest_that_lacks_something_is_refused(tmp_path: Path, name: str) -> None:
    write_manifest(tmp_path, "mine", {}, [])
    read_manifest(tmp_path)
    with edited_manifest(tmp_path) as manifest:
        del manifest[name]
    with pytest.raises(DataCorruptError, match=f"{name}: it is missing"):
        read_manifest(tmp_path)
