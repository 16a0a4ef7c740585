"""Harness shared by the checks of methods and of operators: results, reports, the worker."""

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from eitbench.benchmark.workers.messages import Reply, WorkerLostError, array_in, parsed
from eitbench.benchmark.workers.restarting import RESTARTS, RestartingWorker, SetUpFailedError
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.errors import counted

LIMIT_S = 60.0

MEMORY_MIB = 4.0
"""Allowed growth of memory, which allocators keep for later.

It is two huge pages of Linux. A method that keeps its images of 40 x 40 pixels, in double
precision, grows by 7 MiB over 600 frames; a slow one is asked for fewer, so that it has to keep
more of each to be found.
"""

# What was seen, and what to do instead.
NO_NETWORK = "it uses the network", "methods work without one"
NO_WRITING = (
    "it writes or changes files elsewhere",
    "`tempfile` is where a method may write",
)
NO_PROGRAMS = (
    "it starts other programs",
    "what they do cannot be watched, so give the reason in `expected_failures`",
)

Status = Literal["passed", "failed", "xfail", "skipped"]

Check = Callable[[Any], str | None]
"""Function whose name is the identifier of a check, and the first line of its docstring the title.

It returns the measured value, or raises `BrokenError` or `SkippedError`.
"""


@dataclass(frozen=True)
class CheckResult:
    """Result of one check.

    Attributes:
        check: its identifier, which `expected_failures` refers to.
        name: its title.
        status: "skipped" where it does not apply, "xfail" where it failed as it was expected to.
        message: the finding, the reason why it was skipped, or the measured value; may be empty.
        trace: where the method or operator raised an error, as lines of a traceback.
    """

    check: str
    name: str
    status: Status
    message: str = ""
    trace: str = ""


