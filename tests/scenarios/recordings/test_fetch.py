"""Finding, downloading and verifying recorded sets, against a server of our own."""

import functools
import hashlib
import http.server
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError
from eitbench.scenarios.recordings import RECORDED_SETS, fetch
from eitbench.scenarios.recordings.descriptors import (
    RecordedFile,
    RecordedFrames,
    RecordedSet,
    Source,
)
from eitbench.scenarios.recordings.fetch import (
    altered,
    cached_folder,
    fetch_recording,
    read_recording,
)
from eitbench.scenarios.sensors.sensor import Sensor

REPOSITORY = "owner/skin"
CONTENT = {"a b.txt": b"1" * 50_000, "sub/c(1).txt": b"2" * 10}


def read_ones(folder: Path, sensor: Sensor) -> RecordedFrames:
    n = len((folder / "sub/c(1).txt").read_bytes())
    values = np.full((n, sensor.n_measurements), 3.0)
    samples = pd.DataFrame({"split": ["test"] * n, "touched": True})
    return RecordedFrames(values, values[0], samples)


def make_set(content: dict[str, bytes]) -> RecordedSet:
    files = tuple(
        RecordedFile(path, len(data), hashlib.sha256(data).hexdigest())
        for path, data in content.items()
    )
    real = RECORDED_SETS["ohmc8"]
    source = Source(REPOSITORY, "0" * 40, "none", files)
    return RecordedSet("skin", "t", "ohmc8", real.sensor, "none", source, "c", read_ones)


def lay_out(folder: Path, content: dict[str, bytes]) -> Path:
    for path, data in content.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return folder


