"""The tables of designs: one row a design, and one row a place of a design."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eitbench.benchmark.design.designs import median

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.benchmark.design.designs import Design

_MM, _MM2, _PERCENT = 1e3, 1e6, 1e2
MAPS = {
    "detectability": ("detectability", 1.0),
    "place_mm": ("place", _MM),
    "strength_percent": ("strength", _PERCENT),
    "size_percent": ("size", _PERCENT),
    "smallest_s_per_m_mm2": ("smallest", _MM2),
    "two_point_mm": ("two_point", _MM),
    "ambiguous_percent": ("ambiguous", _PERCENT),
}
"""Columns of maps, with the attribute of `Maps` and what it is multiplied with."""

MOST_CONDITION = 1e12
"""Above it a condition is that of rounding."""
MOST_OPEN = 0.1
"""Share of ambiguous places from which on it is said."""
_HEADS = {
    "design": ("design", "s"),
    "measurements": ("values", "d"),
    "independent": ("independent", "d"),
    "above_noise": ("above noise", "d"),
    "condition": ("condition", ".1e"),
    "frame_ms": ("frame [ms]", ".0f"),
    "frames": ("averaged", "d"),
    "detectability": ("z", ".1f"),
    "place_mm": ("place [mm]", ".2f"),
    "strength_percent": ("strength [%]", ".1f"),
    "size_percent": ("size [%]", ".0f"),
    "smallest_s_per_m_mm2": ("smallest touch [S/m mm²]", ".2f"),
    "two_point_mm": ("two points [mm]", ".1f"),
    "ambiguous_percent": ("ambiguous [%]", ".0f"),
}


def title(of: Design) -> str:
    """Return the name of a design for people."""
    return f"{of.sensor.n_electrodes} electrodes, {of.pattern}"


def design_table(designs: Sequence[Design]) -> pd.DataFrame:
    """One row a design: medians over the places, of `ambiguous` the mean; NaN for one too slow."""
    rows = []
    for of in designs:
        row: dict[str, object] = {
            "design": title(of),
            "electrodes": of.sensor.n_electrodes,
            "pattern": of.pattern,
            "measurements": of.sensor.n_measurements,
            "independent": of.independent,
            "above_noise": of.above_noise,
            "condition": of.condition,
            "frame_ms": _MM * of.frame_s,
            "frames": of.frames,
        }
        for name, (attribute, factor) in MAPS.items():
            values = None if of.maps is None else getattr(of.maps, attribute)
            if name == "ambiguous_percent" and values is not None:
                row[name] = factor * float(np.nanmean(values))
            else:
                row[name] = factor * median(values)
        rows.append(row)
    return pd.DataFrame(rows)


def design_rows(table: pd.DataFrame) -> list[list[str]]:
    """Return the table as texts, its heads first; "–" is none, "none" that nothing resolves."""

    def text(value: object, form: str) -> str:
        if isinstance(value, float) and not math.isfinite(value):
            return "–" if math.isnan(value) else "none"
        if form == ".1e" and isinstance(value, float) and value > MOST_CONDITION:
            return f"over {MOST_CONDITION:.0e}"
        return format(value, form)

    rows = [
        [text(row[name], form) for name, (_, form) in _HEADS.items()]
        for row in table.to_dict("records")
    ]
    return [[head for head, _ in _HEADS.values()], *rows]


def places_table(designs: Sequence[Design]) -> pd.DataFrame:
    """One row a place with room for the touch, of every design that is fast enough."""
    tables = []
    for of in designs:
        if of.maps is None:
            continue
        x, y = np.meshgrid(_MM * of.maps.x, _MM * of.maps.y)
        free = np.isfinite(of.maps.detectability)
        columns = {
            name: (factor * getattr(of.maps, attribute))[free]
            for name, (attribute, factor) in MAPS.items()
        }
        places = {"x_mm": x[free], "y_mm": y[free]}
        tables.append(pd.DataFrame({"design": title(of), **places, **columns}))
    return pd.concat(tables) if tables else pd.DataFrame(columns=["design", "x_mm", "y_mm", *MAPS])


def ambiguity(of: Design) -> str:
    """A sentence on a design whose frames leave the place open, else ""."""
    if of.maps is None:
        return ""
    known = of.maps.ambiguous[np.isfinite(of.maps.ambiguous)]
    share = float(np.mean(known)) if known.size else 0.0
    if share < MOST_OPEN:
        return ""
    return (
        f" But a touch at {share:.0%} of the places has the frame of one elsewhere: the bound is "
        "for those who know roughly where it is."
    )
