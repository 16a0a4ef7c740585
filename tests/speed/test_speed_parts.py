"""Time of a warm frame by each method, of metrics, parsers, recordings and standings.

`make bench` runs them on one thread and prints the times. SSIM of 600 images at once stands beside
scikit-image called image by image; the aim for standings is 10 s on one core.
"""

from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from skimage import metrics as skimage_metrics

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.metrics.image_metrics import ssim
from eitbench.benchmark.metrics.specs import bounded_score, score
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.hardware.board import Frame
from eitbench.hardware.protocols import PROTOCOLS
from eitbench.hardware.recording.loop import Monitor
from eitbench.hardware.recording.recorder import Recorder
from eitbench.methods import Problem, create, methods
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.recordings.files.recording_file import read_file
from eitbench.scenarios.suites.suite import load_suite, scenarios

METHODS = load_suite("paper").names


@pytest.mark.benchmark(group="one warm frame, foam16 at 50 dB", min_rounds=10)
@pytest.mark.parametrize("name", METHODS)
def test_one_frame(benchmark: BenchmarkFixture, name: str) -> None:
    data = load("paper-50db", limit=1)
    if why := methods()[name].unusable(data.sensor):
        pytest.skip(why)
    parameters = selected_parameters(scenarios()["paper-50db"], name) or {}
    method = create(name, **parameters)
    method.fit(
        Problem(data.sensor, data.references[0], lambda split, n: load("paper-50db", split, n))
    )
    benchmark(method.reconstruct, data.voltages)


@pytest.mark.benchmark(group="dip, foam16 at 50 dB")
@pytest.mark.parametrize("frames", [1, 8])
def test_frames_side_by_side(benchmark: Any, frames: int) -> None:
    """One round: a fit takes seconds."""
    data = load("paper-50db", limit=1)
    method = create("dip")
    method.fit(Problem(data.sensor, data.references[0], partial(load, "paper-50db")))
    benchmark.extra_info["samples"] = frames
    benchmark.pedantic(method.reconstruct, (data.voltages.repeat(frames, axis=0),))


# Without annotations of its own.
structural_similarity: Any = skimage_metrics.structural_similarity
Images = np.ndarray[Any, np.dtype[np.float64]]


@pytest.fixture(scope="module")
def pairs() -> tuple[Images, Images]:
    rng = np.random.default_rng(0)
    truth = np.ones((600, 80, 80))
    truth[:, 20:40, 30:50] = rng.uniform(0.1, 0.9, (600, 1, 1))
    return truth, truth + 0.1 * rng.standard_normal(truth.shape)


@pytest.mark.benchmark(group="ssim of 600 images")
def test_ssim_all_at_once(benchmark: Any, pairs: tuple[Images, Images]) -> None:
    benchmark(lambda: ssim(*pairs, 1.0))


@pytest.mark.benchmark(group="ssim of 600 images")
def test_ssim_image_by_image(benchmark: Any, pairs: tuple[Images, Images]) -> None:
    benchmark(
        lambda: [structural_similarity(t, p, data_range=1.0) for t, p in zip(*pairs, strict=True)]
    )


FRAMES = 100
READ = 4096  # bytes; what a port gives at once


@pytest.mark.benchmark(group="100 frames from bytes, 192 or 208 values each", min_rounds=10)
@pytest.mark.parametrize("name", PROTOCOLS)
def test_frames(benchmark: BenchmarkFixture, name: str) -> None:
    nominal = sensor(PROTOCOLS[name].default_sensor)
    device, parser = PROTOCOLS[name].device(nominal), PROTOCOLS[name](nominal)
    for command in parser.starting():
        device.obey(command)
    values = np.random.default_rng(0).normal(size=(FRAMES, nominal.n_measurements))
    data = b"".join(device.encode(k, k / 10, frame) for k, frame in enumerate(values))
    pieces = [data[at : at + READ] for at in range(0, len(data), READ)]

    def parse() -> int:
        return sum(len(parser.feed(piece, 0.0)) for piece in pieces)

    assert benchmark(parse) == FRAMES
    benchmark.extra_info["samples"] = FRAMES
    if benchmark.stats is not None:
        benchmark.extra_info["frames_per_s"] = FRAMES / benchmark.stats.stats.median


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    draws = np.random.default_rng(0).normal(size=(10_000, 208))
    return [Frame(k, k / 1e4, k / 1e4, values) for k, values in enumerate(draws)]


def write(path: Path, frames: list[Frame]) -> None:
    with Recorder(path, sensor("foam16"), "fake") as recorder:
        for frame in frames:
            recorder.append(frame)


@pytest.mark.benchmark(group="10,000 frames of 208 values")
def test_recording(benchmark: Any, frames: list[Frame], tmp_path: Path) -> None:
    numbers = count()
    benchmark(lambda: write(tmp_path / f"{next(numbers)}.h5", frames))


@pytest.mark.benchmark(group="10,000 frames of 208 values")
def test_reading(benchmark: Any, frames: list[Frame], tmp_path: Path) -> None:
    write(tmp_path / "a.h5", frames)
    content, _ = benchmark(lambda: read_file(tmp_path / "a.h5"))
    assert len(content) == len(frames)


@pytest.mark.benchmark(group="one status line")
def test_status(benchmark: Any, frames: list[Frame]) -> None:
    monitor = Monitor(sensor("foam16"))
    monitor.add(frames[:50])
    benchmark(lambda: monitor.status(0, 0.0).line())


SAMPLES, CONTESTANTS = 6000, 12


@pytest.fixture(scope="module")
def run() -> Run:
    rng = np.random.default_rng(0)
    shared = rng.normal(25, 4, SAMPLES)
    cells = []
    for k in range(CONTESTANTS):
        four = {
            "ssim": rng.uniform(0.8, 0.95, SAMPLES),
            "cc": rng.uniform(0.7, 0.95, SAMPLES),
            "rie": rng.uniform(0.03, 0.1, SAMPLES),
            "psnr": shared + 0.05 * k + rng.normal(size=SAMPLES),
        }
        rest = ("localisation_mm", "contact_count_error", "area_error", "iou")
        cells.append(
            pd.DataFrame(
                {
                    "suite": "bench", "scenario": "one", "method": f"method-{k}", "track": "tuned",
                    "sample": np.arange(SAMPLES), "phantom": np.arange(SAMPLES), "status": "ok",
                    **four, "score": score(**four), "bounded": bounded_score(four),
                    **{name: rng.exponential(size=SAMPLES) for name in rest},
                }
            )
        )  # fmt: skip
    table = pd.concat(cells, ignore_index=True)
    whole = table[["scenario", "method", "track"]].drop_duplicates()
    manifest = {
        "plan": {"suite": {"name": "bench"}, "plugins": []},
        "data": {"one": {"hash": "0", "n": SAMPLES, "inverse_crime": False, "sensor": "foam16"}},
        "cells": [],
        "started": "2026-01-01",
    }
    return Run(Path("bench"), METHOD_RUNS, manifest, table, whole, {})


@pytest.mark.benchmark(group="standings of 12 methods on 6,000 samples")
def test_standings(benchmark: Any, run: Run) -> None:
    benchmark.pedantic(lambda: standings([run]), rounds=3)
