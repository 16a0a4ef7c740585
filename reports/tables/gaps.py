"""Methods on the open and the hidden test split, as rows of a table."""

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS
from eitbench.benchmark.submissions.hidden import Gap
from eitbench.benchmark.submissions.tiers import is_submission, reproduced_on, tier
from eitbench.reports.tables.columns import METHOD_LAYOUT, p_text

HEADS = ("Scenario", "Method", "Figure", "n", "Open", "Hidden", "Difference (95 %)", "p", "Verdict")
_FORMS = {column.name: column for column in METHOD_LAYOUT.columns}


def difference(gap: Gap) -> str:
    """Return hidden minus open, with its 95 % interval if it has one."""
    number = _FORMS[gap.figure].number
    if gap.low is None or gap.high is None:
        return number(gap.difference)
    return f"{number(gap.difference)} ({number(gap.low)} to {number(gap.high)})"


def gap_texts(gap: Gap) -> list[str]:
    """Return the texts of a row, in the order of `HEADS`."""
    number = _FORMS[gap.figure].number
    return [
        gap.scenario,
        gap.method,
        METRICS[gap.figure].heading,
        str(gap.n),
        number(gap.open),
        number(gap.hidden),
        difference(gap),
        p_text(gap.p),
        _verdict(gap),
    ]


def _verdict(gap: Gap) -> str:
    if gap.p is None:
        return "too few to test"
    return "falls by more than chance" if gap.falls else "no fall found"


def gaps_note() -> str:
    """Return sentences on how gaps were tested."""
    return (
        "Difference: hidden minus open. p: of no difference, two-sided, adjusted for all gaps of "
        "the same run (Holm). The two sets are drawn apart from each other, so both vary by "
        f"chance; whole sessions are drawn, and fewer than {MIN_CLUSTERS} give no test. A fall "
        "that is smaller than its interval is wide would not be found."
    )


def tier_texts(run: Run, row: Row) -> tuple[str, str]:
    """Return the tier of a method of a record or a submission, and hidden minus open.

    Both in words; "" for both of other runs, and for the second where there is no hidden figure.
    """
    if run.whole and not is_submission(run.path):
        return "", ""
    found = tier(run, row["scenario"], row[run.kind.name])
    times = " (its times are self-reported)" if is_submission(run.path) else ""
    if found.gap is None:
        on = f" on {found.reproduced_on}" if found.reproduced_on else ""
        return f"{found.tier}{on}{times}", ""
    published = " (key published)" if found.key_published else ""
    return f"{found.tier}{published}, {_verdict(found.gap)}{times}", difference(found.gap)


def run_tier(run: Run) -> str:
    """Return what was run again of a run, for all of its methods; "self-reported" if nothing."""
    told = reproduced_on(run)
    return f"reproduced on {told}" if told else "self-reported"
