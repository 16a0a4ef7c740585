"""Selection of hyper-parameters on the validation split, with the same budget for every method.

The rule is `selection.RULE`. Optuna writes every trial to a journal beside the records as soon as
it is done, so that a tuning that was killed continues; the journals are removed at the end.
"""

import logging
import threading
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from eitbench.benchmark.rundir.lock import locked
from eitbench.benchmark.rundir.manifest import git_commit, versions
from eitbench.benchmark.rundir.plan import Plan
from eitbench.benchmark.tuning.selection import (
    FRAMES,
    P_WORSE,
    EndedBy,
    Selection,
    Trial,
    TuningBudget,
    record,
    validation_key,
)
from eitbench.benchmark.tuning.sweep import (
    INTERRUPTED,
    STATUSES,
    SearchSpace,
    SweepSampler,
    ended,
)
from eitbench.benchmark.tuning.trials import (
    LEAST_PRESSES,
    PARTS,
    BudgetSpentError,
    Validation,
    choose_by_chance,
    ranked_by,
    run_trial,
)
from eitbench.benchmark.workers.worker import StoppedError
from eitbench.methods.registry import methods
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.guard import closed_test_split
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario
from eitbench.scenarios.suites.suite import Suite

_log = logging.getLogger(__name__)

JOURNALS = "journals"


@dataclass(frozen=True)
class TuningTask:
    """One study: a method, tuned on one scenario or on several together; `code` as in `Plan`."""

    scenarios: tuple[Scenario, ...]
    method: str
    plugin: Path | None
    code: str
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
    suite, names = plan.suite, plan.methods
    folder.mkdir(parents=True, exist_ok=True)
    with closed_test_split(), locked(folder):
        asked = [suite.familiar(s) for s in suite.scenarios if s.name in plan.scenarios]
        figures = {scenario.name: _figure(scenario) for scenario in asked}
        different = {validation_key(s): s for s in reversed(asked) if figures[s.name]}
        if not different:
            raise DataUnavailableError(_nothing_to_tune_on(asked))
        groups: dict[str, list[Scenario]] = {}
        for scenario in reversed(different.values()):
            key = figures[scenario.name] if once else scenario.name
            groups.setdefault(key, []).append(scenario)
        plugins = {name: file.path for name, file in plan.origins.items()}
        studies = [
            TuningTask(
                tuple(group),
                name,
                plugins.get(name),
                plan.code(name),
                plan.suite,
                budget or TuningBudget(),
            )
            for group in groups.values()
            for name in names
        ]
        used: set[Path] = set()
        yield from _run_all(studies, folder, jobs, used)
        # Others are of tunings that were stopped.
        for journal in used:
            journal.unlink(missing_ok=True)


def _run_all(
    studies: Sequence[TuningTask], folder: Path, jobs: int, used: set[Path]
) -> Iterator[tuple[str, str, Selection]]:
    stop = threading.Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            journals = folder / JOURNALS
            futures = [pool.submit(select, study, journals, stop, used) for study in studies]
            refused: InputError | None = None
            for study, future in zip(studies, futures, strict=True):
                try:
                    selection = future.result()
                except InputError as error:  # the others go on
                    if refused is not None:
                        _log.warning("%s", error)
                    refused = refused or error
                    continue
                if selection is not None:
                    for scenario in study.scenarios if selection.figure is not None else ():
                        record(scenario, {study.method: selection}, folder)
                    yield study.name, study.method, selection
            if refused is not None:
                raise refused
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)


def _nothing_to_tune_on(scenarios: Sequence[Scenario]) -> str:
    if any(isinstance(scenario, RecordedScenario) for scenario in scenarios):
        return (
            "There is nothing to tune on: recorded sets are not here (eitbench recordings fetch), "
            "or the scenarios have no validation samples, or too few."
        )
    return "There is nothing to tune on: give a scenario of the suite validation samples."


