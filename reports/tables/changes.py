"""How the changes between two runs are shown."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.tables.columns import METHOD_LAYOUT, printable

if TYPE_CHECKING:
    from rich.table import Table

    from eitbench.benchmark.analysis.comparison import RunComparison

_STYLES = {"better": "green", "worse": "bold red"}
_FORMS = {column.name: column for column in METHOD_LAYOUT.columns}


def describe(comparison: RunComparison) -> dict[str, Any]:
    """Plain values for JSON."""
    return asdict(comparison)


def table(comparison: RunComparison) -> Table:
    """One line for each change, for a terminal."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=box.SIMPLE_HEAD)
    for heading in ("Scenario", "Method", "Figure"):
        shown.add_column(heading)
    for heading in ("n", "Before", "After", "Difference (95 %)", "p (Holm)", "Time"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("Verdict")
    for change in comparison.changes:
        number = _FORMS[change.figure].number
        ends = f"{number(change.low)} to {number(change.high)}"
        time = "–" if change.time_ratio is None else f"x {change.time_ratio:.2f}"
        shown.add_row(
            Text(printable(change.scenario)),
            Text(printable(change.method)),
            METRICS[change.figure].title,
            str(change.n),
            number(change.before),
            number(change.after),
            f"{number(change.difference)} ({ends})",
            f"{change.p:.3f}" if change.p >= 0.001 else "<0.001",
            time,
            Text(change.verdict, style=_STYLES.get(change.verdict, "")),
        )
    return shown
