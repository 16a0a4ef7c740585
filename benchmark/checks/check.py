"""Entry points of `eitbench check`: the checks of methods and of operators, each run in a worker.

A method or operator that hangs or dies fails its checks and nothing else.
"""

import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from eitbench.benchmark.checks import method_interface, method_physics, operator_checks
from eitbench.benchmark.checks.harness import (
    LIMIT_S,
    BrokenError,
    CheckReport,
    Checks,
    CheckWorker,
    run_checks,
)
from eitbench.benchmark.checks.method_under_test import OWN_GRID, SCENARIO, MethodUnderTest
from eitbench.benchmark.checks.operator_under_test import SMALL, OperatorCheckService
from eitbench.benchmark.workers.worker import plugin_names
from eitbench.methods.registry import methods, operators
from eitbench.scenarios.errors import InputError, unknown_name

# `deterministic` takes another worker, so it comes after what compares with the first one's images.
# Checks of what the processes were seen to do come after all that make them do something.
# Those that may cost the worker, by taking too long, come last.
METHOD_CHECKS: Checks = {
    method_interface.shape: "returns (n, H, W)",
    method_interface.dtype: "returns real numbers",
    method_interface.finite: "returns finite values",
    method_interface.batch_equals_single: "a batch equals its single frames",
    method_interface.order: "the order of frames does not matter",
    method_interface.seed: "the global seed does not matter",
    method_interface.random_state: "leaves the global random state alone",
    method_interface.unchanged_input: "leaves its input unchanged",
    method_interface.wrong_length: "refuses frames of the wrong length",
    method_interface.nan_voltages: "refuses frames with NaN",
    method_physics.zero_contrast: "zero contrast gives the background",
    method_physics.resistive_contact: "a resistive contact is negative",
    method_physics.conductive_contact: "a conductive contact is positive",
    method_physics.linearity: "small contrasts are nearly linear",
    method_physics.rotation_equivariance: "rotation equivariance",
    method_physics.mirror_equivariance: "mirror equivariance",
    method_physics.gain_invariance: "gain invariance",
    method_physics.noise_growth: "noise is not blown up",
    method_interface.memory: "memory does not grow",
    method_interface.deterministic: "the same twice",
    method_interface.quiet: "prints nothing",
    method_interface.threads: "the thread count does not matter",
    method_interface.no_network: "uses no network",
    method_interface.no_writing: "writes nothing elsewhere",
    method_interface.no_programs: "starts no other program",
    method_interface.in_time: "answers within the time limit",
}
OPERATOR_CHECKS: Checks = {
    operator_checks.described: "has a description and a source",
    operator_checks.shapes: "returns (..., M) for images (..., H, W)",
    operator_checks.batch_equals_single: "a batch equals its single images",
    operator_checks.deterministic: "the same twice",
    operator_checks.unchanged_input: "leaves its input unchanged",
    operator_checks.torch_tensors: "takes and returns torch tensors",
    operator_checks.jax_arrays: "takes and returns JAX arrays",
    operator_checks.precision_kept: "keeps float32 and float64",
    operator_checks.single_precision: "float32 agrees with float64",
    operator_checks.reference_voltages: "the background gives the untouched sensor",
    operator_checks.differences: "the gradient equals central differences",
    operator_checks.adjoint: "the vjp is the adjoint of the Jacobian",
    operator_checks.autograd: "torch.autograd goes through",
    operator_checks.jax_transforms: "jax.jit, vmap and grad go through",
    operator_checks.reciprocity: "obeys reciprocity",
    operator_checks.scaling: "obeys the scaling law",
    operator_checks.refuses_pixels: "refuses pixels that are not above 0",
    operator_checks.refuses_grids: "refuses another image grid",
    operator_checks.refuses_precisions: "refuses float16 and whole numbers",
    operator_checks.refuses_cotangents: "refuses cotangents of another shape",
}


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
            expected = _expected_failures(tested.worker, name)
            results = run_checks(METHOD_CHECKS, lambda check: check(tested), expected)
        finally:
            tested.worker.close()
    height, width = tested.sensor.image_shape
    return CheckReport("method", name, f"{tested.sensor.name}, {height} x {width}", results)


def _expected_failures(worker: CheckWorker, name: str) -> Mapping[str, str]:
    """Return the reasons that the method gives for its failures; none if it cannot be asked.

    Raises:
        InputError: they are no reasons, or of checks that do not exist.
    """
    try:
        expected: Mapping[str, str] | None = worker.request("expected_failures").value
    except BrokenError:  # every check will say so
        return {}
    if expected is None:
        raise InputError(
            f"The expected_failures of {name!r} should map names of checks to reasons."
        )
    known = [check.__name__ for check in METHOD_CHECKS]
    for check, reason in expected.items():
        if check not in known:
            raise unknown_name(f"check among the expected failures of {name!r}:", check, known)
        if not reason.strip():
            raise InputError(f"{name!r} expects to fail {check!r} but gives no reason: say why.")
    return expected


def check_operator(
    name: str, *, plugin: Path | None = None, limit_s: float = LIMIT_S
) -> CheckReport:
    """Run every check on the operator `name`, taken from the file `plugin` if one is given.

    Args:
        limit_s: seconds that making it, and each check, may take.

    Raises:
        InputError: an unknown operator (the nearest name is suggested).
    """
    if plugin is None and name not in (known := operators()):
        raise unknown_name("operator", name, known)
    with tempfile.TemporaryDirectory() as folder:
        worker = CheckWorker(OperatorCheckService(name, plugin), limit_s, Path(folder) / "log")
        try:
            height, width = worker.request("image_shape").value
            where = f"{SMALL.sensor}, {height} x {width}"
        except BrokenError:  # every check will say so
            where = SMALL.sensor
        try:
            results = run_checks(OPERATOR_CHECKS, partial(_run_in, worker), {})
        finally:
            worker.close()
    return CheckReport("operator", name, where, results)


def _run_in(worker: CheckWorker, check: Callable[[Any], str | None]) -> str | None:
    """Run one check of an operator in its worker."""
    reply = worker.request("run", check)
    if reply.failure is not None:  # such as SystemExit
        raise BrokenError(f"it raises {reply.failure.message.rstrip('.')}.")
    if isinstance(reply.value, Exception):
        raise reply.value
    measured: str | None = reply.value
    return measured
