"""What notebooks and scripts call: a method of theirs is run and scored as `eitbench run` does."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd

from eitbench.benchmark.analysis.results import failures_with_traces, read_run
from eitbench.benchmark.run.runner import UnfinishedError, make_plan, start_run
from eitbench.methods.method import Method
from eitbench.methods.registry import methods as known_methods
from eitbench.methods.registry import register
from eitbench.reports.tables.columns import shown_columns
from eitbench.reports.tables.leaderboard import ranked_rows
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.suites.suite import Suite, load_suite

AnyMethod = str | type[Method]


def evaluate(
    methods: AnyMethod | Sequence[AnyMethod],
    suite: str | Path | Suite = "quick",
    *,
    scenarios: str | Sequence[str] = (),
    limit: int | None = None,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    jobs: int = 1,
    out: Path | str | None = None,
) -> pd.DataFrame:
    """Run methods on a suite, as `eitbench run` does, and return the leaderboard.

    Every method runs in a worker process, with the limits of the suite, and never sees the test
    split. A class of a notebook or script is sent there as it is now, with the functions and
    values of the notebook that it uses. It is not isolated from the network and from your files,
    and the run keeps no copy of it: put it into a file for a run that you want to publish. A
    script calls this under `if __name__ == "__main__":`, since it starts processes.

    Args:
        methods: names or classes, one or several. A class that is not registered gets a name made
            of its own, `my-method` of `MyMethod`.
        suite: a suite, its name, or the path of its file.
        scenarios: one or several names of those to run; all by default.
        limit: test samples of each scenario; all by default.
        parameters: constructor parameters by the name of the method.
        jobs: cells (scenario x method) at a time.
        out: new folder for the run; by default nothing is kept.

    Returns:
        One row per scenario and method, ranked, with the columns of a leaderboard.

    Raises:
        InputError: no method, an object instead of a class, or an unknown name.
        EitbenchError: it was interrupted, or its folder cannot be written.

    Warns:
        UserWarning: a method failed; the sentence says how, and where an error was raised.
    """
    if isinstance(methods, Method):
        raise InputError(f"Give the class {type(methods).__name__}, not an object of it.")
    asked = [methods] if isinstance(methods, str | type) else methods
    if not asked:
        raise InputError("Name at least one method, or give its class.")
    chosen = suite if isinstance(suite, Suite) else load_suite(suite)
    plan = make_plan(
        chosen,
        methods=[method if isinstance(method, str) else _name(method) for method in asked],
        scenarios=[scenarios] if isinstance(scenarios, str) else scenarios,
        limit=limit,
        parameters=parameters,
    )
    with TemporaryDirectory(prefix="eitbench-") as folder:
        try:
            run = start_run(plan, Path(out or Path(folder) / "run"), jobs=jobs)
        except UnfinishedError as error:
            if out is not None:
                raise
            raise EitbenchError(
                f"{error.reason} Nothing is kept: give `out`, a new folder, to keep the rows that "
                "are finished by then."
            ) from error
        for sentence, trace in failures_with_traces(read_run(run.path)):
            warnings.warn("\n".join([sentence, *trace.splitlines()]), stacklevel=2)
        for sentence in (*run.skipped, *run.refused):
            warnings.warn(sentence, stacklevel=2)
        rows = ranked_rows([run.path])
    columns = [column.name for column in shown_columns(rows)] if rows else []
    return pd.DataFrame(rows, columns=["scenario", *columns])


def _name(cls: type[Method]) -> str:
    """Return the name that `cls` is registered by, after it was given one if it had none."""
    for name, known in known_methods().items():
        if known is cls:
            return name
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", cls.__name__).lower()
    register(name)(cls)
    return name
