"""What checks of methods and of operators share: their findings, and a worker that is renewed."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from eitbench.benchmark.workers.worker import Failure, Reply, Worker, WorkerLostError, serve

LIMIT_S = 60.0
RESTARTS = 3


Status = Literal["passed", "failed", "xfail", "skipped"]


@dataclass(frozen=True)
class CheckResult:
    """One check.

    Attributes:
        name: what was checked.
        status: "skipped" where it does not apply, "xfail" where it failed as it was expected to.
        message: what was wrong, why it was skipped, or what was measured; may be empty.
    """

    name: str
    status: Status
    message: str = ""


@dataclass(frozen=True)
class CheckReport:
    """Every check of one method or operator.

    Attributes:
        kind: "method" or "operator".
        name: registry name.
        where: the sensor that was checked on, for people.
    """

    kind: str
    name: str
    where: str
    results: tuple[CheckResult, ...]

    def having(self, status: str) -> tuple[CheckResult, ...]:
        """The checks of that status."""
        return tuple(result for result in self.results if result.status == status)

    @property
    def failed(self) -> tuple[CheckResult, ...]:
        """The checks that failed."""
        return self.having("failed")

    @property
    def passed(self) -> bool:
        """Whether none failed."""
        return not self.failed

    @property
    def counts(self) -> dict[str, int]:
        """How many ran, passed, failed, failed as expected ("xfail") and were skipped."""
        counts = {status: len(self.having(status)) for status in get_args(Status)}
        return {"ran": len(self.results) - counts["skipped"], **counts}

    def describe(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            self.kind: self.name,
            "sensor": self.where,
            **self.counts,
            "checks": [vars(result) for result in self.results],
        }

    def summary(self) -> str:
        """One line: how many ran, passed, failed and were skipped."""
        n = self.counts
        expected = f", {n['xfail']} failed as expected" if n["xfail"] else ""
        skipped = f", {n['skipped']} skipped" if n["skipped"] else ""
        return (
            f"{self.name} on {self.where}: {n['ran']} checks ran, {n['passed']} passed, "
            f"{n['failed']} failed{expected}{skipped}."
        )


class BrokenError(Exception):
    """A check's finding, as a sentence."""


class SkippedError(Exception):
    """Why a check does not apply, as a sentence."""


def require(condition: bool, sentence: str) -> None:
    """Raise a `BrokenError` unless `condition` holds."""
    if not condition:
        raise BrokenError(sentence)


def outcome(name: str, check: Callable[[], str | None]) -> CheckResult:
    """The result of the check `name`; `check` returns what it measured, or raises its finding."""
    try:
        return CheckResult(name, "passed", check() or "")
    except SkippedError as reason:
        return CheckResult(name, "skipped", str(reason))
    except BrokenError as finding:
        return CheckResult(name, "failed", str(finding))


def held_to(results: Iterable[CheckResult], expected: Mapping[str, str]) -> tuple[CheckResult, ...]:
    """The `results` where some checks are `expected` to fail, each for a reason.

    An expectation that is not met is a failure, so that none outlives its reason.
    """
    held = []
    for result in results:
        reason = expected.get(result.name, "").rstrip(".")
        if reason and result.status == "failed":
            message = f"{result.message} Expected: {reason}."
            result = replace(result, status="xfail", message=message)
        elif reason and result.status == "passed":
            message = f"it passes although it is expected to fail ({reason}): remove it."
            result = replace(result, status="failed", message=message)
        held.append(result)
    return tuple(held)


class RestartingWorker:
    """A worker for a service: started when it is needed, and again when it was lost."""

    def __init__(self, service: object, limit_s: float, log: Path) -> None:
        """`limit_s`: seconds that setting up, and each answer, may take."""
        self._servant = service
        self._limit_s = limit_s
        self._log = log
        self._worker: Worker | None = None
        self._losses = 0
        self._given_up = ""
        self._refusal: Failure | None = None

    def ask(self, *request: object) -> Reply:
        """The answer to `request`.

        Raises:
            BrokenError: it could not be set up, hung or died. One that cannot be set up, hangs or
                keeps dying is not tried again.
        """
        if self._given_up:
            raise BrokenError(self._given_up)
        try:
            if self._worker is None:
                self._worker = self._ready()
            return self._worker.ask(*request, limit=self._limit_s, what=str(request[0]))
        except WorkerLostError as lost:
            self.restart()
            self._losses += 1
            if lost.failure.status == "timeout" or self._losses > RESTARTS:
                self._given_up = f"{lost.failure.message}."
            raise BrokenError(f"{lost.failure.message}.") from lost

    def _ready(self) -> Worker:
        worker = Worker(serve, self._servant, log=self._log)
        try:
            reply = worker.ask("set_up", limit=self._limit_s, what="set-up")
        except WorkerLostError as lost:
            self._given_up = f"{lost.failure.message}."
            raise
        if reply.failure is not None:
            worker.close()
            self._refusal = reply.failure
            self._given_up = f"set-up failed with {reply.failure.message.rstrip('.')}."
            raise BrokenError(self._given_up)
        return worker

    def refused(self, kind: str) -> bool:
        """Whether set-up failed with an error of `kind`, the name of its class or of a base."""
        return self._refusal is not None and kind in self._refusal.kinds

    def restart(self) -> None:
        """Forget the worker; the next question starts another."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None


def all_outcomes(checks: Iterable[tuple[str, Callable[[], str | None]]]) -> tuple[CheckResult, ...]:
    """The results of `checks`, in order."""
    return tuple(outcome(name, check) for name, check in checks)
