"""Images of a run for a page: few cases, all methods, one byte a pixel, packed into one text."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.rundir.run_arrays import TRUTH, Scene

MOST_FAMILIES = 6
IMAGES = 1200
"""That a page may hold, 2 kB each; where there would be more, families are left out."""
_OUTSIDE = 255
_BELOW = ("ssim", "cc", "rie", "psnr", "score", "localisation_mm")
"""Figures below an image."""
STEPS, FEW_STEPS = 254, 31
"""Of the scale; of as many images as a page can hold, few steps take a quarter of its bytes."""


def packed_images(
    methods: Mapping[str, tuple[Run, str]],
    scenario: str,
    by: str | None,
    families: int = MOST_FAMILIES,
) -> dict[str, Any] | None:
    """Pack the images of the best, the median and the worst case of each family, by all methods.

    Cases are ordered by the mean, over methods, of the figure `by`. None where nothing ranks the
    samples, or where no image of a case is there.

    Args:
        methods: the run and the name of each method, by its label; the runs are of the same data.
        scenario: its name.
        by: a figure of samples.
        families: number of those that are shown, the first ones. Where some are left out, or one
            alone is more than a page should hold, images have `FEW_STEPS`.

    Returns:
        A row of `names` by `samples` images of `shape` pixels, as bytes whose text is `data` (see
        `pack`): 0 to `steps` are values between `low` and `high` [S/m], 255 is outside the sensor,
        or no image. With `has_truth`, the first name is the truth. `cases` name the sample, its
        family and its kind. `bounds` is (x_min, y_min, x_max, y_max) [m], `background` is in S/m.
        `figures` holds, by method and then for each of `samples`, the status and the metrics of the
        image. `families` is the number of all families.

    Raises:
        DataCorruptError: the images of a run cannot be read.
    """
    first, runs = next(iter(methods.values()))[0], {run for run, _ in methods.values()}
    # A record has images of few samples.
    held = [run.scene(scenario, range(run.n(scenario))).sample for run in runs if not run.whole]
    there = set.intersection(*(set(of.tolist()) for of in held)) if held else None
    table = _shared_rows(methods, scenario, by, there)
    cases = _cases(table, by)
    if not cases:
        return None
    names = list(dict.fromkeys(case["family"] for case in cases))
    cases = _shown(cases, families)
    samples = sorted({case["sample"] for case in cases})
    scene = first.scene(scenario, samples)
    stacks: dict[str, NDArray[np.float64]] = {}
    if scene.truth is not None and not scene.has_classes:
        stacks[TRUTH] = scene.truth
    for label, (run, name) in methods.items():
        estimates = run.estimates(scenario, name, samples)
        if estimates is not None:
            stacks[label] = estimates.astype(np.float64)
    low, high = _limits(stacks, scene)
    values = np.stack(list(stacks.values()))
    steps = STEPS if families >= max(2, len(names)) else FEW_STEPS
    scaled = np.clip(np.round((values - low) / (high - low) * steps), 0, steps)
    known = np.isfinite(values) & scene.mask
    pixels = np.where(known, np.nan_to_num(scaled), _OUTSIDE).astype(np.uint8)
    return {
        "names": list(stacks),
        "has_truth": TRUTH in stacks,
        "samples": samples,
        "cases": cases,
        "families": len(names),
        "steps": steps,
        "shape": list(scene.mask.shape),
        "bounds": list(scene.bounds),
        "background": scene.background,
        "low": low,
        "high": high,
        "data": pack(pixels.tobytes()),
        "figures": _figures(table, samples, by),
    }


def shown_families(columns: int) -> int:
    """Number of families that are shown on a page of so many columns of images."""
    return max(1, min(MOST_FAMILIES, IMAGES // max(1, 3 * columns)))


def shown_samples(run: Run, scenario: str) -> list[int]:
    """Numbers of the samples whose images a page of this run alone shows."""
    families = shown_families(len(run.cells) + len(run.scenarios()))  # with the truth of each
    of = run.samples[run.samples["scenario"] == scenario]
    by = next((name for name in run.kind.ranked_by if name in of and of[name].notna().any()), None)
    methods = {str(name): (run, str(name)) for name in of["method"].unique()}
    cases = _cases(_shared_rows(methods, scenario, by, None), by)
    return sorted({case["sample"] for case in _shown(cases, families)})


def _shared_rows(
    methods: Mapping[str, tuple[Run, str]], scenario: str, by: str | None, there: set[int] | None
) -> pd.DataFrame:
    """The rows of those samples that all methods have, the methods one after the other.

    It has the columns that cases are chosen by, those that stand below images, and the `label`.

    Args:
        methods, scenario, by: see `packed_images`.
        there: numbers of the samples that there are images of; None: all.
    """
    names = dict.fromkeys(("sample", "family", "status", *_BELOW, *([by] if by else ())))
    parts = []
    for run in dict.fromkeys(run for run, _ in methods.values()):
        of = run.samples[run.samples["scenario"] == scenario]
        labels = {name: label for label, (of_run, name) in methods.items() if of_run is run}
        rows = of[[name for name in names if name in of]].assign(label=of["method"].map(labels))
        parts.append(rows[rows["label"].notna()])
    table = pd.concat(parts)
    if there is not None:
        table = table[table["sample"].isin(there)]
    table = table[table.groupby("sample")["label"].transform("count") == len(methods)]
    order = table["label"].map({label: k for k, label in enumerate(methods)})
    return table.iloc[order.to_numpy().argsort(kind="stable")]


def _shown(cases: list[dict[str, Any]], families: int) -> list[dict[str, Any]]:
    """The cases of the first so many families."""
    names = list(dict.fromkeys(case["family"] for case in cases))[:families]
    return [case for case in cases if case["family"] in names]


def pack(content: bytes) -> str:
    """Return `content` compressed (zlib) and as text (base64)."""
    return base64.b64encode(zlib.compress(content)).decode()


def unpacked(images: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the images (names, samples, H, W) [S/m] of `packed_images`, NaN without a value."""
    pixels = np.frombuffer(zlib.decompress(base64.b64decode(images["data"])), dtype=np.uint8)
    shape = (len(images["names"]), len(images["samples"]), *images["shape"])
    values = images["low"] + pixels.reshape(shape) / images["steps"] * (
        images["high"] - images["low"]
    )
    return np.where(pixels.reshape(shape) == _OUTSIDE, np.nan, values)