@dataclass(frozen=True)
class CheckReport:
    """Results of all checks of one method or operator.

    Attributes:
        kind: "method", "place method" or "operator".
        name: registry name.
        where: the sensor that was checked on, for people.
        untried: number of checks that were left out, as it does not work at all.
    """

    kind: str
    name: str
    where: str
    results: tuple[CheckResult, ...]
    untried: int = 0

    def having(self, status: Status) -> tuple[CheckResult, ...]:
        """Return the results with that status."""
        return tuple(result for result in self.results if result.status == status)

    @property
    def failed(self) -> tuple[CheckResult, ...]:
        """Checks that failed."""
        return self.having("failed")

    @property
    def passed(self) -> bool:
        """True if no check failed."""
        return not self.failed

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of checks: ran, passed, failed, failed as expected, skipped, not tried."""
        counts = {status: len(self.having(status)) for status in get_args(Status)}
        ran = len(self.results) - counts["skipped"]
        return {"ran": ran, **counts, "untried": self.untried}

    def describe(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return {
            self.kind: self.name,
            "sensor": self.where,
            **self.counts,
            "checks": [vars(result) for result in self.results],
        }

    def summary(self) -> str:
        """Return one line with the counts."""
        n = self.counts
        expected = f", {n['xfail']} failed as expected" if n["xfail"] else ""
        skipped = f", {n['skipped']} skipped" if n["skipped"] else ""
        untried = f", {n['untried']} not tried for that reason" if n["untried"] else ""
        return (
            f"{self.name} on {self.where}: {counted(n['ran'], 'check')} ran, {n['passed']} passed, "
            f"{n['failed']} failed{expected}{skipped}{untried}."
        )


class BrokenError(Exception):
    """Finding of a check, as a sentence; `trace` as for `CheckResult`."""

    def __init__(self, sentence: str, trace: str = "") -> None:
        super().__init__(sentence)
        self.trace = trace


class GivenUpError(BrokenError):
    """Finding after which no other check can run."""


class SkippedError(Exception):
    """Reason why a check does not apply, as a sentence."""


def answered(reply: Reply) -> Any:
    """Return the value of a `reply`, which must not be a failure."""
    if reply.failure is not None:
        raise BrokenError(f"{reply.failure.message.rstrip('.')}.", reply.failure.trace)
    return reply.value


def answer_of(kind: Any, reply: Reply, what: str) -> Any:
    """Return the value of a `reply`, no failure and of the type `kind`."""
    try:
        return parsed(TypeAdapter(kind), answered(reply), what)
    except WorkerLostError as lost:
        raise BrokenError(f"{lost.failure.message}.") from lost


def images_of(reply: Reply, shape: tuple[int, ...], what: str) -> Images:
    """Return the images of a `reply`, no failure and of that `shape`."""
    return array_of(reply, np.float32, shape, what)


def array_of(reply: Reply, dtype: type, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    """Return the array of a `reply`, no failure and of that `dtype` and `shape`."""
    try:
        return array_in(answered(reply), dtype, shape, what)
    except WorkerLostError as lost:
        raise BrokenError(f"{lost.failure.message}.") from lost


def require(condition: bool, sentence: str) -> None:
    """Raise a `BrokenError` unless `condition` holds."""
    if not condition:
        raise BrokenError(sentence)


def require_refusal(reply: Reply, what: str, advice: str) -> None:
    """Require that the answer to a wrong input is a `ValueError`; `advice` says what raises one."""
    require(
        reply.failure is not None and "ValueError" in reply.failure.kinds,
        f"{what} should raise a ValueError that says what is wrong; {advice}",
    )


def require_own_generators(changed: Mapping[str, Sequence[str]]) -> None:
    """Require that no step has `changed` a global random generator: others depend on them."""
    for step, generators in changed.items():
        require(
            not generators,
            f"{step} changes the global random generator of {' and '.join(generators)}: "
            "use a generator of your own.",
        )


def require_unseen(noted: Sequence[str], what: str, advice: str) -> None:
    """Require that nothing was `noted` while the method was loaded, fitted and asked."""
    more = f" and {len(noted) - 1} more" if len(noted) > 1 else ""
    require(not noted, f"{what} ({noted[0]}{more}): {advice}." if noted else "")


def require_quiet(log: Path, ask: Callable[[], object], what: str) -> None:
    """Require that nothing is printed into `log` while it is asked, between lines of others."""
    before = log.stat().st_size
    ask()
    text = log.read_bytes()[before:].decode(errors="replace").strip()
    require(not text, f"{what} prints: {text[:80]!r}.")


def steady_memory(answer: Callable[..., Any], frames: Array, what: str) -> str:
    """Require that memory does not grow over many frames (n, M), and say by how much it does."""
    calls, mib = answer(tuple[int, float], "repeat", frames)
    if mib > MEMORY_MIB:
        calls, mib = answer(tuple[int, float], "repeat", frames, calls)
    said = (
        f"memory grows by {max(mib, 0.0):.2g} MiB over {calls} {what}; {MEMORY_MIB:g} is allowed."
    )
    require(mib <= MEMORY_MIB, said)
    return said


def checks_in(module: ModuleType) -> list[Check]:
    """Return the checks of a module: its own public functions, in the order they are written."""
    own = (f for f in vars(module).values() if getattr(f, "__module__", "") == module.__name__)
    return [f for f in own if inspect.isfunction(f) and not f.__name__.startswith("_")]


def title(check: Check) -> str:
    """Return the title of a check, as a part of a sentence."""
    line = first_line(check).rstrip(".")
    return line[0].lower() + line[1:]


def run_checks(
    checks: Sequence[Check], run: Callable[[Check], str | None], expected: Mapping[str, str]
) -> tuple[CheckResult, ...]:
    """Run `checks` in order, where some are `expected` to fail, each for a reason.

    An expectation that is not met is a failure, so that none outlives its reason. After a
    `GivenUpError` the rest is left out.

    Args:
        run: runs one check.
        expected: reasons by identifier.
    """
    results: list[CheckResult] = []
    for check in checks:
        reason = expected.get(check.__name__, "").rstrip(".")
        status: Status = "passed"
        trace = ""
        try:
            message = run(check) or ""
            if reason:
                status = "failed"
                message = (
                    f"it passes although it is expected to fail ({reason}): remove it from "
                    "`expected_failures`."
                )
        except SkippedError as skipped:
            status, message = "skipped", str(skipped)
        except GivenUpError as finding:
            failed = CheckResult(
                check.__name__, title(check), "failed", str(finding), finding.trace
            )
            return (*results, failed)
        except BrokenError as finding:
            status, message, trace = "failed", str(finding), finding.trace
            if reason:
                status, message = "xfail", f"{message} Expected: {reason}."
        results.append(CheckResult(check.__name__, title(check), status, message, trace))
    return tuple(results)


class CheckWorker(RestartingWorker):
    """The worker of a method or operator under test; losing it is the finding of a check.

    Attributes:
        set_up_s: time that the last set-up took [s].
    """

    def __init__(self, service: object, limit_s: float, log: Path) -> None:
        """Prepare a worker; `limit_s` is for set-up and for each answer [s]."""
        super().__init__(service, set_up_limit_s=limit_s, log=log)
        self._limit_s = limit_s
        self._given_up: GivenUpError | None = None

    def start(self) -> Reply:
        """Start the worker, and return the answer of its set-up."""
        reply = super().start()
        self.set_up_s = reply.seconds
        return reply

    def request(self, *request: object) -> Reply:
        """Return the answer to `request`.

        Raises:
            BrokenError: the service died.
            GivenUpError: it cannot be set up, hangs or keeps dying, and is not asked again.
        """
        if self._given_up is not None:
            raise self._given_up
        with self._losses_found():
            return self.ask(*request, limit=self._limit_s, what=str(request[0]))

    def answer(self, kind: Any, *request: object) -> Any:
        """Return the answer to `request`, a value of the type `kind`; no failure."""
        return answer_of(kind, self.request(*request), str(request[0]))

    def renew(self) -> Reply:
        """Start another worker in the place of this one, and return the answer of its set-up.

        Raises:
            GivenUpError: the service could not be set up in it.
        """
        with self._losses_found():
            return self.start()

    @contextmanager
    def _losses_found(self) -> Iterator[None]:
        try:
            yield
        except WorkerLostError as lost:
            message = f"{lost.failure.message.rstrip('.')}."
            if isinstance(lost, SetUpFailedError):
                message = f"set-up failed with {message}"
            if lost.failure.status == "timeout" or self.history.restarts >= RESTARTS:
                self._given_up = GivenUpError(message, lost.failure.trace)
                raise self._given_up from lost
            raise BrokenError(message, lost.failure.trace) from lost
