"""Selection of hyper-parameters on the validation split, with the same budget for every method.

The rule is `selection.RULE`. Optuna writes every trial to a journal beside the records as soon as
it is done, so that a tuning that was killed continues; the journals are removed at the end.
"""

import logging
import shutil
import threading
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from eitbench.benchmark.rundir.lock import locked
from eitbench.benchmark.rundir.plan import Plan
from eitbench.benchmark.tuning.selection import (
    EndedBy,
    Selection,
    Trial,
    TuningBudget,
    record,
    validation_key,
)
from eitbench.benchmark.tuning.sweep import INTERRUPTED, SearchSpace, SweepSampler, figures
from eitbench.benchmark.tuning.trials import (
    FIGURES,
    FRAMES,
    PARTS,
    Validation,
    run_trial,
)
from eitbench.benchmark.workers.worker import StoppedError
from eitbench.methods.registry import methods
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.guard import closed_test_split
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import Suite

_log = logging.getLogger(__name__)

P_WORSE = 0.02
"""A trial is given up where Wilcoxon's signed-rank test of its frames against those of the best
trial has a smaller p-value. Of the 6 frames of a first third that takes all 6 (p = 1/64)."""
JOURNALS = "journals"


@dataclass(frozen=True)
class TuningTask:
    """One study: a method, tuned on one scenario or on several together."""

    scenarios: tuple[Scenario, ...]
    method: str
    plugin: tuple[Path, str] | None
    suite: Suite
    budget: TuningBudget

    @property
    def name(self) -> str:
        """Name of the scenario, or of all of them."""
        return ", ".join(scenario.name for scenario in self.scenarios)


def tune(
    plan: Plan,
    folder: Path,
    *,
    budget: TuningBudget | None = None,
    once: bool = False,
    jobs: int = 1,
) -> Iterator[tuple[str, str, Selection]]:
    """Tune every method of `plan` on every scenario; yield scenario, method and selection.

    A method none of whose trials gave a figure is not recorded.
    Scenarios with the same validation data are tuned once. A recorded set whose data cannot be had
    is left out, with a warning. Until the end the test split is closed in this process, as it is
    in the workers.

    Args:
        plan: methods and scenarios of a suite.
        folder: for the records; a tuning that was stopped there is continued.
        budget: of every study.
        once: select one set of parameters for all scenarios that are ranked by the same figure.
        jobs: number of studies at a time.

    Raises:
        DataUnavailableError: no scenario is left.
        InputError: a method cannot be tuned, or another process tunes in `folder`.
    """
    names = plan.methods
    folder.mkdir(parents=True, exist_ok=True)
    with closed_test_split(), locked(folder):
        asked = [s for s in plan.suite.scenarios if s.name in plan.scenarios]
        different = {validation_key(s): s for s in reversed(asked) if _can_be_tuned_on(s)}
        if not different:
            raise DataUnavailableError(
                "There is nothing to tune on: fetch the recorded sets first."
            )
        digests = dict(plan.plugins)
        plugins = {name: (path, digests[path]) for name, path in plan.origins.items()}
        studies = [
            TuningTask(scenarios, name, plugins.get(name), plan.suite, budget or TuningBudget())
            for scenarios in _groups(list(reversed(different.values())), once)
            for name in names
        ]
        yield from _run_all(studies, folder, jobs)
        shutil.rmtree(folder / JOURNALS, ignore_errors=True)


def _run_all(
    studies: Sequence[TuningTask], folder: Path, jobs: int
) -> Iterator[tuple[str, str, Selection]]:
    stop = threading.Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            futures = [pool.submit(select, study, folder / JOURNALS, stop) for study in studies]
            for study, future in zip(studies, futures, strict=True):
                selection = future.result()
                if selection is not None:
                    for scenario in study.scenarios if selection.figure is not None else ():
                        record(scenario, {study.method: selection}, folder)
                    yield study.name, study.method, selection
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def _can_be_tuned_on(scenario: Scenario) -> bool:
    """True if there are validation data with a figure to select by."""
    try:
        return load(scenario, split="validation", limit=1).truth in FIGURES
    except DataUnavailableError as error:
        _log.warning("Scenario %r is left out: %s", scenario.name, error)
    except InputError:
        _log.warning("Scenario %r is left out: it has no validation samples.", scenario.name)
    return False


def _groups(scenarios: Sequence[Scenario], once: bool) -> list[tuple[Scenario, ...]]:
    """Return groups of scenarios that share a selection: single ones, or all ranked by a figure."""
    if not once:
        return [(scenario,) for scenario in scenarios]
    found: dict[str, list[Scenario]] = {}
    for scenario in scenarios:
        found.setdefault(load(scenario, split="validation", limit=1).truth, []).append(scenario)
    return [tuple(group) for group in found.values()]


