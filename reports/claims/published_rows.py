"""Readings of the published NOSER and TV rows, beside what each of them reproduces."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict

from eitbench.benchmark import DataCorruptError
from eitbench.benchmark.analysis.results import read_json
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.benchmark.studies.readings import FILE_NAME
from eitbench.reports.claims.claim import LEAST_SAMPLES, Verdict, around
from eitbench.reports.claims.rules import CLASSICAL, IMAGE_METRICS, LABELS, TOLERANCES
from eitbench.reports.tables.published import TABLE_II

SHOWN = 8
"""Readings of each method that are printed, those that reproduce most figures first."""


class ReadRow(TypedDict):
    """A published row and its readings.

    `published` and each of `readings` hold figures by a name of `IMAGE_METRICS`; a reading has its
    `name` and, as `reproduced`, the names of the figures that it reproduces. `says` sums up.
    """

    method: str
    samples: int
    published: Mapping[str, float]
    readings: list[dict[str, Any]]
    says: str


def read_rows(folder: Path) -> list[ReadRow]:
    """Read the study `readings` and compare it with the published rows.

    A strength that was fitted to the published RIE does not reproduce that figure.

    Raises:
        DataCorruptError: the study is damaged.
    """
    content = read_json(folder / FILE_NAME)
    try:
        return [
            _row(method, [row for row in content["rows"] if row["method"] == method], content)
            for method in CLASSICAL
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise DataCorruptError(f"{folder / FILE_NAME} is damaged: run the study again.") from error


def _row(method: str, rows: list[dict[str, Any]], content: dict[str, Any]) -> ReadRow:
    published = TABLE_II[method]
    readings = []
    for row in rows:
        met = [
            name
            for name in IMAGE_METRICS
            if not (name == "rie" and row["strength"] != 1.0)
            and around(published[name], **TOLERANCES[name]).test(
                Interval(row[name], row[name], row[name]), LEAST_SAMPLES
            )
            is Verdict.holds
        ]
        readings.append(row | {"name": _name(row), "reproduced": met})
    # The plain reading first, then those that reproduce most; among equals the nearest in CC.
    order = sorted(
        readings[1:],
        key=lambda row: (-len(row["reproduced"]), abs(row["cc"] - published["cc"])),
    )
    found = {name for row in readings for name in row["reproduced"]}
    most = max(len(row["reproduced"]) for row in readings)
    never = [name.upper() for name in IMAGE_METRICS if name not in found]
    return ReadRow(
        method=LABELS[method],
        samples=content["samples"],
        published=published,
        readings=[readings[0], *order[: SHOWN - 1]],
        says=f"Of {len(readings)} readings the best reproduce {most} of the four figures of "
        f"{LABELS[method]}."
        + (f" None reproduces its {' or '.join(never)}." if never else "")
        + " What is reproduced is consistent with a reading, and does not prove it.",
    )


def _name(row: Mapping[str, Any]) -> str:
    """Describe what differs from how the benchmark reads frames and scores images."""
    parts = []
    if row["frames"] != "as they are":
        parts.append(f"frames: {row['frames']}")
    if row["axes"] != "as they are":
        parts.append(f"axes {row['axes']}")
    if not row["background"]:
        parts.append("background left out")
    if row["sign"] < 0:
        parts.append("sign reversed")
    if row["strength"] != 1.0:
        parts.append(f"{row['strength']:.2g} times as strong (fitted to RIE)")
    return "; ".join(parts) or "absolute maps, as scored here"
