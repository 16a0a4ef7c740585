"""Tables of the ceiling, from the record that comes with eitbench."""

import numpy as np
import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.ceiling.figures import summary
from eitbench.benchmark.ceiling.record import decibels, recorded_frames
from eitbench.benchmark.metrics.statistics import bootstrap, means
from eitbench.scenarios.arrays import Array
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
    "apart_db": ("samplers apart [dB]", "+.2f"), "agreed": ("R-hat < 1.01", ".0%"),
    "exact": ("exact weights", ".0%"), "within_50": ("in 50 %", ".0%"),
    "within_80": ("in 80 %", ".0%"), "within_95": ("in 95 %", ".0%"),
    "uniform_p": ("p of uniform ranks", ".2g"),
}  # fmt: skip


def frames() -> pd.DataFrame:
    """Return the recorded frames of the suite `noise`, the least noise first."""
    scenarios = load_suite("noise").scenarios
    return pd.concat([recorded_frames(of.name, of.data_hash("test")) for of in scenarios])


def _level(row: dict[str, float]) -> str:
    return f"{row['snr_db']:g} dB"


def _figures() -> str:
    rows = [
        [_level(row), *(f"{row[name]:{form}}" for name, (_, form) in _COLUMNS.items())]
        for row in summary(frames()).to_dict("records")
    ]
    return printed(["", *(head for head, _ in _COLUMNS.values())], rows)


def _checks() -> str:
    rows = [
        [_level(row), *(f"{row[name]:{form}}" for name, (_, form) in _CHECKS.items())]
        for row in summary(frames()).to_dict("records")
    ]
    return printed(["", *(head for head, _ in _CHECKS.values())], rows)


def _below() -> str:
    stored = pd.read_csv(STUDIES / "ceiling" / "below.csv")
    scenarios = stored["scenario"].unique()
    distance = "{below_db:.1f} ({low:z.1f} to {high:.1f})"
    cells = {
        (row["method"], row["scenario"]): distance.format(**row)
        for row in stored.to_dict("records")
    }
    first = stored[stored["scenario"] == scenarios[-1]].sort_values("below_db")
    rows = [
        [f"`{method}`", *(cells.get((method, scenario), "–") for scenario in scenarios)]
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


def _offsets(same: str) -> str:
    """Patterns (i, i + k) by the ceiling, paired with k = 3 on the frames that both have."""
    stored = pd.read_csv(STUDIES / "offsets" / "offsets.csv")
    stored = stored[stored["same"] == same]
    errors = stored.pivot_table("mse", "sample", "offset")
    clusters = stored.drop_duplicates("sample").set_index("sample")["cluster"]
    signal = stored.pivot_table("touch_snr_db", "sample", "offset")
    rows = []
    for offset in errors.columns:
        both = errors[[offset, _SENSOR_OFFSET]].dropna()
        both = both.set_axis(["own", "known"], axis=1)
        (of,) = bootstrap(both.to_numpy(), clusters[both.index], _psnr)
        row = [f"{offset}", str(len(both)), f"{of.value:.2f}", "", "", ""]
        if offset != _SENSOR_OFFSET:
            (gain,) = bootstrap(both[["known", "own"]].to_numpy(), clusters[both.index], decibels)
            row[3:] = [f"{gain.value:+.2f}", f"{gain.low:+.2f}", f"{gain.high:+.2f}"]
        rows.append([*row, f"{signal[offset].median():.1f}"])
    heads = [
        "offset", "frames", "PSNR of the mean error [dB]", "against 3 [dB]", "95 %: from", "to",
        "median SNR of a touch [dB]",
    ]  # fmt: skip
    return printed(heads, rows, [True] * len(heads))


def _psnr(counts: Array, errors: Array) -> Array:
    return np.asarray(-10 * np.log10(means(counts, errors)[:, :1]))


TABLES = {
    "ceiling by offset": lambda: _offsets("snr"),
    "ceiling by offset with the same noise": lambda: _offsets("noise"),
    "ceiling": _figures,
    "ceiling checks": _checks,
    "below the ceiling": _below,
    "families at 50 dB": lambda: _families(50.0),
    "families at 30 dB": lambda: _families(30.0),
}
