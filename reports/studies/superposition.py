"""The study of superposition as tables."""

from collections.abc import Mapping
from typing import Any

from eitbench.reports.tables.formats import markdown_table


def explained_table(record: Mapping[str, Any]) -> str:
    """Markdown table of what single presses explain, from the record of the study."""
    rows = [
        [
            row["kind"],
            f"{row['distance_mm']:.0f} mm" if row["distance_mm"] else "",
            str(row["n"]),
            f"{row['median']:.0%} ({row['least']:.0%} to {row['most']:.0%})",
        ]
        for row in record["explained"]
    ]
    return "\n".join(markdown_table(["frames", "distance", "n", "explained: median"], rows))
