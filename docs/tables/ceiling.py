"""Tables of the ceiling, from the record that comes with eitbench."""

from typing import Any

import numpy as np
import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.ceiling.agreement import AGREED
from eitbench.benchmark.ceiling.drawing import kept, known_of, told
from eitbench.benchmark.ceiling.figures import summary
from eitbench.benchmark.ceiling.record import decibels, recorded_frames, traces_held
from eitbench.benchmark.metrics.statistics import bootstrap
from eitbench.scenarios.suites.scenario import TOUCHES
from eitbench.scenarios.suites.suite import load_suite

_SENSOR_OFFSET = 3
"""Of the drive pattern of `foam16`."""
_COLUMNS = {
    "n": ("frames", "d"), "psnr_of_mse": ("PSNR of the mean error [dB]", ".2f"),
    "low": ("95 %: from", ".2f"), "high": ("to", ".2f"),
    "psnr": ("mean PSNR [dB]", ".2f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
    "rie": ("RIE", ".4f"), "localisation_mm": ("place [mm]", ".2f"),
}  # fmt: skip
_CHECKS = {
    "expected_psnr": ("the posterior's own [dB]", ".2f"),
    "image_psnr": ("the mean image's [dB]", ".2f"),
    "apart_db": ("samplers apart [dB]", "+.2f"), "apart_low": ("95 %: from", "+.2f"),
    "apart_high": ("to", "+.2f"), "agreed": (f"R-hat < {AGREED}", ".0%"),
    "agreed_psnr": ("of these [dB]", ".2f"), "exact": ("exact weights", ".1%"),
    "exact_psnr": ("of these [dB]", ".2f"), "worst": ("worst frame", ".0%"),
    "within_50": ("in 50 %", ".0%"), "within_80": ("in 80 %", ".0%"),
    "within_95": ("in 95 %", ".0%"), "uniform_p": ("p of ranks", ".2g"),
    "width_p": ("p of widths", ".2g"),
}  # fmt: skip


def frames(suite: str = "noise") -> pd.DataFrame:
    """Return the recorded frames of a suite, scenario after scenario; clean ones at 70 dB."""
    known, _ = known_of(load_suite(suite).scenarios)
    return pd.concat([recorded_frames(of.name, of.data_hash("test")) for of in map(told, known)])


def _figures(suite: str, columns: dict[str, tuple[str, str]]) -> str:
    rows = [
        [_level(suite, row), *(f"{row[name]:{form}}" for name, (_, form) in columns.items())]
        for row in summary(frames(suite)).to_dict("records")
    ]
    return printed(["", *(head for head, _ in columns.values())], rows)


def _level(suite: str, row: dict[str, Any]) -> str:
    """What tells the scenarios of a suite apart: the noise, and on rungs their name."""
    level = f"{row['snr_db']:g} dB"
    return f"{_rung(str(row['scenario']))}, {level}" if suite == "sim2real" else level


def _rung(scenario: str) -> str:
    """The name of a rung of `sim2real`."""
    return scenario.removeprefix("sim2real-").split("-at-")[0]


def _below(suite: str) -> str:
    stored = pd.read_csv(STUDIES / "ceiling" / "below.csv")
    declared = [scenario.name for scenario in load_suite(suite).scenarios]
    stored = stored[stored["scenario"].isin(declared)]
    scenarios = stored["scenario"].unique()
    distance = "{below_db:.1f} ({low:z.1f} to {high:.1f})"
    cells = {
        (row["method"], row["scenario"]): distance.format(**row)
        for row in stored.to_dict("records")
    }
    first = stored[stored["scenario"] == scenarios[-1]].sort_values("below_db")
    counts = first.set_index("method")["frames"]

    def name(method: str) -> str:
        n = int(counts[method])
        return f"`{method}`" if n == counts.max() else f"`{method}`, {n} frames"

    rows = [
        [name(method), *(cells.get((method, scenario), "–") for scenario in scenarios)]
        for method in first["method"]
    ]
    heads = [name.removeprefix("noise-").replace("db", " dB") for name in scenarios]
    return printed(["dB below the ceiling", *heads], rows)


def _families(level: float) -> str:
    of = frames()
    of = of[of["snr_db"] == level]
    names = list(dict.fromkeys(of["family"]))
    mean = of.groupby("family")[[f"likely_{name}" for name in names]].mean()
    likely = mean.loc[names].to_numpy()
    rows = [[name, *(f"{p:.2f}" for p in row)] for name, row in zip(names, likely, strict=True)]
    return printed(["truth", *names], rows)


def _by_family(suite: str) -> str:
    """What the ceiling of each family is worth: too sure draws show by the last figure."""
    order = {family: k for k, family in enumerate(frames(suite)["family"].unique())}
    rows = []
    for (family, version), of in frames(suite).groupby(["family", "version"], sort=False):
        own, expected = (-10 * np.log10(of[name].mean()) for name in ("mse", "expected_mse"))
        held = f"{traces_held(of, 95):.0%}"
        rows.append(
            [str(family), str(version), str(len(of)), f"{own:.2f}", f"{expected:.2f}", held]
        )
    rows.sort(key=lambda row: (order[row[0]], row[1]))
    heads = [
        "family",
        "version",
        "frames",
        "PSNR of the mean error [dB]",
        "the posterior's own [dB]",
        "in 95 %",
    ]
    return printed(heads, rows)


def _versions() -> str:
    """How many frames of each level are by which version of the sampler, and what is left to do."""
    parts = []
    for suite in ("noise", "shapes", "sim2real"):
        of = frames(suite)
        rows = of.drop_duplicates("scenario").to_dict("records")
        names = {row["scenario"]: f"`{suite}`, {_level(suite, row)}" for row in rows}
        parts.append(of.assign(level=of["scenario"].map(names)))
    every = pd.concat(parts)
    counts = every.groupby(["level", "version"], sort=False).size().unstack(fill_value=0)
    counts = counts.sort_index(axis=1)
    more = {
        "to be drawn anew": ~kept(every), "truth compared": every["surpassed"].notna()
    }  # fmt: skip
    counts = counts.assign(
        **{name: of.groupby(every["level"], sort=False).sum() for name, of in more.items()}
    )
    rows = [
        [str(level), *map(str, row)]
        for level, row in zip(counts.index, counts.to_numpy(), strict=True)
    ]
    return printed(["frames by version", *map(str, counts.columns)], rows)


def _rungs() -> str:
    """What each rung leaves to a sampler that knows it, beside the ideal sensor, frame by frame."""
    errors = frames("sim2real").pivot_table("mse", "sample", "scenario", sort=False)
    (ideal,) = (name for name in errors if name.startswith("sim2real-ideal"))
    snr_db = frames("sim2real").groupby("scenario")["snr_db"].first()
    rows = []
    for name in errors.columns[snr_db[errors.columns] == snr_db[ideal]].drop(ideal):
        both = errors[[ideal, name]].dropna()
        found = bootstrap(both.to_numpy(), both.index // TOUCHES, decibels)[0]
        told = _level("sim2real", {"scenario": name, "snr_db": snr_db[name]})
        rows.append([told, str(len(both)), *(f"{value:+.1f}" for value in found)])
    heads = ["", "frames", "above the ideal sensor [dB]", "95 %: from", "to"]
    return printed(heads, rows)


def _held() -> str:
    """What the posteriors of a rung hold, and those of the ideal sensor on the same frames."""
    stored = pd.read_csv(STUDIES / "rungs" / "rungs.csv")
    named = stored["scenario"].map(_rung)
    columns = {"images": ".1f", "doubted": ".0f", "place_mm": ".3f"}
    tables = {name: of.set_index("sample")[list(columns)] for name, of in stored.groupby(named)}
    ideal, rows = tables.pop("ideal"), []
    for name in named.drop_duplicates().drop(named.index[0]):
        of, control = tables[name].align(ideal, join="inner")
        medians = zip(control.median(), of.median(), columns.values(), strict=True)
        figures = (f"{value:{form}}" for *pair, form in medians for value in pair)
        rows.append([name, str(len(of)), *figures])
    heads = [
        "70 dB", "frames", "images: ideal sensor", "rung", "pixels in doubt: ideal sensor", "rung",
        "deviation of the place [mm]: ideal sensor", "rung",
    ]  # fmt: skip
    return printed(heads, rows)


def _offsets(same: str) -> str:
    """Patterns (i, i + k) by the ceiling, beside k = 3 on the same frames."""
    stored = pd.read_csv(STUDIES / "offsets" / "offsets.csv")
    stored = stored[stored["same"] == same]
    errors = stored.pivot_table("mse", "sample", "offset")
    signal = stored.pivot_table("touch_snr_db", "sample", "offset")
    rows = []
    for offset in errors.columns:
        own, gain = errors[offset].dropna(), ["", "", ""]
        if offset != _SENSOR_OFFSET:
            both = np.stack([errors[_SENSOR_OFFSET][own.index], own], axis=1)
            gain = [f"{v:+.2f}" for v in bootstrap(both, own.index // TOUCHES, decibels)[0]]
        rows.append([
            f"{offset}", str(len(own)), f"{-10 * np.log10(own.mean()):.2f}", *gain,
            *(f"{signal[of][own.index].median():.1f}" for of in (offset, _SENSOR_OFFSET)),
        ])  # fmt: skip
    heads = [
        "offset", "frames", "PSNR of the mean error [dB]", "above 3 [dB]", "95 %: from", "to",
        "median SNR of a touch [dB]", "of 3 on these frames [dB]",
    ]  # fmt: skip
    return printed(heads, rows, [True] * len(heads))


TABLES = {
    "ceiling by offset": lambda: _offsets("snr"),
    "ceiling by offset with the same noise": lambda: _offsets("noise"),
    "ceiling": lambda: _figures("noise", _COLUMNS),
    "ceiling checks": lambda: _figures("noise", _CHECKS),
    "versions of the sampler": _versions,
    "below the ceiling": lambda: _below("noise"),
    "ceiling of rungs": lambda: _figures("sim2real", _COLUMNS),
    "rungs beside the ideal sensor": _rungs,
    "what posteriors of rungs hold": _held,
    "ceiling checks of rungs": lambda: _figures("sim2real", _CHECKS),
    "ceiling of shapes": lambda: _figures("shapes", _COLUMNS),
    "ceiling checks of shapes": lambda: _figures("shapes", _CHECKS),
    "ceiling of shapes by family": lambda: _by_family("shapes"),
    "below the ceiling of shapes": lambda: _below("shapes"),
    "families at 50 dB": lambda: _families(50.0),
    "families at 30 dB": lambda: _families(30.0),
}
