"""Tables and figures of studies."""

from eitbench.reports.studies.summaries import StudySummary, read_study

__all__ = ["StudySummary", "read_study"]
