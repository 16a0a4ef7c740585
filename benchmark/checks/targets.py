"""What `eitbench check` checks: methods and operators, by name or all that a file registers."""

from pathlib import Path

from eitbench.benchmark.checks.checking import CheckReport
from eitbench.benchmark.checks.method_checks import check_method
from eitbench.benchmark.checks.method_under_test import OWN_GRID
from eitbench.benchmark.checks.operator_checks import check_operator
from eitbench.benchmark.workers.worker import plugin_names
from eitbench.methods.registry import methods, operators
from eitbench.scenarios.errors import InputError, unknown_name


def check_target(target: str) -> list[CheckReport]:
    """Check a method or operator by name, or every one that the file `target` (.py) registers.

    Raises:
        InputError: an unknown name (the nearest is suggested), a method that lacks something here,
            or a file that does not load.
    """
    if target.endswith(".py"):
        plugin = Path(target).resolve()
        found = plugin_names(plugin)
        return [
            *(check_method(name, plugin=plugin) for name in found.methods),
            *(check_operator(name, plugin=plugin) for name in found.operators),
        ]
    known = methods()
    if target in known:
        if why := known[target].unusable(OWN_GRID.nominal_sensor):
            raise InputError(f"{target!r} cannot be checked here: {why}")
        return [check_method(target)]
    if target in operators():  # looked up last: it loads their libraries
        return [check_operator(target)]
    raise unknown_name("method or operator", target, {*known, *operators()})
