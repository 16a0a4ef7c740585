"""`eitbench live`: what it refuses, and that it begins and ends well with an emulated board."""

import os
import signal
import socket
import threading
import time
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--host", "0.0.0.0"], "give them a --token, too"),
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


def test_it_prints_its_address_serves_and_ends_with_ctrl_c(eitbench: Any, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    seen: list[int] = []

    def look_and_press_ctrl_c() -> None:
        end = time.monotonic() + 60
        try:
            while not seen and time.monotonic() < end:
                with (
                    suppress(OSError),
                    urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as answer,
                ):
                    seen.append(answer.status)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    visitor = threading.Thread(target=look_and_press_ctrl_c)
    visitor.start()
    out = tmp_path / "new" / "folder"
    code, said, _ = eitbench("live", "--board", "emulator", "--http-port", port, "--out", out)
    visitor.join()
    assert (code, seen) == (0, [200])
    assert said.startswith(f"emulator (emulated): http://127.0.0.1:{port}/")
    assert out.is_dir()
