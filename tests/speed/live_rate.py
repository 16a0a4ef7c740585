"""Frames per second from an emulated board to the painted canvas, on one core or on all.

    python tests/speed/live_rate.py one
    python tests/speed/live_rate.py all

With `one` the emulated board, its serial line, the reconstruction, the server and headless Chromium
are pinned to the first core that this process may use; with `all` nothing is pinned, as for anybody
who starts the live view. The rate is what the page itself counts; `cores` is how many cores all of
it takes, which tells a busy machine from a slow program.
"""

import os
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import mean

if sys.argv[1:] not in (["one"], ["all"]):
    sys.exit("Say on how many cores: one, or all.")
if sys.argv[1] == "one":
    # Before numpy is loaded; threads and processes started from here stay on the core, too.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import psutil
from playwright.sync_api import Page, sync_playwright

from eitbench.hardware.live.run import live_view
from eitbench.hardware.live.server import Access
from eitbench.hardware.registry import make_emulator

# The emulated sensor's own physics takes 20 ms of the core for each frame; a real board takes none.
CASES = (("noser", 40.0), ("noser", 10.0), ("dnn", 15.0), ("tv", 12.0), ("tv", 10.0))
WARM_MS, SECONDS = 6000, 10


def main() -> None:
    """Print a row for each method and rate of the board."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("Chromium is not installed.")
    print(f"{'method':8} {'board':>8} {'sends':>8} {'painted':>8} {'latency':>8} {'cores':>6}")
    with sync_playwright() as started, tempfile.TemporaryDirectory() as folder:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for method, rate_hz in CASES:
            sends, painted, latency, cores = _measured(
                browser.new_page(), method, rate_hz, Path(folder)
            )
            print(
                f"{method:8} {rate_hz:6.0f}/s {sends:6.1f}/s {painted:6.1f}/s {latency:5.0f} ms "
                f"{cores:6.2f}",
                flush=True,
            )
        browser.close()


def _measured(page: Page, method: str, rate_hz: float, folder: Path) -> tuple[float, ...]:
    """Frames that the board sends and that are painted [1/s], latency [ms], cores in use."""
    board = make_emulator(None, "teensy", None, rate_hz / 10)
    with live_view(board, "emulator", method, access=Access(), port=0, out=folder) as view:
        server = threading.Thread(target=view.serve)
        server.start()
        page.goto(view.address)
        page.wait_for_timeout(WARM_MS)
        board.press(0.03, 0.06, 0.008, 20e3)
        page.wait_for_timeout(WARM_MS / 2)
        rows: list[list[float]] = []
        began, before_s = time.perf_counter(), _processor_s()
        for _ in range(SECONDS):
            page.wait_for_timeout(1000)
            rows.append(
                page.evaluate(
                    "['rate', 'painted', 'latency']"
                    ".map((id) => Number(document.getElementById(id).textContent))"
                )
            )
        cores = (_processor_s() - before_s) / (time.perf_counter() - began)
        page.close()
        view.server.should_exit = True
        server.join()
    return *(mean(column) for column in zip(*rows, strict=True)), cores


def _processor_s() -> float:
    """Processor time [s] of this process and all that it started."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(times.user + times.system for times in (p.cpu_times() for p in processes))


if __name__ == "__main__":
    main()
