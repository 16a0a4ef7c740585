"""`eitbench live`: what it refuses, and that it begins and ends well with an emulated board."""

import os
import re
import signal
import socket
import threading
import time
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from tests.support.choices import made_choice
from websockets.sync.client import connect
from websockets.typing import Origin

from eitbench.hardware import registry
from eitbench.hardware.live import run
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.files.recording_file import read_file

PLUGIN = """
from eitbench.methods import Method, register
@register("mine")
class Mine(Method):
    def fit(self, problem):
        pass
    def reconstruct(self, voltages):
        pass
"""


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--host", "0.0.0.0"], "EITBENCH_TOKEN, or in a file that you name with --token-file"),
        (["--token", "correct-horse-battery"], "No such option"),
        (["--token-file", __file__], "let them connect with --host"),
        (["--token-file", __file__, "--host", "::1"], "16 to 128 letters"),
        (["--method", "nose"], "did you mean 'noser'"),
        (["--method", "linear-touch"], "learns from simulated touches before its first image"),
        (["--out", "/dev/null/here"], "--out"),
    ],
)
def test_what_cannot_be_is_one_sentence(eitbench: Any, options: list[str], sentence: str) -> None:
    code, _, err = eitbench("live", "--board", "emulator", "--http-port", "0", *options)
    assert code == 2
    assert sentence in err
    assert err.count("\n") == 1


def test_a_plugin_makes_the_images_at_first(
    eitbench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, board: Any
) -> None:
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
    monkeypatch.setattr(registry, "make_board", lambda name, **options: board)
    shown: list[str] = []

    def view(board: Any, name: str, method: str, **_: Any) -> Any:
        shown.append(method)
        raise InputError("That is enough.")

    monkeypatch.setattr(run, "live_view", view)
    plugin = tmp_path / "mine.py"
    plugin.write_text(PLUGIN)
    for options, method in (((), "mine"), (("--method", "tikhonov"), "tikhonov")):
        code, _, err = eitbench("live", "--board", "emulator", "--plugin", plugin, *options)
        assert (code, err) == (2, "eitbench: That is enough.\n")
        assert shown.pop() == method
    plugin.write_text("import nowhere\n")
    code, _, err = eitbench("live", "--board", "emulator", "--plugin", plugin)
    assert code == 2
    assert 'File "mine.py", line 1, in <module>' in err


def test_a_choice_gives_the_method_and_its_parameters(
    eitbench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, board: Any
) -> None:
    monkeypatch.setattr(registry, "make_board", lambda name, **options: board)
    shown: list[Any] = []

    def view(board: Any, name: str, method: str, **options: Any) -> Any:
        shown.extend((method, options["parameters"]))
        raise InputError("That is enough.")

    monkeypatch.setattr(run, "live_view", view)
    path = tmp_path / "choice.json"
    path.write_text(made_choice().model_dump_json())
    begin = ("live", "--board", "emulator", "--choice", path)
    assert eitbench(*begin) == (2, "", "eitbench: That is enough.\n")
    assert shown == ["noser", {"noser": {"weight": 0.5}, "greit": {}}]
    code, _, err = eitbench(*begin, "--method", "greit")
    assert (code, err.count("\n")) == (2, 1)
    assert "--choice names the method: leave out --method" in err
    path.write_text(made_choice(sensor_sha256="0" * 64).model_dump_json())
    code, _, err = eitbench(*begin)
    assert (code, err.count("\n")) == (2, 1)
    assert "was made for the sensor of 'foam16', which is not the board's" in err


ENDS = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]


@pytest.mark.parametrize("end", [end for end in ENDS if end])
def test_it_prints_its_address_serves_and_ends_with_a_signal(
    eitbench: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    end: signal.Signals,
    board: Any,
) -> None:
    """The recording under way is sealed, and the board stopped."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    calls: list[str] = []
    monkeypatch.setattr(registry, "make_board", lambda name, **options: board)
    monkeypatch.setattr(board, "stop", lambda: calls.append("stop"))
    monkeypatch.setattr(board, "close", lambda: calls.append("close"))
    seen: list[int] = []

    def visit() -> None:
        deadline = time.monotonic() + 60
        try:
            while not seen and time.monotonic() < deadline:
                with (
                    suppress(OSError),
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as answer,
                ):
                    seen.append(answer.status)
            page = f"127.0.0.1:{port}"
            with connect(f"ws://{page}/ws", origin=Origin(f"http://{page}")) as visitor:
                visitor.send('{"do": "record", "on": true}')
                while not re.search(r'"frames": [1-9]', str(visitor.recv(timeout=20))):
                    pass
                os.kill(os.getpid(), end)
        except BaseException:
            os.kill(os.getpid(), signal.SIGINT)
            raise

    visitor = threading.Thread(target=visit)
    visitor.start()
    out = tmp_path / "new" / "folder"
    code, said, err = eitbench("live", "--board", "emulator", "--http-port", port, "--out", out)
    visitor.join()
    assert (code, seen, err) == (0, [200], "")
    assert said.startswith(f"emulator (emulated): http://127.0.0.1:{port}/")
    (recording,) = out.glob("*.h5")
    assert read_file(recording)[1].sealed
    assert calls == ["stop", "close"]
