"""A confined worker: where it can write, what it can touch, and what is noted of it."""

import multiprocessing.util
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import eitbench
from eitbench.benchmark.workers import confinement as confining
from eitbench.benchmark.workers.audit_hook import code_folder
from eitbench.benchmark.workers.confinement import (
    Confinement,
    _needed,
    check_isolation,
    landlock_abi,
)
from eitbench.benchmark.workers.messages import Reply
from eitbench.benchmark.workers.worker import Worker, serve
from eitbench.scenarios.data.simulation import split_folder
from eitbench.scenarios.errors import InputError

needs_landlock = pytest.mark.skipif(landlock_abi() < 6, reason="needs Linux 6.12 with Landlock")


class Doing:
    """A service that does what it is told."""

    def do(self, action: Callable[..., object], *arguments: object) -> Reply:
        return Reply(action(*arguments), 0.0)


def in_worker(confinement: Confinement, action: Callable[..., Any], *arguments: object) -> Reply:
    with Worker(serve, Doing(), confinement=confinement) as worker:
        return worker.ask("do", action, *arguments, limit=60, what="it")


@pytest.fixture
def confinement(tmp_path: Path) -> Confinement:
    folder = tmp_path / "worker"
    folder.mkdir()
    return Confinement(folder)


def append(path: Path) -> None:
    with path.open("a") as file:
        file.write("x")


def append_from_a_program(path: Path) -> None:
    subprocess.run(["/bin/sh", "-c", 'echo x >> "$0"', str(path)], check=True)


def in_shared_memory() -> None:
    from multiprocessing import Lock

    Lock()


@needs_landlock
@pytest.mark.parametrize(
    "way", [append, append_from_a_program, Path.unlink, Path.rmdir, os.truncate]
)
def test_it_cannot_change_files_of_others(
    way: Callable[..., Any], confinement: Confinement, tmp_path: Path
) -> None:
    results = tmp_path / "rows"
    if way is Path.rmdir:
        results.mkdir()
    else:
        results.write_text("rows")
    more = (0,) if way is os.truncate else ()
    reply = in_worker(confinement, way, results, *more)
    assert reply.failure is not None
    assert results.is_dir() or results.read_text() == "rows"


@pytest.fixture
def test_data() -> Iterator[Path]:
    """A file of the cached test split."""
    (folder := split_folder("test")).mkdir(parents=True, exist_ok=True)
    file = folder / f"test-{os.getpid()}"
    file.write_text("ours")
    yield file
    file.unlink()


@needs_landlock
def test_it_cannot_change_test_data(confinement: Confinement, test_data: Path) -> None:
    """A plugin forged them in the cache, and all methods after it were scored with the forgery."""
    for way in (append, Path.unlink):
        assert in_worker(confinement, way, test_data).failure is not None
    assert test_data.read_text() == "ours"


def test_an_isolated_one_cannot_read_test_data(isolated: Confinement, test_data: Path) -> None:
    assert in_worker(isolated, Path.read_text, test_data).failure is not None


def own_file() -> None:
    with tempfile.NamedTemporaryFile("w") as file:
        file.write("x")


def cache_file() -> None:
    file = split_folder("train") / f"test-{os.getpid()}"
    file.write_text("x")
    file.unlink()


def null() -> None:
    Path(os.devnull).write_text("x")


@pytest.mark.parametrize("way", [own_file, cache_file, null, in_shared_memory])
def test_it_can_write_what_is_its_own(way: Callable[[], object], confinement: Confinement) -> None:
    assert in_worker(confinement, way).failure is None
    assert confinement.watch.noted("write") == []


@needs_landlock
def test_it_cannot_end_or_look_into_the_judge(confinement: Confinement) -> None:
    for action in (lookup, signalled):
        reply = in_worker(confinement, action, os.getpid())
        assert reply.failure is not None
        assert "PermissionError" in reply.failure.kinds


def lookup(pid: int) -> None:
    Path(f"/proc/{pid}/mem").open("rb").close()


def signalled(pid: int) -> None:
    os.kill(pid, 0)


@pytest.fixture
def isolated(tmp_path: Path) -> Confinement:
    try:
        check_isolation()
    except InputError as error:
        pytest.skip(str(error))
    folder, given = tmp_path / "isolated", tmp_path / "given"
    folder.mkdir()
    given.write_text("given")
    return Confinement(folder, (given,))


def listening() -> tuple[socket.socket, int]:
    server = socket.create_server(("127.0.0.1", 0))
    return server, server.getsockname()[1]


def connect(port: int) -> None:
    socket.create_connection(("127.0.0.1", port), 10).close()


def test_an_isolated_one_reads_what_it_is_given_and_has_no_network(
    isolated: Confinement, tmp_path: Path
) -> None:
    secret = tmp_path / "secret"
    secret.write_text("secret")
    server, port = listening()
    with server:
        for action, argument in ((Path.read_text, secret), (connect, port), (append, secret)):
            assert in_worker(isolated, action, argument).failure is not None
    assert in_worker(isolated, Path.read_text, tmp_path / "given").value == "given"
    assert in_worker(isolated, own_file).failure is None


def test_it_cannot_ask_the_server_of_processes_for_a_free_one(
    isolated: Confinement, confinement: Confinement
) -> None:
    """The server takes orders from whoever finds its socket."""
    with Worker(serve, Doing()) as free:  # there is a server by now
        listeners = list(Path(multiprocessing.util.get_temp_dir()).glob("listener-*"))
        assert listeners
        for listener in listeners:
            assert free.ask("do", os.path.exists, listener, limit=60, what="it").value
            for kept in (confinement, isolated):
                assert not in_worker(kept, os.path.exists, listener).value


def test_an_installed_package_gives_away_no_folder_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of `pip install --target ~/libs` it would be the home folder."""
    assert code_folder() == Path(__file__).parents[3]
    monkeypatch.setattr(eitbench, "__path__", [str(tmp_path / "libs" / "eitbench")])
    assert tmp_path / "libs" / "eitbench" in _needed()
    assert not {tmp_path, tmp_path / "libs"} & {*_needed()}


@pytest.mark.skipif(sys.platform != "linux", reason="AppArmor is of Linux: run there")
@pytest.mark.parametrize(("user", "setting"), [(1000, "1"), (1000, "0"), (0, "1")])
def test_namespaces_that_apparmor_keeps_from_users_are_told(
    user: int, setting: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To leave the old ones succeeds there, and what comes next does not."""
    (tmp_path / "restricted").write_text(f"{setting}\n")
    monkeypatch.setattr(confining, "_APPARMOR", tmp_path / "restricted")
    monkeypatch.setattr(confining, "landlock_abi", lambda: 99)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(returncode=0))
    if user and setting == "1":
        with pytest.raises(InputError, match="AppArmor forbids here: run `sudo sysctl -w kernel"):
            check_isolation()
    else:
        check_isolation()
