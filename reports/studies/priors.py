"""The table of what priors are worth."""

from pathlib import Path

import pandas as pd

from eitbench.benchmark.studies.priors import PHANTOMS
from eitbench.reports.tables.formats import csv_text, markdown_table

FILE_NAME = "priors.csv"
_HEADS = ("prior", "method", "S with it", "S without it", "worth (95 %)")


def write_priors(table: pd.DataFrame, folder: Path) -> list[Path]:
    """Write `priors.csv` and the table `priors.md` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / FILE_NAME, folder / "priors.md"]
    written[0].write_text(csv_text(table), encoding="utf-8")
    written[1].write_text(priors_table(table), encoding="utf-8")
    return written


def priors_table(table: pd.DataFrame) -> str:
    """Return a Markdown table; a difference whose interval leaves out 0 stands in bold.

    For the training phantoms S is the lead over total variation.
    """
    body = []
    for row in table.to_dict("records"):
        worth = f"{row['worth']:+.3f} ({row['low']:+.3f} to {row['high']:+.3f})"
        sure = row["low"] > 0 or row["high"] < 0
        lead = "lead " if row["prior"] == PHANTOMS else ""
        body.append(
            [
                str(row["prior"]),
                f"`{row['method']}`",
                f"{lead}{row['known']:.3f}",
                f"{lead}{row['unknown']:.3f}",
                f"**{worth}**" if sure else worth,
            ]
        )
    return "\n".join(markdown_table(_HEADS, body, [False, False, True, True, True])) + "\n"
