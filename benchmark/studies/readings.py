"""Readings of the published NOSER and TV rows: what their figures would be after one mistake.

The published rows are worse than the constant image 0. Each reading makes one simple change to how
frames are read (order of electrodes, sign, drive pattern) or images are scored (axes, background,
sign, scale), and scores the images of our own method so. A row that is reproduced is consistent
with that reading, which proves nothing; a figure that no reading reproduces stays unexplained.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from scipy.optimize import brentq

from eitbench.benchmark.metrics.image_metrics import image_figures
from eitbench.benchmark.rundir.manifest import now
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.methods.problem import no_split
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.interrupts import worker_pool
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.storage.atomic_write import atomic_write_json
from eitbench.scenarios.suites.suite import load_suite

FILE_NAME = "readings.json"

AXES: Mapping[str, Callable[[Array], Array]] = {
    "as they are": lambda images: images,
    "exchanged": lambda images: images.swapaxes(1, 2),
    "rows reversed": lambda images: images[:, ::-1],
    "columns reversed": lambda images: images[:, :, ::-1],
    "turned by 90 degrees": lambda images: np.rot90(images, 1, (1, 2)),
    "turned by 180 degrees": lambda images: images[:, ::-1, ::-1],
    "turned by 270 degrees": lambda images: np.rot90(images, 3, (1, 2)),
    "exchanged and turned by 180 degrees": lambda images: images.swapaxes(1, 2)[:, ::-1, ::-1],
}
"""The eight ways to lay the axes of a square image (n, H, W)."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames as a method is given them.

    Attributes:
        name: of the mistake in them.
        sensor: that the method takes them to be from.
        voltages, reference: (n, M) and (M,) [V/A].
    """

    name: str
    sensor: Sensor
    voltages: Array
    reference: Array


def wrong_frames(data: Dataset, images: Array) -> Iterator[Frames]:
    """Yield the frames of `data` as they are, then with one mistake each.

    Args:
        data: noise-free frames of an offset-3 pattern.
        images: (n, H, W) the conductivity that they come from [S/m].
    """
    sensor, count = data.sensor, data.sensor.n_electrodes

    reference = data.references[0]
    yield Frames("as they are", sensor, data.voltages, reference)
    electrodes = np.arange(count)
    for name, taken_for in (
        ("first electrode off by 1", (electrodes + 1) % count),
        ("first electrode off by 2", (electrodes + 2) % count),
        ("electrodes numbered the other way", -electrodes % count),
    ):
        rows = renumbered(sensor.pattern.table, taken_for)
        yield Frames(name, sensor, data.voltages[:, rows], reference[rows])
    # The frame alone: with the reference reversed as well, a method's gain would undo it.
    yield Frames("sign of the change reversed", sensor, 2 * reference - data.voltages, reference)
    other = replace(sensor, pattern=offset_pattern(count, 4))
    model = forward_model(other)
    offset4 = model.voltages(images), model.voltages(model.background)
    yield Frames("offset 4, taken for offset 3", sensor, *offset4)
    yield Frames("offset 4, known as such", other, *offset4)


def renumbered(table: Index, taken_for: Index) -> Index:
    """Return the measurement (M,) that a board takes for each one of the pattern `table` (M, 4).

    Its electrode e is wired to electrode `taken_for[e]`. Where that turns a pair of an offset
    pattern round, it turns the drive and the sense pair alike, so that the sign is kept.
    """
    index = {tuple(row): k for k, row in enumerate(table.tolist())}
    found = []
    for source, sink, a, b in taken_for[table].tolist():
        straight, turned = (source, sink, a, b), (sink, source, b, a)
        found.append(index[straight] if straight in index else index[turned])
    return np.array(found)


def scaled_to(rie: float, residual: Array, change: Array, truth: Array) -> float | None:
    """Find the factor c > 0 for which the mean of ||residual - c change|| / ||truth|| is `rie`.

    The mean is convex in c, so that there is one such c where it is below `rie` at c = 0; None
    where it is not, or where nothing changes.

    Args:
        rie: relative image error.
        residual, change, truth: (n, P) images [S/m].
    """
    rr, rc, cc, tt = (
        np.einsum("ij,ij->i", a, b)
        for a, b in ((residual, residual), (residual, change), (change, change), (truth, truth))
    )

    def excess(c: float) -> float:
        return float(np.sqrt(np.maximum(rr - 2 * c * rc + c * c * cc, 0) / tt).mean()) - rie

    if excess(0.0) >= 0 or not (cc > 0).any():
        return None
    high = 1.0
    while excess(high) < 0:
        high *= 2
    return float(brentq(excess, 0.0, high))


def read_images(
    truth: Array, estimate: Array, background: float, data_range: float, rie: float
) -> Iterator[dict[str, object]]:
    """Yield how images score with and without their background, as strong as they are or as `rie`.

    Args:
        truth, estimate: (n, H, W) [S/m], of a sensor that fills its image.
        background, data_range: of the sensor [S/m].
        rie: published relative image error, to which the strength is fitted.
    """
    flat = (len(truth), -1)
    for base in (background, 0.0):
        for sign in (1, -1):
            change = sign * (estimate - background)
            factor = scaled_to(
                rie, (truth - base).reshape(flat), change.reshape(flat), truth.reshape(flat)
            )
            for strength in (1.0,) if factor is None else (1.0, factor):
                figures = image_figures(truth, base + strength * change, data_range)
                yield {
                    "background": bool(base),
                    "sign": sign,
                    "strength": strength,
                    **{name: float(values.mean()) for name, values in figures.items()},
                }


def published_readings(
    rows: Mapping[str, Mapping[str, float]], *, samples: int, jobs: int = 1
) -> pd.DataFrame:
    """Score every reading of the images of classical methods on the scenario "paper".

    Frames are read with every mistake of `wrong_frames`, and images of correct frames with all
    `AXES`. Hyper-parameters are those that the benchmark ranks the method with.

    Returns:
        One row per method and reading: `method`, `frames`, `axes`, `background` (False where it is
        left out), `sign` and `strength` of the contrast, `ssim`, `cc`, `rie`, `psnr` [dB].

    Args:
        rows: published figures by method; their `rie` is what a strength is fitted to.
        samples: test samples that are read.
        jobs: processes.
    """
    (scenario,) = (s for s in load_suite("paper").scenarios if s.name == "paper")
    data = load(scenario, "test", samples)
    truth = data.conductivity
    assert truth is not None
    parts = worker_pool(jobs)(
        joblib.delayed(_read)(
            method, selected_parameters(scenario, method) or {}, frames, truth, rows[method]["rie"]
        )
        for frames in wrong_frames(data, truth)
        for method in rows
    )
    return pd.DataFrame([row for part in parts for row in part])


def _read(
    method: str, parameters: Mapping[str, object], frames: Frames, truth: Array, rie: float
) -> list[dict[str, object]]:
    reconstruction = create(method, **parameters)
    reconstruction.fit(Problem(frames.sensor, frames.reference, no_split))
    images = reconstruction.reconstruct(frames.voltages).astype(np.float64)
    background, data_range = frames.sensor.background, frames.sensor.data_range
    return [
        {"method": method, "frames": frames.name, "axes": axes, **row}
        for axes, lay in AXES.items()
        if axes == "as they are" or frames.name == "as they are"
        for row in read_images(truth, lay(images), background, data_range, rie)
    ]


def write_readings(table: pd.DataFrame, samples: int, folder: Path) -> Path:
    """Write the readings as `readings.json` into `folder`."""
    content = {"written": now(), "samples": samples, "rows": table.to_dict("records")}
    path = folder / FILE_NAME
    atomic_write_json(path, content)
    return path
