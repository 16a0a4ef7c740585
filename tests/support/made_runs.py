"""A small run directory with every kind of scenario, made without running a method."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import h5py
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.support.contact_images import disc_sensor

from eitbench.benchmark.metrics.evaluation import evaluate, fit_registration
from eitbench.benchmark.submissions.sums import SUMS, note_sums
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.sensors.sensor import Sensor, foam16

Array = NDArray[np.float64]
FOAM = replace(foam16(), image_shape=(40, 40))
DISC = replace(disc_sensor(), image_shape=(40, 40))
FAMILIES = ("circle", "two-circles", "ring")
MAKERS = Callable[[Array], Array]


def _blur(images: Array) -> Array:
    for _ in range(3):
        shifts = ((0, 0), (0, 1), (1, 0), (1, 1))
        images = np.mean([np.roll(images, shift, axis=(1, 2)) for shift in shifts], axis=0)
    return images


# Stand-ins for methods: what they make of the true image.
METHODS: dict[str, MAKERS] = {
    "sharp": lambda truth: 0.95 * (truth - 1) + 1,
    "blurred": lambda truth: _blur(0.6 * (truth - 1)) + 1,
    "constant": np.ones_like,
}


def discs(sensor: Sensor, n: int) -> tuple[Array, Array]:
    """Conductivity (n, H, W) with one disc each, and its places (n, 2) [m]."""
    rng = np.random.default_rng(n)
    x, y = sensor.pixel_centres
    x0, y0, x1, y1 = sensor.outline.bounds
    centre, side = np.array([x0 + x1, y0 + y1]) / 2, x1 - x0
    places = centre + side * rng.uniform(-0.2, 0.2, (n, 2))
    near = np.hypot(x - places[:, 0, None, None], y - places[:, 1, None, None]) < 0.12 * side
    level = np.linspace(0.3, 0.8, n)[:, None, None]
    return np.where(near, level, 1.0), places


def made(
    truth: Literal["conductivity", "position", "classes", "none"],
    n: int,
    scenario: str = "",
    inverse_crime: bool | None = None,
) -> Dataset:
    """A data set with `n` samples of which `truth` is known."""
    sensor = FOAM if truth == "conductivity" else DISC
    images, places = discs(sensor, n)
    samples = pd.DataFrame({"sample": np.arange(n), "phantom": [f"p{k}" for k in range(n)]})
    samples["cluster"] = samples["phantom"]
    if truth == "conductivity":
        samples["family"] = [FAMILIES[k % len(FAMILIES)] for k in range(n)]
        samples["snr_db"] = [np.nan if k % 2 else 50.0 for k in range(n)]
    if truth == "position":
        samples[["x_m", "y_m"]] = 1.1 * places[:, ::-1] + 0.2
        samples["depth_mm"] = np.linspace(20, 10, n)
    samples["touched"] = [not (truth == "none" and k < n // 2) for k in range(n)]
    dataset = Dataset(
        scenario=scenario or f"{truth}-set",
        split="test",
        sensor=sensor,
        voltages=np.zeros((n, 208)),
        references=np.zeros((n, 208)),
        samples=samples,
        truth=truth,
        data_hash="0",
        inverse_crime=inverse_crime,
        classes=np.sign(images - 1).astype(np.int8) if truth == "classes" else None,
    )
    # A cached property lives in the instance; phantoms play no part here.
    dataset.__dict__["conductivity"] = images
    return dataset


def write_manifest(
    run: Path,
    suite: str,
    data: dict[str, Any],
    names: Iterable[str],
    limit: int | None = None,
    skipped: dict[str, str] | None = None,
) -> None:
    """Write what a report reads of a manifest."""
    content = {
        "skipped": skipped or {},
        "cells": [
            {"scenario": scenario, "name": name, "weights": "b10b" if name == "phydnn" else ""}
            for scenario in data
            for name in names
        ],
        "status": "finished",
        "plan": {
            "suite": {"name": suite, "scenarios": []},
            "names": [*names],
            "scenarios": [*data],
            "limit": limit,
            "plugins": [],
        },
        "calibration_ms": 30.0,
        "versions": {"eitbench": None},
        "started": "2026-01-01T00:00:00+00:00",
        "command_line": f"eitbench run {suite}",
        "git_commit": None,
        "machine": {"cpu": "A processor"},
        "data": data,
    }
    (run / "manifest.json").write_text(json.dumps(content))


@contextmanager
def edited_manifest(run: Path) -> Iterator[dict[str, Any]]:
    """The content of a manifest, to be changed."""
    content = json.loads((run / "manifest.json").read_text())
    yield content
    (run / "manifest.json").write_text(json.dumps(content))


def note_version(version: Path) -> None:
    """Note the sums of the records and hidden figures of a version, as they are."""
    (version / SUMS).unlink(missing_ok=True)
    for folder in sorted(path for path in version.iterdir() if path.name != "submissions"):
        if folder.is_dir():
            note_sums(sorted(folder.iterdir()))


def write_operators(run: Path, mse: dict[str, float], suite: str = "operators", n: int = 4) -> Path:
    """Write what a run of operators on the paper's scenario leaves, each with this MSE."""
    run.mkdir()
    samples = [
        pd.DataFrame(
            {
                "suite": suite, "scenario": "paper", "operator": name, "sample": np.arange(n),
                "input_hash": [f"h{k}" for k in range(n)], "status": "ok", "message": "",
                "cluster": [f"p{k}" for k in range(n)],
                "mse": value * np.tile([0.5, 1.5], n // 2),
                "grad_cosine": np.full(n, 0.9),
            }
        )
        for name, value in mse.items()
    ]  # fmt: skip
    cells = [
        {
            "scenario": "paper",
            "operator": name,
            "source": "",
            "grad_ms": 3.0,
            "r": 1 - value,
            "r_low": 1 - 1.01 * value,
            "r_high": 1 - 0.99 * value,
        }
        for name, value in mse.items()
    ]
    data = {"paper": {"hash": "c0ffee", "n": n, "inverse_crime": True, "sensor": "foam16"}}
    write_manifest(run, suite, data, mse)
    pd.concat(samples).to_parquet(run / "samples.parquet")
    pd.DataFrame(cells).to_parquet(run / "operators.parquet")
    return run


@dataclass
class RunBuilder:
    """Collects cells and writes them as the run directory that a finished run leaves."""

    path: Path
    suite: str = "bench"
    samples: list[pd.DataFrame] = field(default_factory=list)
    methods: list[dict[str, Any]] = field(default_factory=list)
    datasets: dict[str, Dataset] = field(default_factory=dict)
    images: dict[tuple[str, str], NDArray[np.float32]] = field(default_factory=dict)
    hash: str = "3f2a1b9c"
    limit: int | None = None
    skipped: dict[str, str] = field(default_factory=dict)

    def add(self, dataset: Dataset, method: str, images: Array, lost: int = 0) -> "RunBuilder":
        """Add a cell; its last `lost` frames timed out."""
        kept = images.astype(np.float32)
        if lost:
            kept[-lost:] = np.nan
        registration = fit_registration(dataset, kept) if dataset.truth == "position" else None
        status = ["ok"] * (len(kept) - lost) + ["timeout"] * lost
        rows = evaluate(dataset, kept, registration).drop(columns="sample")
        keys = {"scenario": dataset.scenario, "method": method, "track": "default"}
        cell = dataset.samples.assign(
            suite=self.suite,
            **keys,
            status=status,
            message="",
            input_hash=[f"frame-{k}" for k in range(len(kept))],
        )
        self.samples.append(pd.concat([cell, rows], axis=1))
        self.methods.append(
            {
                **keys,
                "parameters": "{}",
                "source": "",
                "setup_s": 0.25,
                "train_s": np.nan,
                "frame_ms_p50": 0.5 + len(self.methods),
                "frame_ms_p99": 1.0,
                "coverage": 1 - lost / len(kept),
                "n": len(kept),
            }
        )
        self.datasets[dataset.scenario] = dataset
        self.images[dataset.scenario, method] = kept
        return self

    def add_scaled(
        self,
        dataset: Dataset,
        shares: dict[str, float],
        noise: float = 0.0,
        lost: Mapping[str, int] = MappingProxyType({}),
    ) -> "RunBuilder":
        """Add methods whose images hold these shares of the true contrast, and noise [S/m]."""
        rng, truth = np.random.default_rng(0), dataset.__dict__["conductivity"]
        for name, share in shares.items():
            images = share * (truth - 1) + 1 + noise * rng.standard_normal(truth.shape)
            self.add(dataset, name, images, lost.get(name, 0))
        return self

    def write(self) -> Path:
        """Write the directory."""
        self.path.mkdir(parents=True, exist_ok=True)
        data = {
            name: {
                "hash": self.hash,
                "n": len(d),
                "inverse_crime": d.inverse_crime,
                "sensor": d.sensor.name,
            }
            for name, d in self.datasets.items()
        }
        names = dict.fromkeys(row["method"] for row in self.methods)
        write_manifest(self.path, self.suite, data, names, self.limit, self.skipped)
        pd.concat(self.samples, ignore_index=True).to_parquet(self.path / "samples.parquet")
        pd.DataFrame(self.methods).to_parquet(self.path / "methods.parquet")
        with h5py.File(self.path / "reconstructions.h5", "w") as file:
            for name, dataset in self.datasets.items():
                truth = file.create_group(f"{name}/truth")
                truth.attrs["bounds"] = dataset.sensor.outline.bounds
                truth.attrs["background"] = dataset.sensor.background
                truth.attrs["data_range"] = dataset.sensor.data_range
                truth["mask"] = dataset.sensor.mask
                truth["sample"] = dataset.samples["sample"].to_numpy()
                if dataset.truth == "conductivity":
                    truth["conductivity"] = dataset.conductivity
                if dataset.classes is not None:
                    truth["classes"] = dataset.classes
            for (name, method), images in self.images.items():
                group = file.create_group(f"{name}/{method}")
                group["conductivity"] = images
                group["sample"] = self.datasets[name].samples["sample"].to_numpy()
        return self.path


@pytest.fixture
def build(tmp_path: Path) -> RunBuilder:
    return RunBuilder(tmp_path / "run")


@pytest.fixture(scope="session")
def full_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All four kinds of truth; "sharp" lost two frames of the simulated scenario."""
    builder = RunBuilder(tmp_path_factory.mktemp("runs") / "full")
    noise = np.random.default_rng(0).standard_normal((8, 40, 40))
    for truth in ("conductivity", "position", "classes", "none"):
        dataset = made(truth, 8)
        base = dataset.__dict__["conductivity"]
        if truth == "none":
            base = np.where(dataset.samples["touched"].to_numpy()[:, None, None], base, 1.0)
        for name, method in METHODS.items():
            images = method(base)
            if name == "blurred":
                images = images + 0.005 * noise
            lost = 2 if (truth, name) == ("conductivity", "sharp") else 0
            builder.add(dataset, name, images, lost)
    return builder.write()


@pytest.fixture
def paper() -> Dataset:
    return made("conductivity", 8, scenario="paper", inverse_crime=True)


@pytest.fixture
def build_operators(tmp_path: Path) -> Callable[..., Path]:
    return lambda mse, **kind: write_operators(tmp_path / "operators-run", mse, **kind)


@pytest.fixture(scope="session")
def run_builder() -> type[RunBuilder]:
    return RunBuilder


@pytest.fixture(scope="session")
def dataset_of() -> Callable[..., Dataset]:
    return made
