"""Actions of a process that the audit hook notes, and those that it cannot see."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from eitbench.benchmark.workers.audit_hook import Watch

pytestmark = pytest.mark.slow

# Each program runs in a process of its own, in a folder with `file`, `folder/` and `open`, a
# descriptor of `folder`.
WRITES = {
    "after many long names": """
for k in range(40):
    with contextlib.suppress(OSError):
        open("/" + chr(97 + k % 26) * (100_000 + k))
open("new", "w")
""",
    "open": "open('new', 'w')",
    "append": "open('file', 'ab')",
    "update": "open('file', 'r+')",
    "os.open": "os.open('new', os.O_CREAT | os.O_WRONLY)",
    "pathlib": "pathlib.Path('new').write_text('')",
    "bytes": "open(b'new', 'w')",
    "mkdir": "os.mkdir('new')",
    "remove": "os.remove('file')",
    "remove in a folder": "os.remove('inside', dir_fd=open_)",
    "rmdir": "os.rmdir('folder/empty')",
    "rename": "os.replace('file', 'new')",
    "rename away": "os.replace('file', tempfile.gettempdir() + '/file')",
    "link": "os.link('file', 'new')",
    "symlink": "os.symlink('file', 'new')",
    "truncate": "os.truncate('file', 0)",
    "chmod": "os.chmod('file', 0o600)",
    "touch": "os.utime('file')",
    "rmtree": "shutil.rmtree('folder')",
    "sqlite": "sqlite3.connect('new')",
    "a thread": "t = threading.Thread(target=open, args=('new', 'w')); t.start(); t.join()",
    "a fork": "os.fork() or (open('new', 'w'), os._exit(0)); os.wait()",
    "through a link": "os.symlink(os.getcwd(), tempfile.gettempdir() + '/l');"
    "open(tempfile.gettempdir() + '/l/new', 'w')",
    "upwards": "open(tempfile.gettempdir() + '/../new', 'w')",
}
CALLS = {
    "connect": "socket.create_connection(('127.0.0.1', 9), 0.1)",
    "connect_ex": "socket.socket().connect_ex(('127.0.0.1', 9))",
    "IPv6": "socket.socket(socket.AF_INET6).connect_ex(('::1', 9))",
    "datagram": "socket.socket(type=socket.SOCK_DGRAM).sendto(b'', ('127.0.0.1', 9))",
    "listen": "socket.create_server(('127.0.0.1', 0))",
    "name": "socket.getaddrinfo('localhost', 80)",
    "http": "urllib.request.urlopen('http://127.0.0.1:9', timeout=0.1)",
}
PROGRAMS = {
    "system": "os.system('exit')",
    "subprocess": "subprocess.run(['true'])",
    "spawn": "os.posix_spawn(shutil.which('true'), ['true'], {})",
    "exec": "os.fork() or os.execv(shutil.which('true'), ['true']); os.wait()",
}
INNOCENT = {
    "reading": "open('file').read(); os.listdir('.'); os.stat('file')",
    "null": "open(os.devnull, 'w').write('x')",
    "temporary": "tempfile.NamedTemporaryFile().write(b'x')",
    "temporary folder": "d = tempfile.TemporaryDirectory(); open(d.name + '/x', 'w'); d.cleanup()",
    "cache": "open(split_folder('train') / 'x', 'w')",
    "bytecode": "os.mkdir('__pycache__'); open('__pycache__/x.pyc', 'w')",
    "descriptor": "os.fdopen(os.dup(1), 'w').write('')",
    "memory": "sqlite3.connect(':memory:')",
    "sockets of the machine": "a, b = socket.socketpair(); a.send(b'x'); b.recv(1)",
}
# Not seen: the price of asking Python alone. A test of it, so that the documentation stays true.
UNSEEN = {
    "C": "ctypes.CDLL(None).mkdir(b'new', 0o700)",
    "h5py": "import h5py; h5py.File('new.h5', 'w')",
}
RUN = """
import contextlib, ctypes, os, pathlib, shutil, socket, sqlite3, subprocess, sys, tempfile
import json, threading, urllib.request
import h5py
from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.scenarios.data.simulation import split_folder
for number, code in enumerate(json.loads(sys.argv[1])):
    folder = pathlib.Path(sys.argv[2]) / str(number)
    (folder / "watch").mkdir(parents=True)
    (folder / "work" / "folder" / "empty").mkdir(parents=True)
    for name in ("file", "folder/inside"):
        (folder / "work" / name).write_text("text")
    pid = os.fork()
    if pid == 0:
        os.environ["EITBENCH_CACHE"] = str(folder / "cache")
        split_folder("train").mkdir(parents=True)
        os.chdir(folder / "work")
        open_ = os.open("folder", os.O_RDONLY)
        Watch(folder / "watch").begin()
        with contextlib.suppress(OSError):
            exec(code)
        os._exit(0)
    os.waitpid(pid, 0)
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Watch]:
    if not hasattr(os, "fork"):
        pytest.skip("needs fork: run on Linux or macOS")
    folder = tmp_path_factory.mktemp("watched")
    codes = [*WRITES.values(), *CALLS.values(), *PROGRAMS.values()]
    codes += [*INNOCENT.values(), *UNSEEN.values()]
    subprocess.run([sys.executable, "-c", RUN, json.dumps(codes), str(folder)], check=True)
    return {code: Watch(folder / str(number) / "watch") for number, code in enumerate(codes)}


def kinds(watch: Watch) -> set[str]:
    return {kind for kind in ("write", "network", "program") if watch.noted(kind)}


@pytest.mark.parametrize("what", WRITES)
def test_what_is_written_elsewhere_is_seen(what: str, seen: dict[str, Watch]) -> None:
    watch = seen[WRITES[what]]
    assert kinds(watch) == {"write"}
    work = os.path.realpath(watch.folder.parent / "work")
    above = str(Path(work).parent / "watch")
    noted = watch.noted("write")
    assert all(path.startswith((work, above)) for path in noted), noted
    assert len(noted) == len(set(noted))


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        pytest.param(code, kind, id=what)
        for table, kind in ((CALLS, {"network"}), (PROGRAMS, {"program"}), (INNOCENT, set()))
        for what, code in table.items()
    ],
)
def test_calls_and_programs_are_seen_and_what_is_a_methods_own_is_not(
    code: str, kind: set[str], seen: dict[str, Watch]
) -> None:
    assert kinds(seen[code]) == kind


@pytest.mark.parametrize("what", UNSEEN)
def test_compiled_code_is_not_seen(what: str, seen: dict[str, Watch]) -> None:
    watch = seen[UNSEEN[what]]
    assert kinds(watch) == set()
    assert list((watch.folder.parent / "work").glob("new*"))
