"""Entry points of `eitbench check`: checks of methods, methods of places and operators, in workers.

A method or operator that hangs or dies fails its checks and nothing else.
"""

import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from eitbench.benchmark.checks import method_checks, operator_checks, place_checks
from eitbench.benchmark.checks.harness import (
    LIMIT_S,
    BrokenError,
    Check,
    CheckReport,
    CheckWorker,
    GivenUpError,
    SkippedError,
    answer_of,
    checks_in,
    run_checks,
)
from eitbench.benchmark.checks.method_under_test import OWN_GRID, SCENARIO, MethodUnderTest
from eitbench.benchmark.checks.operator_under_test import SMALL, OperatorCheckService
from eitbench.benchmark.checks.place_under_test import PlaceUnderTest
from eitbench.benchmark.workers.worker import plugin_names
from eitbench.methods.registry import PLACE_REGISTRY, methods, operators
from eitbench.scenarios.errors import InputError, unknown_name

METHOD_CHECKS = checks_in(method_checks)
PLACE_CHECKS = checks_in(place_checks)
OPERATOR_CHECKS = checks_in(operator_checks)


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
            *(check_place_method(name, plugin=plugin) for name in found.places),
            *(check_operator(name, plugin=plugin) for name in found.operators),
        ]
    known = methods()
    if target in known:
        if why := known[target].unusable(OWN_GRID.nominal_sensor):
            raise InputError(f"{target!r} cannot be checked here: {why}")
        return [check_method(target)]
    if target in PLACE_REGISTRY.known():
        return [check_place_method(target)]
    if target in operators():  # looked up last: it loads their libraries
        return [check_operator(target)]
    raise unknown_name(
        "method or operator", target, {*known, *PLACE_REGISTRY.known(), *operators()}
    )


def check_method(name: str, *, plugin: Path | None = None, limit_s: float = LIMIT_S) -> CheckReport:
    """Run every check on the method `name`, taken from the file `plugin` if one is given.

    Args:
        limit_s: seconds that fitting, and each answer, may take.

    Raises:
        InputError: an unknown method (the nearest name is suggested), or one that expects to fail
            a check that does not exist, or for no reason.
    """
    if plugin is None and name not in (known := methods()):
        raise unknown_name("method", name, known)
    with tempfile.TemporaryDirectory() as folder:
        tested = MethodUnderTest(SCENARIO, name, plugin, limit_s, Path(folder))
        if tested.refuses_sensor:
            tested = MethodUnderTest(OWN_GRID, name, plugin, limit_s, Path(folder))
        try:
            expected = _expected_failures(tested.worker, name, METHOD_CHECKS)
            results = run_checks(METHOD_CHECKS, lambda check: check(tested), expected)
        finally:
            tested.worker.close()
    height, width = tested.sensor.image_shape
    where = f"{tested.sensor.name}, {height} x {width}"
    return CheckReport("method", name, where, results, len(METHOD_CHECKS) - len(results))


def check_place_method(name: str, *, plugin: Path | None = None) -> CheckReport:
    """Run every check on the method of places `name`; see `check_method`.

    Raises:
        InputError: as for `check_method`.
    """
    if plugin is None and name not in (known := PLACE_REGISTRY.known()):
        raise unknown_name("place method", name, known)
    with tempfile.TemporaryDirectory() as folder:
        tested = PlaceUnderTest(name, plugin, LIMIT_S, Path(folder))
        try:
            expected = _expected_failures(tested.worker, name, PLACE_CHECKS)
            results = run_checks(PLACE_CHECKS, lambda check: check(tested), expected)
        finally:
            tested.worker.close()
    where = f"{tested.sensor.name}, simulated presses"
    return CheckReport("place method", name, where, results, len(PLACE_CHECKS) - len(results))


def _expected_failures(
    worker: CheckWorker, name: str, checks: Sequence[Check]
) -> Mapping[str, str]:
    """Return the reasons that the method gives for its failures; none if it cannot be asked."""
    try:
        reply = worker.request("expected_failures")
    except BrokenError:  # every check will say so
        return {}
    if reply.failure is not None:
        raise InputError(
            f"The expected_failures of {name!r} should map names of checks to reasons."
        )
    try:
        expected: Mapping[str, str] = answer_of(dict[str, str], reply, "expected_failures")
    except BrokenError:
        return {}
    known = [check.__name__ for check in checks]
    for check in expected:
        if check not in known:
            raise unknown_name(f"check among the expected failures of {name!r}:", check, known)
    return expected


def check_operator(name: str, *, plugin: Path | None = None) -> CheckReport:
    """Run every check on the operator `name`, taken from the file `plugin` if one is given.

    Raises:
        InputError: an unknown operator (the nearest name is suggested).
    """
    if plugin is None and name not in (known := operators()):
        raise unknown_name("operator", name, known)
    with tempfile.TemporaryDirectory() as folder:
        worker = CheckWorker(OperatorCheckService(name, plugin), LIMIT_S, Path(folder) / "log")
        try:
            height, width = answer_of(tuple[int, int], worker.renew(), "set-up")
            where = f"{SMALL.sensor}, {height} x {width}"
        except BrokenError:  # every check will say so
            where = SMALL.sensor
        try:
            results = run_checks(OPERATOR_CHECKS, partial(_run_in, worker), {})
        finally:
            worker.close()
    return CheckReport("operator", name, where, results, len(OPERATOR_CHECKS) - len(results))


def _run_in(worker: CheckWorker, check: Check) -> str | None:
    """Run one check of an operator in its worker; an error that it raises is its finding."""
    reply = worker.request("run", check)
    if reply.failure is not None:
        # No other check can run on an operator that cannot be evaluated.
        kind = GivenUpError if check is operator_checks.shapes else BrokenError
        raise kind(f"it raises {reply.failure.message.rstrip('.')}.", reply.failure.trace)
    found = answer_of(dict[str, str | None], reply, check.__name__)
    if "skipped" in found:
        raise SkippedError(found["skipped"])
    if "broken" in found:
        raise BrokenError(found["broken"])
    measured: str | None = found.get("measured")
    return measured