@pytest.fixture
def skin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RecordedSet:
    """A recorded set of two small files, of which nothing is on this machine yet."""
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("EITBENCH_DATA", raising=False)
    recorded = make_set(CONTENT)
    monkeypatch.setitem(RECORDED_SETS, "skin", recorded)
    return recorded


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that a local server publishes in place of the public source."""
    root = lay_out(tmp_path / "served" / REPOSITORY / ("0" * 40), CONTENT)
    with serving(functools.partial(QuietHandler, directory=str(tmp_path / "served"))) as port:
        redirect(monkeypatch, port)
        yield root


@contextmanager
def serving(handler: Callable[..., http.server.BaseHTTPRequestHandler]) -> Iterator[int]:
    """Answer at a local port, which is yielded."""
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


def redirect(monkeypatch: pytest.MonkeyPatch, port: int) -> None:
    """Make every source answer at a local port, at the path it has in public."""
    public = Source.url
    monkeypatch.setattr(
        Source,
        "url",
        lambda self, file: public(self, file).replace(
            "https://raw.githubusercontent.com", f"http://127.0.0.1:{port}"
        ),
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def left_in_cache(recorded: RecordedSet) -> set[str]:
    folder = cached_folder(recorded)
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_paths_are_quoted_in_the_address(skin: RecordedSet) -> None:
    assert skin.source.url(skin.files[0]) == (
        f"https://raw.githubusercontent.com/owner/skin/{'0' * 40}/a%20b.txt"
    )


@pytest.mark.usefixtures("served")
def test_a_missing_set_is_downloaded_verified_and_read_and_is_there_the_second_time(
    skin: RecordedSet, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fetch_recording(skin, progress=True) == cached_folder(skin)
    assert left_in_cache(skin) == set(CONTENT)
    # Without a terminal there is no bar, and no empty line of one.
    assert capsys.readouterr().err == ""
    redirect(monkeypatch, free_port())
    assert read_recording("skin").voltages.shape == (10, 32)


def test_the_named_folder_comes_first(
    skin: RecordedSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay_out(cached_folder(skin), CONTENT)
    mine = lay_out(tmp_path / "mine" / REPOSITORY, CONTENT)
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "mine"))
    assert fetch_recording(skin) == mine
    (mine / "a b.txt").unlink()
    assert fetch_recording(skin) == cached_folder(skin)


def test_altered_data_is_refused_and_named(
    skin: RecordedSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = CONTENT | {"sub/c(1).txt": b"2" * 9 + b"3"}
    folder = lay_out(tmp_path / "mine" / REPOSITORY, changed)
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "mine"))
    with pytest.raises(DataCorruptError, match=r"c\(1\)\.txt.*recordings fetch skin"):
        read_recording("skin")
    assert not cached_folder(skin).exists()
    lay_out(folder, CONTENT)
    assert len(read_recording("skin").samples) == 10


@pytest.mark.usefixtures("served")
def test_the_cache_is_repaired(skin: RecordedSet) -> None:
    folder = lay_out(cached_folder(skin), CONTENT | {"a b.txt": b"truncated"})
    assert [file.path for file in altered(skin, folder)] == ["a b.txt"]
    assert len(read_recording("skin").samples) == 10
    assert altered(skin, folder) == []


def test_a_source_that_offers_other_bytes_is_refused(skin: RecordedSet, served: Path) -> None:
    (served / "a b.txt").write_bytes(b"0" * 50_000)
    with pytest.raises(DataCorruptError, match=r"a b\.txt"):
        fetch_recording(skin)
    assert left_in_cache(skin) == set()


def test_without_a_network_the_sentence_says_how_to_get_it(
    skin: RecordedSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    redirect(monkeypatch, free_port())
    with pytest.raises(DataUnavailableError) as refused:
        read_recording("skin")
    sentence = str(refused.value)
    assert "eitbench recordings fetch skin" in sentence
    assert "EITBENCH_DATA" in sentence
    assert "\n" not in sentence
    assert left_in_cache(skin) == set()


def test_a_file_that_is_gone_says_so(skin: RecordedSet, served: Path) -> None:
    (served / "a b.txt").unlink()
    with pytest.raises(DataUnavailableError, match="404"):
        fetch_recording(skin)


def test_a_hanging_server_is_cut_off(skin: RecordedSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that accepts and then says nothing; without the cut the test would never end."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        redirect(monkeypatch, silent.getsockname()[1])
        with pytest.raises(DataUnavailableError, match=r"longer than 0\.2 s"):
            fetch_recording(skin, limit_s=0.2)


def test_a_trickling_server_is_stopped(skin: RecordedSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes after the limit end the download instead of filling the cache."""
    proceed, stopped = threading.Event(), threading.Event()

    class Trickle(QuietHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "50000")
            self.end_headers()
            proceed.wait(60)
            try:
                for _ in range(50_000):
                    self.wfile.write(b"1")
            except OSError:
                stopped.set()

    with serving(Trickle) as port:
        redirect(monkeypatch, port)
        with pytest.raises(DataUnavailableError, match="longer"):
            fetch_recording(skin, limit_s=0.2)
        worker = next(t for t in threading.enumerate() if t.name == "fetch skin")
        proceed.set()
        worker.join(60)
        assert not worker.is_alive()
        assert left_in_cache(skin) == set()


