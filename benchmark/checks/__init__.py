"""The contract of methods and operators, as checks."""

from eitbench.benchmark.checks.check import check_method, check_operator, check_target
from eitbench.benchmark.checks.harness import CheckReport, CheckResult

__all__ = ["CheckReport", "CheckResult", "check_method", "check_operator", "check_target"]
