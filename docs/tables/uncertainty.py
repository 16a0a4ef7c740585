"""Tables of stated uncertainty, from the record in `docs/studies/uncertainty`."""

import math

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY

_PIXELS = (
    "crps", "coverage_50", "coverage_80", "coverage_95", "sharpness", "error_over_spread", "ause",
)  # fmt: skip
_PLACES = ("place_coverage_50", "place_coverage_80", "place_coverage_95", "place_radius_mm")


def _stored() -> pd.DataFrame:
    return pd.read_csv(STUDIES / "uncertainty" / "uncertainty.csv")


def _text(row: dict[str, float], name: str) -> str:
    if math.isnan(row[name]):
        return "–"
    form = UNCERTAINTY[name].form
    text = format(row[name], form)
    if name == "crps" and not math.isnan(row["crps_low"]):
        text += f" ({row['crps_low']:{form}} to {row['crps_high']:{form}})"
    return text


def _table(names: tuple[str, ...], scenarios: list[str]) -> str:
    stored = _stored()
    of = stored[stored["scenario"].isin(scenarios) & stored[names[-1]].notna()]
    heads = ["Scenario", "Method", "n", *(UNCERTAINTY[name].heading for name in names)]
    rows = [
        [row["scenario"], f"`{row['method']}`" if row["method"] != "ceiling" else "*ceiling*",
         str(row["n"]), *(_text(row, name) for name in names)]
        for row in of.to_dict("records")
    ]  # fmt: skip
    return printed(heads, rows, [False, False, *[True] * (len(heads) - 2)])


def _simulated(prefix: str, names: tuple[str, ...]) -> str:
    found = _stored()["scenario"].unique()
    return _table(names, [name for name in found if name.startswith(prefix)])


def _others(names: tuple[str, ...], *, images: bool) -> str:
    stored = _stored()
    known = stored.groupby("scenario")["crps"].transform(lambda of: of.notna().any())
    of = stored[(known == images) & ~stored["scenario"].str.startswith("noise")]
    return _table(names, list(of["scenario"].unique()))


TABLES = {
    "uncertainty on noise": lambda: _simulated("noise", _PIXELS),
    "uncertainty of places on noise": lambda: _simulated("noise", _PLACES),
    "uncertainty with imperfections": lambda: _others(_PIXELS, images=True),
    "uncertainty of places on skins": lambda: _others(_PLACES, images=False),
}