def _figure(scenario: Scenario) -> str:
    """The figure that validation data are ranked by; "" if there is none, or too few data."""
    try:
        data = load(scenario, split="validation", limit=LEAST_PRESSES)
        if choose_by_chance(data):
            _log.warning(
                "Scenario %r is left out: parameters that are chosen on %d presses are chosen by "
                "chance. At least %d are needed; every fifth touch of a recording is one of them.",
                scenario.name,
                len(data),
                LEAST_PRESSES,
            )
            return ""
        return "" if data.truth == "none" else ranked_by(data)
    except DataUnavailableError as error:
        _log.warning("Scenario %r is left out: %s", scenario.name, error)
    except InputError as error:
        _log.warning("Scenario %r is left out: %s", scenario.name, error)
    return ""


def select(
    study: TuningTask,
    journals: Path,
    stop: threading.Event | None = None,
    used: set[Path] | None = None,
) -> Selection | None:
    """Run `study`, continued from its journal if there is one; None without a search space.

    The journal is in the folder `journals`; its path is added to `used`.

    Raises:
        InputError: the method cannot be tuned.
        StoppedError: `stop` was set; finished trials are in the journal.
    """
    cls = methods().get(study.method)
    if study.plugin is None and cls is not None and not cls.search:
        return None
    stop = stop or threading.Event()
    with ExitStack() as stack:
        validations = []
        for scenario in study.scenarios:
            validation = Validation(scenario, study.method, study.plugin, study.suite, stop)
            stack.callback(validation.close)
            if len(study.scenarios) > 1:
                validation.standardise()
            validations.append(validation)
        space = _search_space(validations[0])
        if space is None:
            return None
        key = _key(study, space)
        journal = journals / f"{_made_by(study, key)[:32]}.log"
        if used is not None:
            used.add(journal)
        searched = _opened(journal, key, space)
        ended_by = _search(searched, space, validations, study.budget, stop)
        trials = _trials(searched, space)
        # The first of equals; the defaults where nothing gave a figure.
        known = [(t.figure, t.parameters) for t in trials if t.figure is not None]
        default = (None, space.parameters(space.start))
        figure, parameters = max(known, key=itemgetter(0), default=default)
        names = tuple(scenario.name for scenario in study.scenarios)
        once = len(names) > 1
        return Selection(
            parameters,
            figure,
            trials,
            study.budget,
            ended_by,
            once_for=names if once else (),
            ranked_by="" if once else ranked_by(validations[0].data),
            code=study.code,
        )


def _search_space(validation: Validation) -> SearchSpace | None:
    found = validation.search()
    return None if found is None else SearchSpace.of(*found)


def _made_by(study: TuningTask, key: str) -> str:
    """SHA-256 (hex) of a study and of what its trials depend on beside: they are not continued
    with other limits or other code."""
    suite = study.suite
    limits = [suite.fit_limit_s, suite.frame_limit_s, suite.memory_limit_mb]
    return content_hash(
        {
            "study": key,
            "limits": limits,
            "versions": versions(),
            "commit": git_commit(),
        }
    )


def _key(study: TuningTask, space: SearchSpace) -> str:
    """Return the SHA-256 (hex) of what decides which trials a study makes."""
    return content_hash(
        {
            "validation": [validation_key(scenario) for scenario in study.scenarios],
            "method": study.method,
            "code": study.code,
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
        parameters = space.parameters(space.point(trial.params))
        try:
            result = run_trial(trial, parameters, validations, budget.seconds - spent)
        except BudgetSpentError:  # with more time it is tried again
            trial.set_user_attr(INTERRUPTED, True)
            study.tell(trial, state=TrialState.FAIL)
            return "seconds"
        trial.set_user_attr("seconds", result.seconds)
        trial.set_user_attr("message", result.message)
        (state,) = (state for state, status in STATUSES.items() if status == result.status)
        study.tell(trial, result.figure, state=state)


def _trials(study: optuna.Study, space: SearchSpace) -> tuple[Trial, ...]:
    """Return the trials of the study, in order."""
    return tuple(
        Trial(
            space.parameters(point),
            trial.value if trial.state == TrialState.COMPLETE else None,
            STATUSES[trial.state],
            float(trial.user_attrs["seconds"]),
            str(trial.user_attrs["message"]),
        )
        for point, trial in ended(study, space)
    )