def _limits(stacks: dict[str, NDArray[np.float64]], scene: Scene) -> tuple[float, float]:
    """Ends of the scale [S/m]: around the truth, or, where there is none, around the background."""
    if TRUTH in stacks:
        low, high = float(stacks[TRUTH].min()), float(stacks[TRUTH].max())
        return max(0.0, low - 0.25 * (high - low)), high + 0.25 * (high - low) + 1e-9
    contrast = np.stack(list(stacks.values()))[..., scene.mask] - scene.background
    # One method that overshoots must not leave the others without colour.
    half = float(np.nanquantile(np.abs(contrast), 0.99)) if np.isfinite(contrast).any() else 0.0
    half = half or 1e-3 * scene.background
    return scene.background - half, scene.background + half


def _cases(table: pd.DataFrame, by: str | None) -> list[dict[str, Any]]:
    """The best, median and worst sample of each family, or of all without families."""
    if by is None or by not in table:
        return []
    mean = table.groupby("sample")[by].mean().dropna()
    better = mean if METRICS[by].best == "max" else -mean
    if "family" in table and table["family"].notna().any():
        family_of = table.drop_duplicates("sample").set_index("sample")["family"]
        families = list(dict.fromkeys(family_of.dropna()))
        groups = {str(name): better[family_of[better.index] == name] for name in families}
    else:
        groups = {"": better}
    orders = {
        family: values.sort_values(ascending=False, kind="stable").index
        for family, values in groups.items()
        if len(values)
    }
    return [
        {"sample": int(order[place]), "family": family, "kind": kind}
        for family, order in orders.items()
        for kind, place in {"best": 0, "median": (len(order) - 1) // 2, "worst": -1}.items()
    ]


def _figures(
    table: pd.DataFrame, samples: Sequence[int], by: str | None
) -> dict[str, list[dict[str, Any]]]:
    """Return the status and metrics of each method's image of each sample, by method."""
    names = [name for name in dict.fromkeys((*_BELOW, *([by] if by else ()))) if name in table]
    figures = {}
    for method, cell in table[table["sample"].isin(samples)].groupby("label", sort=False):
        rows = cell.sort_values("sample")
        columns = {name: numbers(rows, name) for name in names}
        figures[str(method)] = [
            {"status": status}
            | {name: float(f"{v[k]:.4g}") for name, v in columns.items() if np.isfinite(v[k])}
            for k, status in enumerate(rows["status"])
        ]
    return figures