def test_a_fetch_ends_though_the_server_goes_on_for_ever(
    skin: RecordedSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No silence is long, yet the last byte never comes."""
    monkeypatch.setattr(fetch, "SPARE_S", 0.2)
    monkeypatch.setattr(fetch, "LEAST_RATE", float("inf"))
    given_up = threading.Event()

    class Trickle(QuietHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "50000")
            self.end_headers()
            while not given_up.wait(0.05):
                self.wfile.write(b"1")

    with serving(Trickle) as port:
        redirect(monkeypatch, port)
        outcome: list[BaseException] = []

        def run() -> None:
            try:
                fetch_recording(skin)
            except DataUnavailableError as error:
                outcome.append(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        thread.join(10)
        given_up.set()
        assert "took longer than 0.2 s" in str(outcome)


@pytest.mark.usefixtures("served")
def test_a_cache_that_is_a_file_says_so(skin: RecordedSet, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    with pytest.raises(DataUnavailableError, match="could not be stored"):
        fetch_recording(skin)


@pytest.mark.parametrize("path", ["../outside.txt", "/etc/hostname", "link"])
def test_paths_and_links_out_of_the_folder_are_refused(path: str, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("/etc/hostname")
    with pytest.raises(DataCorruptError, match="leads out"):
        altered(make_set({path: b"x"}), tmp_path)


CHILD = """
import sys
from pathlib import Path
from eitbench.scenarios.recordings.descriptors import Source
sys.path.insert(0, sys.argv[1])
import test_fetch as shared
public = Source.url
Source.url = lambda self, file: public(self, file).replace(
    "https://raw.githubusercontent.com", "http://127.0.0.1:" + sys.argv[2])
recorded = shared.make_set(shared.CONTENT)
assert shared.altered(recorded, shared.fetch_recording(recorded)) == []
"""


@pytest.mark.slow
def test_several_processes_at_once_leave_no_broken_file(
    skin: RecordedSet, served: Path, tmp_path: Path
) -> None:
    """Two processes meet at a server that answers none before both have asked."""
    together = threading.Barrier(2, timeout=60)

    class Gathering(QuietHandler):
        def do_GET(self) -> None:
            if "a%20b" in self.path:
                together.wait()
            super().do_GET()

    handler = functools.partial(Gathering, directory=str(tmp_path / "served"))
    with serving(handler) as port:
        command = [sys.executable, "-c", CHILD, str(Path(__file__).parent), str(port)]
        children = [subprocess.Popen(command) for _ in range(2)]
        assert [child.wait(120) for child in children] == [0, 0]
    assert altered(skin, cached_folder(skin)) == []
    assert left_in_cache(skin) == set(CONTENT)
    assert served.is_dir()


def test_a_download_without_end_is_stopped(
    skin: RecordedSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server that sends more than was published is not listened to until the disk is full."""
    sent = []

    class Endless(QuietHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            try:
                for _ in range(4000):
                    self.wfile.write(bytes(2**16))
                    sent.append(2**16)
            except OSError:
                pass

    with serving(Endless) as port:
        redirect(monkeypatch, port)
        with pytest.raises(DataCorruptError, match="longer"):
            fetch_recording(skin)
    assert sum(sent) < 50_000_000  # what the connection holds, not the 260 MB that were offered
    assert left_in_cache(skin) == set()


def without_mark(content: bytes) -> bytes:
    return content.removeprefix(b"\xef\xbb\xbf")


def without_a_column(content: bytes) -> bytes:
    return b"\n".join(line.rpartition(b",")[0] for line in content.split(b"\n"))


def with_an_empty_row(content: bytes) -> bytes:
    first, rest = content.split(b"\n", 1)
    return b",".join([b"NaN"] * (first.count(b",") + 1)) + b"\n" + rest


def in_millimetres(content: bytes) -> bytes:
    rows = np.loadtxt(without_mark(content).decode().splitlines(), delimiter=",")
    return "\n".join(",".join(map(str, row)) for row in 1e3 * rows).encode()


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


@pytest.mark.parametrize(
    ("name", "file", "spoil"),
    [
        *(("cam09-06", "inp", of) for of in (without_mark, without_a_column, with_an_empty_row)),
        *(("cam09-06", "out", of) for of in (in_millimetres, cut)),
        ("ohmc16", "ohmc16", cut),
    ],
)
def test_a_spoilt_public_file_is_not_read_and_is_left_there(
    recorded_data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    file: str,
    spoil: Callable[[bytes], bytes],
) -> None:
    recorded = RECORDED_SETS[name]
    for of in recorded.files:
        content = (recorded_data / recorded.repository / of.path).read_bytes()
        copy = tmp_path / recorded.repository / of.path
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(spoil(content) if copy.name.startswith(file) else content)
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path))
    spoilt = next(p for p in tmp_path.rglob(f"{file}*"))
    before = spoilt.read_bytes()
    with pytest.raises(DataCorruptError) as failure:
        read_recording(name)
    said = str(failure.value)
    assert f"{spoilt} is not the file that was published (its SHA-256 differs): " in said
    assert said.endswith(f"run `eitbench recordings fetch {name}`.")
    assert spoilt.read_bytes() == before