def select(
    study: TuningTask, journals: Path, stop: threading.Event | None = None
) -> Selection | None:
    """Run `study`, continued from its journal if there is one; None without a search space.

    Raises:
        InputError: the method cannot be tuned.
        StoppedError: `stop` was set; finished trials are in the journal.
    """
    known = methods().get(study.method)
    if study.plugin is None and known is not None and not known.search:
        return None
    stop = stop or threading.Event()
    plugin = None if study.plugin is None else study.plugin[0]
    with ExitStack() as stack:
        validations = []
        for scenario in study.scenarios:
            validation = Validation(scenario, study.method, plugin, study.suite, stop)
            stack.callback(validation.close)
            if len(study.scenarios) > 1:
                validation.standardise()
            validations.append(validation)
        space = _search_space(validations[0])
        if space is None:
            return None
        key = _key(study, space)
        searched = _opened(journals / f"{key[:32]}.log", key, space)
        ended_by = _search(searched, space, validations, study.budget, stop)
        return _selection(searched, space, study, ended_by)


def _search_space(validation: Validation) -> SearchSpace | None:
    found = validation.search()
    return None if found is None else SearchSpace.of(*found)


def _key(study: TuningTask, space: SearchSpace) -> str:
    """Return the SHA-256 (hex) of all that decides the trials of a study."""
    return content_hash(
        {
            "validation": [validation_key(scenario) for scenario in study.scenarios],
            "method": study.method,
            "plugin": None if study.plugin is None else study.plugin[1],
            "space": [[name, [repr(v) for v in values]] for name, values in space.values.items()],
            "start": list(space.start),
            "rule": [FRAMES, PARTS, P_WORSE],
        }
    )


def _opened(journal: Path, key: str, space: SearchSpace) -> optuna.Study:
    """Return the study in the file `journal`; a trial that was interrupted is tried again."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    journal.parent.mkdir(parents=True, exist_ok=True)
    # Nobody else works here, so that what a killed process left behind can go: its lock, and a
    # line that it had not finished.
    journal.with_name(f"{journal.name}.lock").unlink(missing_ok=True)
    if journal.is_file():
        content = journal.read_bytes()
        journal.write_bytes(content[: content.rfind(b"\n") + 1])
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(journal))),
        study_name=key,
        load_if_exists=True,
        direction="maximize",
        sampler=SweepSampler(space, key),
        pruner=optuna.pruners.WilcoxonPruner(p_threshold=P_WORSE),
    )
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        optuna.Trial(study, trial._trial_id).set_user_attr(INTERRUPTED, True)
        study.tell(trial.number, state=TrialState.FAIL)
    return study


def _search(
    study: optuna.Study,
    space: SearchSpace,
    validations: Sequence[Validation],
    budget: TuningBudget,
    stop: threading.Event,
) -> EndedBy:
    """Try one set of parameters after the other; return the reason of the end."""
    while True:
        done = _trials(study, space)
        spent = sum(trial.seconds for trial in done)
        if len(done) >= space.size:
            return "space"
        if len(done) >= budget.trials:
            return "trials"
        if spent >= budget.seconds:
            return "seconds"
        if stop.is_set():
            raise StoppedError
        trial = study.ask(space.distributions())
        point = tuple(int(trial.params[name]) for name in space.values)
        result = run_trial(trial, space.parameters(point), validations, budget.seconds - spent)
        trial.set_user_attr("seconds", result.seconds)
        trial.set_user_attr("message", result.message)
        states = {"ok": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}
        study.tell(trial, result.figure, state=states[result.status])


def _trials(study: optuna.Study, space: SearchSpace) -> list[Trial]:
    """Return the trials of the study, in order."""
    statuses: dict[TrialState, Literal["ok", "pruned", "failed"]] = {
        TrialState.COMPLETE: "ok",
        TrialState.PRUNED: "pruned",
        TrialState.FAIL: "failed",
    }
    found = []
    for trial in study.get_trials(deepcopy=False, states=tuple(statuses)):
        point, noted = space.point(trial), trial.user_attrs
        if point is not None:
            status = statuses[trial.state]
            found.append(
                Trial(
                    space.parameters(point),
                    trial.value if status == "ok" else None,
                    status,
                    float(noted["seconds"]),
                    str(noted["message"]),
                )
            )
    return found


def _selection(
    study: optuna.Study, space: SearchSpace, what: TuningTask, ended_by: EndedBy
) -> Selection:
    tried = figures(study, space)
    # The first of equals; the defaults where nothing gave a figure.
    best: Any = max(tried, key=lambda point: tried[point], default=space.start)
    if tried.get(best, float("-inf")) == float("-inf"):
        best = space.start
    figure = tried.get(best, float("-inf"))
    return Selection(
        space.parameters(best),
        None if figure == float("-inf") else figure,
        tuple(_trials(study, space)),
        what.budget,
        ended_by,
        tuple(s.name for s in what.scenarios) if len(what.scenarios) > 1 else (),
    )
