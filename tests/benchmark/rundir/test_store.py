"""The run directory keeps whole rows or none."""

import errno
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.rundir.cells import Batch, Cell
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.store import RunStore
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError

CELL = Cell("some-scenario", "some-method")


def batch(start: int) -> Batch:
    images = np.full((2, 3, 4), float(start), dtype=np.float32)
    images[1] = np.nan
    values = {"conductivity": images, "frame_ms": np.array([1.5, np.nan])}
    return Batch(start, ["ok", "error"], ["", "ValueError: ü"], values, "{}")


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    return RunStore.create(tmp_path / "run", METHOD_RUNS)


def test_batches_come_back_in_order(store: RunStore) -> None:
    for start in (2, 0, 4):
        store.save_batch(CELL, "test", batch(start))
    store.save_batch(CELL, "validation", batch(0))
    found = list(store.batches(CELL, "test"))
    assert [b.start for b in found] == [0, 2, 4]
    assert [b.stop for b in found] == [2, 4, 6]
    assert found[1].status == ["ok", "error"]
    assert found[1].message == ["", "ValueError: ü"]
    assert found[1].values.keys() == {"conductivity", "frame_ms"}
    for name, array in batch(2).values.items():
        np.testing.assert_array_equal(found[1].values[name], array)
    assert store.batch_length(CELL, "test", 2) == 2
    assert not store.batch_length(CELL, "test", 6)


def test_a_full_disk_is_one_sentence_and_leaves_no_part(
    store: RunStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: BinaryIO, **arrays: object) -> None:
        file.write(b"half of it")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(EitbenchError, match="No space left on device"):
        store.save_batch(CELL, "test", batch(0))
    assert not store.batch_length(CELL, "test", 0)
    assert not [path for path in (store.path / "parts").rglob("*") if path.is_file()]


@pytest.mark.parametrize("size", [0, 100])
def test_a_truncated_batch_is_named(size: int, store: RunStore) -> None:
    store.save_batch(CELL, "test", batch(0))
    (path,) = store.path.rglob("*.npz")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(DataCorruptError, match=path.name):
        list(store.batches(CELL, "test"))


def test_an_output_in_use_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="not empty"):
        RunStore.create(tmp_path, METHOD_RUNS)
    with pytest.raises(InputError, match="is a file"):
        RunStore.create(tmp_path / "notes.txt", METHOD_RUNS)
    with pytest.raises(EitbenchError, match="Not a directory"):
        RunStore.create(tmp_path / "notes.txt" / "run", METHOD_RUNS)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_run_killed_before_it_began_may_be_started_again(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / ".lock").write_text("")
    RunStore.create(tmp_path, METHOD_RUNS)
    (tmp_path / "logs" / "a.log").write_text("")
    with pytest.raises(InputError, match="not empty"):
        RunStore.create(tmp_path, METHOD_RUNS)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"half of it"])
def test_truncated_rows_are_named(content: bytes, store: RunStore) -> None:
    store.save_batch(CELL, "test", batch(0))
    store.save_cell(CELL, pd.DataFrame({"sample": [0, 1]}), {"complete": True})
    assert store.finished(CELL)
    (path,) = store.path.rglob("methods.parquet")
    path.write_bytes(content)
    with pytest.raises(DataCorruptError, match=r"methods\.parquet"):
        store.finished(CELL)
    path.unlink()
    assert not store.finished(CELL)


@pytest.mark.parametrize("name", ["..", ".", "a method", "ünï:cø*de?", "x" * 80, "ü" * 40])
def test_method_names_stay_inside_the_run(name: str, store: RunStore, tmp_path: Path) -> None:
    run = store.path
    cell = Cell("some-scenario", name)
    store.log(cell).write_text("")
    store.save_batch(cell, "test", batch(0))
    assert store.batch_length(cell, "test", 0) == 2
    assert store.log(cell).parent == run / "logs"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    (part,) = run.rglob("*.npz")
    assert part.relative_to(run).parts[:2] == ("parts", "some-scenario")
    assert len(part.relative_to(run).parts) == 4


def test_a_part_that_another_process_wrote_is_refused(store: RunStore, tmp_path: Path) -> None:
    """Not one of a run that is continued: it knows those that are there as it begins."""
    store.save_batch(CELL, "test", batch(0))
    store.save_batch(CELL, "test", batch(2))
    (first, second) = sorted(store.path.glob("parts/*/*/*.npz"))
    second.write_bytes(first.read_bytes())
    assert len(store.batch(CELL, "test", 0)) == 2
    with pytest.raises(DataCorruptError, match=f"{second.name}.* was changed by something else"):
        store.batch(CELL, "test", 2)
    third = second.with_name("test-00000004.npz")
    third.write_bytes(first.read_bytes())
    with pytest.raises(DataCorruptError, match=f"{third.name}.* was changed by something else"):
        store.batch_length(CELL, "test", 4)
    assert RunStore(store.path, store.kind).batch_length(CELL, "test", 4) == 2
