"""HTML pages, and files for a paper: the report of runs, the site of many, the claim ledger."""

from eitbench.reports.page.ledger_page import write_ledger
from eitbench.reports.page.report import write_report
from eitbench.reports.page.site import write_site

__all__ = ["write_ledger", "write_report", "write_site"]
