"""Tables of the ceiling, from the record that comes with eitbench."""

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.ceiling.figures import summary
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.scenarios.suites.suite import load_suite

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


TABLES = {
    "ceiling": _figures,
    "ceiling checks": _checks,
    "below the ceiling": _below,
    "families at 50 dB": lambda: _families(50.0),
    "families at 30 dB": lambda: _families(30.0),
}
