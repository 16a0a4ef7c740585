"""Tables for a terminal: listings, changes between runs, calibrations."""

from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from eitbench.benchmark.analysis.comparison import Change, RunComparison
    from eitbench.benchmark.submissions.hidden import Gap

# Longer than a line; programs get it.
_HIDDEN = ("citation",)
_STYLES = {"better": "green", "worse": "bold red"}


def names_table(rows: Sequence[Mapping[str, str | int | None]]) -> "Table":
    """Table of `rows`: the name stands first and is never cut, the rest is folded."""
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    shown = [{k: v for k, v in row.items() if k not in _HIDDEN} for row in rows]
    longest = max((len(str(next(iter(row.values())))) for row in shown), default=0)
    table = Table(box=None, pad_edge=False)
    for k, column in enumerate(shown[0] if shown else ()):
        first = k == 0
        table.add_column(
            escape(column), overflow="fold", no_wrap=first, min_width=longest if first else None
        )
    for row in shown:
        table.add_row(*(Text("" if value is None else str(value)) for value in row.values()))
    return table


def _ratio(change: "Change") -> str:
    if change.time_ratio is None:
        return "–"
    return f"x {change.time_ratio:.2f}{' shared' if change.shared else ''}"


def _interval(change: "Change", number: Callable[[float], str]) -> str:
    if change.low is None or change.high is None:
        return ""
    return f" ({number(change.low)} to {number(change.high)})"


def changes_notes(comparison: "RunComparison") -> list[str]:
    """Sentences on what the p-values of a comparison are, and on what could not be tested."""
    from eitbench.benchmark.analysis.comparison import TOO_FEW
    from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS

    tested = sum(change.p is not None for change in comparison.changes)
    few = [change for change in comparison.changes if change.verdict == TOO_FEW]
    notes = []
    if tested:
        notes.append(
            f"p: of no change, two-sided, adjusted for the {tested} figures of this table (Holm). "
            "The same frames are compared in both runs, and sessions or objects are drawn, not "
            "single frames; medians are tested by Wilcoxon's signed ranks."
        )
    if any(change.margin for change in comparison.changes):
        notes.append("A figure fails if the same test finds it worse by more than its margin.")
    if few:
        notes.append(
            f"{len(few)} figures are of fewer than {MIN_CLUSTERS} sessions or objects "
            f"(at least {min(change.clusters for change in few)}), too few for an interval or a "
            "test: their differences may be chance. Run more samples (--limit)."
        )
    return notes


def changes_table(comparison: "RunComparison") -> "Table":
    """Table of the changes between two runs, one line each."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from eitbench.benchmark.analysis.comparison import COMPARED
    from eitbench.reports.tables.columns import METHOD_LAYOUT, Column, p_text, printable

    forms = {column.name: column for column in METHOD_LAYOUT.columns}
    shown = Table("Scenario", "Method", "Figure", box=box.SIMPLE_HEAD)
    for heading in ("n", "Before", "After", "Difference (95 %)", "p (Holm)", "Time"):
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column("Verdict")
    for change in comparison.changes:
        spec = COMPARED[change.figure]
        number = forms.get(spec.name, Column(spec.name, spec.heading, spec.form)).number
        shown.add_row(
            Text(printable(change.scenario)),
            Text(printable(change.method)),
            Text(spec.heading),
            str(change.n),
            number(change.before),
            number(change.after),
            number(change.difference) + _interval(change, number),
            p_text(change.p),
            _ratio(change),
            Text(change.verdict, style=_STYLES.get(change.verdict, "")),
        )
    return shown


def gaps_table(gaps: "Sequence[Gap]") -> "Table":
    """Table of methods on the open and the hidden test split, one line each."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from eitbench.reports.tables.columns import printable
    from eitbench.reports.tables.gaps import HEADS, gap_texts

    shown = Table(*HEADS[:2], box=box.SIMPLE_HEAD)
    for heading in HEADS[2:-1]:
        shown.add_column(heading, justify="right", no_wrap=True)
    shown.add_column(HEADS[-1])
    for gap in gaps:
        style = _STYLES["worse"] if gap.falls else ""
        *texts, verdict = map(printable, gap_texts(gap))
        shown.add_row(*map(Text, texts), Text(verdict, style=style))
    return shown


def calibration_table(found: dict[str, Any]) -> "Group":
    """Electrodes and channels side by side, below the misfit that a calibration explains."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    before, after = found["misfit_before"], found["misfit_after"]
    head = (
        f"{found['sensor']}: the reference frame of the model differs from the measured one by "
        f"{before:.2%} of the frame's rms (median value), and by {after:.2%} after calibration. "
        f"1 V/A is {found['factor']:.4g} of the board's units.\n"
    )
    if not found["credible"]:
        head += (
            "Calibration removes less than half of the difference, so frames are not corrected. "
            "The rest is noise, or errors of the sensor that gains, electrode places and contact "
            "impedances do not describe.\n"
        )
        return Group(Text(head))
    columns = Table("electrode", "shift mm", "contact x", "channel", "gain %", box=None)
    for column in columns.columns:
        column.justify = "right"
    left = [
        (
            str(of["electrode"]),
            f"{of['shift_mm']:+.2f} ± {of['shift_mm_sd']:.2f}",
            f"{of['contact_impedance']:.2f} */ {of['contact_impedance_sd_factor']:.2f}",
        )
        for of in found["electrodes"]
    ]
    right = [
        (
            "{}-{}".format(*of["channel"]),
            f"{100 * (of['gain'] - 1):+.2f} ± {100 * of['gain_sd']:.2f}",
        )
        for of in found["channels"]
    ]
    for electrode, channel in zip_longest(left, right):
        columns.add_row(*(electrode or ("", "", "")), *(channel or ()))
    note = (
        "\n± and */: one standard deviation. In a suite, `calibrated = true` in a scenario gives "
        "methods frames that are corrected by this."
    )
    return Group(Text(head), columns, Text(note))
