"""Tables of the bounds of a design beside errors on recorded skins, from their record."""

import json

import pandas as pd
from docs.tables.record import STUDIES, printed

_BOUNDS = {
    "noise": "noise", "noise_with_outliers": "with outliers", "misfit": "misfit",
    "response": "response",
}  # fmt: skip
_MEASURED = {
    "likely_noise": "most likely, noise", "likely_misfit": "most likely, misfit",
    "noser": "`noser`", "kernel_ridge": "`kernel-ridge`",
}  # fmt: skip


def _by_skin() -> str:
    """Return bounds and errors of each skin."""
    rows = [
        [
            f"`{row['skin']}`", f"{row['presses']}", f"{row['signal_to_noise']:.1f}",
            f"{row['snr_db']:.0f}", f"{100 * row['explained']:.0f} %",
            *(f"{row[f'{of}_mm']:.1f}".replace("inf", "–") for of in (*_BOUNDS, *_MEASURED)),
        ]
        for row in pd.read_csv(STUDIES / "design" / "skins.csv").to_dict("records")
    ]  # fmt: skip
    predicted = (f"bound [mm]: {of}" for of in _BOUNDS.values())
    measured = (f"error [mm]: {of}" for of in _MEASURED.values())
    heads = ["", "presses", "signal to noise", "`--snr`", "explained", *predicted, *measured]
    return printed(heads, rows)


def _over_skins() -> str:
    """Return how far predictions are from errors, and how they order skins and places."""
    record = json.loads((STUDIES / "design" / "record.json").read_text())
    rows = []
    for row in record["over_skins"]:
        ratio = f"{row['ratio_median']:.1f} ({row['ratio_least']:.1f} to {row['ratio_most']:.1f})"
        rows.append([
            _BOUNDS[row["predicted"]], _MEASURED[row["measured"]], ratio,
            f"{row['spearman']:.2f} (n = {row['skins']}, p = {row['p']:.1g})",
            f"{row['over_places']:.2f}", f"{row['over_places_possible']:.2f}",
            f"{row['rim_predicted']:.2f}", f"{row['rim_measured']:.2f}",
        ])  # fmt: skip
    heads = [
        "bound", "error", "error over bound", "order of skins",
        "order of places", "possible", "rim, bound", "rim, error",
    ]  # fmt: skip
    return printed(heads, rows, [False, False, *[True] * 6])


TABLES = {"design by skin": _by_skin, "design over skins": _over_skins}
