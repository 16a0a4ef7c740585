"""Does a method keep the contract? Small checks that a plugin's own tests can run.

Every check asks a worker process, so a method that hangs or dies fails its checks and nothing else.
"""

import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from eitbench.benchmark.checks import method_interface as contract
from eitbench.benchmark.checks import method_physics as physics
from eitbench.benchmark.checks import method_process as manners
from eitbench.benchmark.checks.checking import (
    LIMIT_S,
    BrokenError,
    CheckReport,
    all_outcomes,
    held_to,
)
from eitbench.benchmark.checks.method_under_test import OWN_GRID, SCENARIO, MethodUnderTest
from eitbench.methods.registry import methods as known_methods
from eitbench.scenarios.errors import InputError, unknown_name

# "The same twice" takes another worker, so it comes after what compares with the first one's
# images. Those of what the processes were seen to do come after all that make them do something.
# Those that may cost the worker, by taking too long, come last.
CHECKS: dict[str, Callable[[MethodUnderTest], str | None]] = {
    "returns (n, H, W)": contract.shape,
    "returns real numbers": contract.dtype,
    "returns finite values": contract.finite,
    "a batch equals its single frames": contract.batch_equals_single,
    "the order of frames does not matter": contract.order,
    "the global seed does not matter": contract.seed,
    "leaves the global random state alone": contract.random_state,
    "leaves its input unchanged": contract.unchanged_input,
    "refuses frames of the wrong length": contract.wrong_length,
    "refuses frames with NaN": contract.nan_voltages,
    "zero contrast gives the background": physics.zero_contrast,
    "a resistive contact is negative": physics.resistive,
    "a conductive contact is positive": physics.conductive,
    "small contrasts are nearly linear": physics.linear,
    "rotation equivariance": physics.rotation,
    "mirror equivariance": physics.mirror,
    "gain invariance": physics.gain,
    "noise is not blown up": physics.noise,
    "memory does not grow": manners.memory,
    "the same twice": contract.deterministic,
    "prints nothing": manners.quiet,
    "the thread count does not matter": manners.threads,
    "uses no network": manners.no_network,
    "writes nothing elsewhere": manners.no_writing,
    "starts no other program": manners.no_programs,
    "answers within the time limit": manners.in_time,
}


def check_method(name: str, *, plugin: Path | None = None, limit_s: float = LIMIT_S) -> CheckReport:
    """Run every check on the method `name`, taken from the file `plugin` if one is given.

    Args:
        limit_s: seconds that fitting, and each answer, may take.

    Raises:
        InputError: an unknown method (the nearest name is suggested), or one that expects to fail
            a check that does not exist, or for no reason.
    """
    if plugin is None and name not in (known := known_methods()):
        raise unknown_name("method", name, known)
    with tempfile.TemporaryDirectory() as folder:
        tested = MethodUnderTest(SCENARIO, name, plugin, limit_s, Path(folder))
        if tested.refuses_sensor:
            tested = MethodUnderTest(OWN_GRID, name, plugin, limit_s, Path(folder))
        try:
            expected = _expected_failures(tested, name)
            results = all_outcomes(
                (title, partial(check, tested)) for title, check in CHECKS.items()
            )
        finally:
            tested.worker.restart()
    height, width = tested.sensor.image_shape
    where = f"{tested.sensor.name}, {height} x {width}"
    return CheckReport("method", name, where, held_to(results, expected))


def _expected_failures(tested: MethodUnderTest, name: str) -> Mapping[str, str]:
    """The checks that the method says it fails, and why; none if it cannot be asked.

    Raises:
        InputError: they are no such thing.
    """
    try:
        expected: Mapping[str, str] | None = tested.worker.ask("expected_failures").value
    except BrokenError:  # which every check will say
        return {}
    if expected is None:
        raise InputError(
            f"The expected_failures of {name!r} should map names of checks to reasons."
        )
    for title, reason in expected.items():
        if title not in CHECKS:
            raise unknown_name(f"check among the expected failures of {name!r}:", title, CHECKS)
        if not reason.strip():
            raise InputError(f"{name!r} expects to fail {title!r} but gives no reason: say why.")
    return expected
