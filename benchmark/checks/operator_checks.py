"""Does an operator keep the contract? One list of checks for all, run in a worker process."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from eitbench.benchmark.checks import operator_interface as contract
from eitbench.benchmark.checks import operator_mathematics as laws
from eitbench.benchmark.checks.checking import (
    LIMIT_S,
    BrokenError,
    CheckReport,
    CheckResult,
    RestartingWorker,
    SkippedError,
    outcome,
)
from eitbench.benchmark.checks.operator_under_test import SMALL, OperatorUnderTest
from eitbench.benchmark.workers.worker import Failure, Reply, describe_exception
from eitbench.methods.operator import Operator
from eitbench.methods.registry import load_plugin, operator, operators
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.errors import EitbenchError, unknown_name
from eitbench.scenarios.sensors.sensor import Sensor

CHECKS: dict[str, Callable[[OperatorUnderTest], str | None]] = {
    "has a description and a source": contract.described,
    "returns (..., M) for images (..., H, W)": contract.shapes,
    "a batch equals its single images": contract.batch_equals_single,
    "the same twice": contract.deterministic,
    "leaves its input unchanged": contract.unchanged_input,
    "takes and returns torch tensors": contract.torch_tensors,
    "takes and returns JAX arrays": contract.jax_arrays,
    "keeps float32 and float64": contract.precision_kept,
    "float32 agrees with float64": contract.single_precision,
    "the background gives the untouched sensor": laws.untouched,
    "the gradient equals central differences": laws.differences,
    "the vjp is the adjoint of the Jacobian": laws.adjoint,
    "torch.autograd goes through": laws.autograd,
    "jax.jit, vmap and grad go through": contract.jax_transforms,
    "obeys reciprocity": laws.reciprocity,
    "obeys the scaling law": laws.scaling,
    "refuses pixels that are not above 0": contract.refuses_pixels,
    "refuses another image grid": contract.refuses_grids,
    "refuses float16 and whole numbers": contract.refuses_precisions,
    "refuses cotangents of another shape": contract.refuses_cotangents,
}


class OperatorChecker:
    """Checks the operator `name`, of the file `plugin` if one is given, inside a worker."""

    def __init__(self, name: str, plugin: Path | None = None) -> None:
        self._name = name
        self._plugin = plugin
        self._subject: OperatorUnderTest | None = None

    def set_up(self) -> Reply:
        """Make the operator."""
        if self._plugin is not None:
            load_plugin(self._plugin)
        self._subject = checked(partial(operator, self._name))
        return Reply(None, 0.0)

    def image_shape(self) -> Reply:
        """(H, W) of the sensor it was made for."""
        assert self._subject is not None
        return Reply(self._subject.sensor.image_shape, 0.0)

    def check(self, name: str) -> Reply:
        """The `CheckResult` of the check `name`."""
        assert self._subject is not None
        return Reply(result(name, self._subject), 0.0)


def result(name: str, tested: OperatorUnderTest) -> CheckResult:
    """The result of the check `name`; an operator that raises something else fails it."""

    def check() -> str | None:
        try:
            return CHECKS[name](tested)
        except (BrokenError, SkippedError):
            raise
        except Exception as error:
            raise BrokenError(_raised(describe_exception(error))) from error

    return outcome(name, check)


def _raised(failure: Failure) -> str:
    return f"it raises {failure.message.rstrip('.')}."


def checked(make: Callable[[Sensor], Operator]) -> OperatorUnderTest:
    """The operator for a small sensor where it can be made for one, else for the default one."""
    small = SMALL.nominal_sensor
    try:
        return OperatorUnderTest(make, small)
    except EitbenchError:  # it exists for certain sensors only, such as one it was trained for
        return OperatorUnderTest(make, sensor_by_name(small.name))


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
        worker = RestartingWorker(OperatorChecker(name, plugin), limit_s, Path(folder) / "log")

        def asked(title: str) -> CheckResult:
            try:
                reply = worker.ask("check", title)
            except BrokenError as lost:
                return CheckResult(title, "failed", str(lost))
            if reply.failure is not None:  # such as SystemExit
                return CheckResult(title, "failed", _raised(reply.failure))
            found: CheckResult = reply.value
            return found

        try:
            height, width = worker.ask("image_shape").value
            where = f"{SMALL.sensor}, {height} x {width}"
        except BrokenError:  # which every check will say
            where = SMALL.sensor
        try:
            results = tuple(asked(title) for title in CHECKS)
        finally:
            worker.restart()
    return CheckReport("operator", name, where, results)
