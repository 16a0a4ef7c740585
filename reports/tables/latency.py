"""The table of latencies: one row for each method, touch and material."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

_SPREAD = ("detected_frames", "detected_ms", "gone_frames", "gone_ms", "ghost_strength")


def quantile(values: pd.Series, share: float) -> float:
    """The least value that `share` of the values do not exceed; inf is greater than all, NaN none.

    No mean of two values, of which one may be infinite.
    """
    known = values.dropna().to_numpy(dtype=float)
    return float(np.quantile(known, share, method="inverted_cdf")) if len(known) else math.nan


def latency_table(touches: pd.DataFrame, image_ms: Mapping[str, float]) -> pd.DataFrame:
    """One row for each method, material and pressure, from one row for each touch.

    Args:
        touches: see `eitbench.hardware.live.latency.Latencies`.
        image_ms: computing time of an image of each method [ms].
    """
    rows = []
    for (method, kpa, ideal), of in touches.groupby(
        ["method", "pressure_kpa", "ideal"], sort=False
    ):
        row: dict[str, object] = {
            "method": method, "pressure_kpa": kpa, "ideal": ideal, "touches": len(of),
            "image_ms": image_ms[str(method)],
            "missed": float(np.isinf(of["detected_frames"]).mean()),
            "false_contacts": of["false_contacts"].sum() / of["untouched"].sum(),
            "ghosts": of["ghost"].mean(),
            "dropped": of["dropped"].mean(),
            "failed": of["failed"].mean(),
        }  # fmt: skip
        for name in _SPREAD:
            row[name] = quantile(of[name], 0.5)
            row[f"{name}_p95"] = quantile(of[name], 0.95)
        rows.append(row)
    order = {name: k for k, name in enumerate(image_ms)}
    table = pd.DataFrame(rows)
    return table.sort_values(
        ["method", "pressure_kpa", "ideal"],
        key=lambda of: of.map(order) if of.name == "method" else of,
        ascending=[True, True, False],
        ignore_index=True,
    )


def latency_rows(table: pd.DataFrame) -> list[list[str]]:
    """Return the table as texts, its heads first: medians, in brackets 95th percentiles.

    "never" stands for a touch that is not detected, or a contact that stays; "–" for nothing.
    """

    def text(value: float, form: str) -> str:
        if math.isnan(value):
            return "–"
        return "never" if math.isinf(value) else format(value, form)

    def spread(row: Mapping[Hashable, float], name: str, form: str) -> str:
        middle, high = text(row[name], form), text(row[f"{name}_p95"], form)
        return middle if middle in ("–", "never") else f"{middle} ({high})"

    heads = [
        "method", "touch [kPa]", "material", "image [ms]", "dropped", "missed", "frames", "ms",
        "false contacts", "gone: frames", "gone: ms", "ghosts", "ghost strength",
    ]  # fmt: skip
    return [
        heads,
        *(
            [
                row["method"], f"{row['pressure_kpa']:g}", "ideal" if row["ideal"] else "relaxes",
                f"{row['image_ms']:.1f}", f"{row['dropped']:.0%}", f"{row['missed']:.0%}",
                spread(row, "detected_frames", ".0f"), spread(row, "detected_ms", ".0f"),
                f"{row['false_contacts']:.1%}", spread(row, "gone_frames", ".0f"),
                spread(row, "gone_ms", ".0f"), text(row["ghosts"], ".0%"),
                spread(row, "ghost_strength", ".1%"),
            ]
            for row in table.to_dict("records")
        ),
    ]  # fmt: skip
