"""What a report shows of run directories."""

from collections.abc import Sequence
from pathlib import Path

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.page.report_data import ReportData, report_of


def report_data(paths: Sequence[Path]) -> ReportData:
    """Read runs, and return what a report shows of them."""
    return report_of([read_run(path) for path in paths])
