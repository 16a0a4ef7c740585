"""The lock of a run directory where a system removes no file that is open, as Windows does."""

from pathlib import Path

import pytest
from filelock import FileLock

from eitbench.benchmark.rundir import lock
from eitbench.benchmark.rundir.lock import FILE_NAME
from eitbench.scenarios.errors import InputError

OPEN_FILES = Path("/proc/self/fd")
pytestmark = pytest.mark.skipif(not OPEN_FILES.exists(), reason="needs Linux, to see open files")


@pytest.fixture(autouse=True)
def as_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    unlink = Path.unlink

    def refusing(path: Path, missing_ok: bool = False) -> None:
        opened = [link.resolve() for link in OPEN_FILES.iterdir() if link.is_symlink()]
        if path.resolve() in opened:
            raise PermissionError(13, "The process cannot access the file", str(path))
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refusing)


def test_the_file_is_removed_after_it_is_let_go(tmp_path: Path) -> None:
    for _ in range(2):
        with lock.locked(tmp_path):
            assert (tmp_path / FILE_NAME).exists()
        assert list(tmp_path.iterdir()) == []


def test_the_file_stays_if_another_process_takes_it_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = FileLock(tmp_path / FILE_NAME, timeout=0)

    class Losing(FileLock):
        def release(self, force: bool = False) -> None:
            super().release(force)
            if not other.is_locked:
                other.acquire()

    with monkeypatch.context() as patch:
        patch.setattr(lock, "FileLock", Losing)
        with lock.locked(tmp_path):
            pass
    assert other.is_locked
    with pytest.raises(InputError, match="Another process is working"), lock.locked(tmp_path):
        pass
    other.release()
