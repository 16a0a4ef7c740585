"""Files that appear whole or not at all."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from eitbench.scenarios.storage.atomic_write import ABANDONED_AFTER_S, atomic_write

# Writes one of two contents for as long as it lives.
WRITER = """
import sys
from pathlib import Path
from eitbench.scenarios.storage.atomic_write import atomic_write
for k in range(10**9):
    atomic_write(Path(sys.argv[1]), b"ab"[k % 2 : k % 2 + 1] * 3_000_000)
"""


WHOLE = (b"a" * 3_000_000, b"b" * 3_000_000)


@pytest.mark.parametrize("writes", [1, 2, 3])
def test_a_killed_writer_leaves_a_whole_file_and_others_read_whole_ones(
    writes: int, tmp_path: Path
) -> None:
    """The writer is killed after so many of its files were seen, amid the next."""
    path, deadline = tmp_path / "file", time.monotonic() + 120
    seen: set[int] = set()
    with subprocess.Popen([sys.executable, "-c", WRITER, path]) as writer:
        try:
            while len(seen) < writes:
                assert time.monotonic() < deadline
                if path.exists():
                    assert path.read_bytes() in WHOLE
                    seen.add(path.stat().st_mtime_ns)
        finally:
            writer.kill()
    assert path.read_bytes() in WHOLE


def test_threads_that_write_at_once_leave_one_of_their_files(tmp_path: Path) -> None:
    contents = [bytes([k]) * 100_000 for k in range(20)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda content: atomic_write(tmp_path / "in" / "file", content), contents))
    (path,) = (tmp_path / "in").iterdir()
    assert path.read_bytes() in contents


def test_what_cannot_be_written_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.mkdir()  # which a file cannot replace
    with pytest.raises(OSError, match="directory"):
        atomic_write(path, b"new")
    assert list(tmp_path.iterdir()) == [path]


def test_parts_that_a_killed_process_left_are_removed_but_fresh_ones_are_not(
    tmp_path: Path,
) -> None:
    path = tmp_path / "file"
    old, fresh, other = (
        tmp_path / f".{name}.part" for name in ("file.1-1", "file.2-1", "left.1-1")
    )
    for part in (old, fresh, other):
        part.write_bytes(b"half")
    past = time.time() - ABANDONED_AFTER_S - 10
    for part in (old, other):
        os.utime(part, (past, past))
    atomic_write(path, b"whole")
    assert set(tmp_path.iterdir()) == {fresh, other, path}


def test_a_function_may_write_the_content(tmp_path: Path) -> None:
    def half(part: Path) -> None:
        part.write_bytes(b"half")
        raise OSError("full")

    path = tmp_path / "in" / "file"
    atomic_write(path, lambda part: part.write_bytes(b"whole"))
    with pytest.raises(OSError, match="full"):
        atomic_write(path, half)
    assert path.read_bytes() == b"whole"
    assert list(path.parent.iterdir()) == [path]
