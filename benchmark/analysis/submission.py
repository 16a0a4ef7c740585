"""Checks of a run that is submitted to a leaderboard: complete, on our data, scored by us.

Nothing that the directory says of itself is believed where it can be had otherwise: data, truth,
geometry, parameters and weights are ours, figures and the registration are computed again from the
stored images. That the images are those of the method only a rerun tells, see `rerun`.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from packaging.version import InvalidVersion, Version

from eitbench.benchmark.analysis.recording_notes import notes_of
from eitbench.benchmark.analysis.rescore import FIGURES, ROUNDING, rescored
from eitbench.benchmark.analysis.results import (
    NOTES_FILE,
    Run,
    cells_of,
    describe_actions,
    read_run,
)
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.analysis.statement import STATEMENT, read_statement, unfilled
from eitbench.benchmark.metrics.evaluation import fit_registration
from eitbench.benchmark.metrics.novelty import SCORES
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.run.prior_knowledge import stated_overlap
from eitbench.benchmark.run.tracks import cell_entries
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.folder import read_json_file, unknown_entries
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.plan import Plan, plan_of, sha256
from eitbench.benchmark.rundir.run_arrays import TRUTH, names_in, read_validation
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS
from eitbench.benchmark.rundir.tables import columns_of
from eitbench.methods.registry import METHOD_REGISTRY, usable_name
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.similarity import Similarity
from eitbench.scenarios.suites.scenario import RecordedScenario
from eitbench.scenarios.suites.suite import load_suite, suites

LEADERBOARD = "leaderboard.json"
FILES = (
    *(manifests.FILE_NAME, SAMPLES, METHOD_RUNS.table, METHOD_RUNS.arrays),
    *(NOTES_FILE, LEADERBOARD, STATEMENT),
)
"""Of the folder of a submission, beside copies of plugins."""
FOLDER = "submissions"
"""In a version of the leaderboard: SUITE/NAME is a submission."""

CONDITIONS = ("calibration_ms", "calibration_spread", "load", "cpu_mhz")
TIMES = ("frame_ms", "uncertainty_ms", "novelty_ms")
MOST_MEASURED = 1e9
"""Of times, memory and rates, in their units: 11 days of milliseconds, 31 years of seconds."""

CELL_COLUMNS = {
    *("scenario", "method", *METHOD_RUNS.labels, "source", "coverage", "machine", "n"),
    *("parameters", "registration", "load_calibration", "prior_knowledge", "overlap"),
    *("actions", "trace", "uncertainty", *METHOD_RUNS.facts, *METHOD_RUNS.costs, *CONDITIONS),
}
"""Columns of the table of methods."""
SAMPLE_COLUMNS = {
    *("suite", "scenario", "method", *METHOD_RUNS.labels, "sample", "input_hash", "status"),
    *("message", *FIGURES, *TIMES, *UNCERTAINTY, *SCORES),
}
"""Columns of the table of samples, beside those of our data."""

PLAUSIBLE_PSNR_DB = 45.0
"""The best known method has 31 dB on clean data, and the published ones 33."""
PLAUSIBLE_PLACE_MM = 0.1
"""A press is placed by a robot that is not more accurate."""

TRUST = (
    "times and memory (self-reported)",
    "that its version of eitbench was not changed",
    "what methods say of their prior knowledge and differences, what they were seen to do, "
    "parameters and weights of plugins",
    "that the images are what the methods make of the frames",
)
"""What is taken on trust without a rerun; with one, the first only."""


@dataclass(frozen=True)
class Check:
    """One thing that was checked of a submission.

    Attributes:
        name: what was checked.
        problem: what is wrong, as a sentence; "" where nothing is.
    """

    name: str
    problem: str


@dataclass(frozen=True, eq=False)
class Submission:
    """A run that is checked, with its plan; `jobs` processes simulate our data."""

    run: Run
    plan: Plan
    jobs: int

    @cached_property
    def data(self) -> Mapping[str, MethodData]:
        """Our data of every scenario of the suite, by name.

        Raises:
            DataUnavailableError, DataCorruptError: recorded data cannot be had.
        """
        suite = self.plan.suite
        return {
            scenario.name: MethodData.load(
                scenario, suite, self.plan.limit, jobs=self.jobs, progress=False
            )
            for scenario in suite.scenarios
        }

    @property
    def same_numbers(self) -> bool:
        """True if it was made with the versions of NumPy and SciPy that are here.

        Others may give the inputs other last bits.
        """
        theirs, ours = self.run.manifest["versions"], manifests.versions()
        return all(theirs.get(name) == ours[name] for name in ("numpy", "scipy"))


def open_submission(path: Path, *, jobs: int = 1) -> Submission:
    """Read the run directory `path`, to be checked.

    Raises:
        InputError: no run directory, or a run of operators.
        DataCorruptError: a table of the run is damaged.
    """
    run = read_run(path)
    if not run.whole:
        raise InputError(f"{path} is a record, with images of few samples: check its run.")
    if run.kind != METHOD_RUNS:
        raise InputError(f"{path} holds no images: a submission is a run of imaging methods.")
    try:
        return Submission(run, plan_of(run.manifest, path), jobs)
    except InputError as error:
        raise InputError(
            f"{path} cannot be checked: its manifest was changed. Send what the run wrote."
        ) from error


def check_submission(submission: Submission) -> list[Check]:
    """Check a submission by all `CHECKS`, or to the first of `FIRST` that it fails."""
    found = []
    for name, check in CHECKS.items():
        found.append(Check(name, _problem(check, submission)))
        if check in FIRST and found[-1].problem:
            break
    return found


def _problem(check: Callable[[Submission], str], submission: Submission) -> str:
    """Problem that `check` finds; what it cannot read is one."""
    try:
        return check(submission)
    except EitbenchError as error:
        return str(error)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return (
            f"The {manifests.FILE_NAME} or a table lacks an entry that every run writes ({error}): "
            "send what the run wrote."
        )


def _holds_nothing_else(of: Submission) -> str:
    if unknown := unknown_entries(of.run.path):
        return f"The directory holds {unknown[0]!r}, which no run writes: delete it."
    if (of.run.path / TRACKS).is_file():
        return f"The directory holds {TRACKS}, which is not checked: run it without --tracks."
    copies = {plugin.kept.name for plugin in of.plan.plugins}
    folder = of.run.path / "plugins"
    if folder.is_dir() and (more := {path.name for path in folder.iterdir()} - copies):
        return (
            f"The folder 'plugins' holds {min(more)!r}, which does not belong to this run: delete "
            "it."
        )
    for plugin in of.plan.plugins:
        copy = of.run.path / plugin.kept
        if not copy.is_file() or sha256(copy) != plugin.sha256:
            return (
                f"The copy {plugin.kept.as_posix()} of a plugin is missing or was changed: send "
                "what the run wrote."
            )
    if (of.run.path / STATEMENT).is_file():
        folders = {"plugins"} if copies else set()
        for path in of.run.path.iterdir():
            if path.name not in (folders if path.is_dir() else FILES):
                return f"A submission has no {path.name!r}: delete it."
        parents = of.run.path.resolve().parents
        if parents[1].name == FOLDER and parents[0].name != of.plan.suite.name:
            return f"It belongs into {FOLDER}/{of.plan.suite.name}, and not {parents[0].name}."
    return ""


def _says_who(of: Submission) -> str:
    # A run that is no submission yet has none: `submission make` writes it.
    return unfilled(read_statement(of.run.path)) if (of.run.path / STATEMENT).is_file() else ""


def _is_packaged(of: Submission) -> str:
    plan = of.plan
    if plan.suite.name not in suites():
        return (
            f"The suite {plan.suite.name!r} is not one of eitbench's: run one that `eitbench list "
            "suites` shows."
        )
    if plan.suite != load_suite(plan.suite.name):
        return (
            f"The suite {plan.suite.name!r} of this run is not that of this version of eitbench: "
            "run it again."
        )
    return ""


def _names_its_version(of: Submission) -> str:
    stated, ours = of.run.manifest["versions"]["eitbench"], manifests.versions()["eitbench"]
    try:
        newer = Version(stated) > Version(str(ours))
    except InvalidVersion:
        return f"{stated!r} is no version of eitbench."
    if newer:
        return f"Eitbench {stated} made it, and this is {ours}: check it with {stated}."
    commit = of.run.manifest["git_commit"]
    if commit is not None and not re.fullmatch("[0-9a-f]{40}", commit):
        return f"It was made with changed code (git commit {commit}): run it from a clean checkout."
    # Nothing here lists the versions that were released.
    if commit is None and stated != ours:
        return (
            f"Eitbench {stated} made it, with no git commit, and nobody can tell here whether that "
            f"was ever released: run it with {ours}, or from a clean checkout."
        )
    return ""


def _names_are_clear(of: Submission) -> str:
    registered = METHOD_REGISTRY.known()
    known = {folded(name): name for name in registered}
    for name in of.plan.names:
        if not usable_name(name):
            return f"{name!r} cannot name a method."
        if not name.isascii():
            return f"{name!r} is not ASCII: on a public board names are, so that none looks alike."
        # Without a rerun nobody would see that somebody spoilt its images.
        if name in registered and registered[name].__module__.startswith("eitbench."):
            return (
                f"{name!r} is a method of eitbench, which the board has already: run the suite "
                "with your method alone (--methods)."
            )
        if known.setdefault(folded(name), name) != name:
            return f"{name!r} looks like {known[folded(name)]!r}: choose another name."
        if name not in registered and name not in of.plan.origins:
            return (
                f"{name!r} comes from a package that is not installed here: install it, or run "
                "the suite with --plugin."
            )
    return ""


def folded(name: str) -> str:
    """Return what names that look alike have in common: case, separators, digits like letters."""
    plain = unicodedata.normalize("NFKC", name).casefold().translate(_ALIKE)
    return plain.replace("rn", "m").replace("vv", "w")


_ALIKE = str.maketrans({"0": "o", "1": "l", "i": "l", "|": "l", "5": "s", **dict.fromkeys("-_ .")})


def _is_complete(of: Submission) -> str:
    run, plan = of.run, of.plan
    if run.manifest["status"] != "finished":
        return (
            f"The run is {run.manifest['status']}: finish it with `eitbench run --resume "
            f"{run.path}`."
        )
    if plan.limit != plan.suite.limit:
        return (
            f"The run was limited to {plan.limit} samples a scenario: run the suite without "
            "--limit."
        )
    if any(cell["variant"] for cell in run.manifest["cells"]):
        return "The manifest holds cells of other tracks: run it without --tracks."
    samples = {name: len(data.test) for name, data in of.data.items()}
    if manifests.samples_of(run.manifest) != samples:
        return f"The manifest tells other numbers of samples than the scenarios have: {samples}."
    expected = []
    for scenario in plan.suite.scenarios:
        for name in plan.names:
            # A method without weights for a sensor is left out by the run itself.
            if name in plan.origins or not of.data[scenario.name].unusable(name):
                expected.append((scenario.name, name))
    ranked = [(c["scenario"], c["name"]) for c in run.manifest["cells"] if not c["variant"]]
    rows = list(zip(run.cells["scenario"], run.cells["method"], strict=True))
    sampled = [*cells_of(run.samples)]
    for what, there in (("manifest", ranked), ("samples", sampled), ("methods", rows)):
        if missing := [cell for cell in expected if cell not in there]:
            return f"{missing[0][1]!r} was not run on {missing[0][0]!r}."
        if len(there) != len(expected):
            extra = next((cell for cell in there if cell not in expected), there[0])
            return f"{extra[1]!r} on {extra[0]!r} stands in the {what}, but not in the plan."
    for (where, name), of_cell in cells_of(run.samples).items():
        n = len(of.data[where].test)
        if sorted(of_cell["sample"]) != list(range(n)):
            return f"{name!r} on {where!r} should have one row for each sample, 0 to {n - 1}."
    return ""


def _files_hold_nothing_else(of: Submission) -> str:
    run, names = of.run, set[str]()
    described = {column for data in of.data.values() for column in data.test.samples}
    for table, known in ((SAMPLES, SAMPLE_COLUMNS | described), (METHOD_RUNS.table, CELL_COLUMNS)):
        if more := columns_of(run.path / table) - known:
            return f"{table} has a column {min(more)!r}, which no run writes: delete it."
    for scenario, data in of.data.items():
        attributes, arrays = data.truth()
        truth = f"{scenario}/{TRUTH}"
        names |= {scenario, truth, *(f"{truth}/{name}" for name in arrays)}
        names |= {f"{truth}/@{name}" for name in attributes}
    for entry in run.manifest["cells"]:
        cell = f"{entry['scenario']}/{entry['name']}"
        names |= {cell, f"{cell}/sample", f"{cell}/{METHOD_RUNS.array}"}
        if of.data[entry["scenario"]].validation is not None:
            names.add(f"{cell}/validation")
    for name in names_in(run.path / METHOD_RUNS.arrays):
        if name not in names:
            return f"{METHOD_RUNS.arrays} holds {name!r}, which no run writes: delete it."
    return ""


def _measured_is_possible(of: Submission) -> str:
    for table in (of.run.cells, of.run.samples):
        for column in (*METHOD_RUNS.costs, *CONDITIONS, *TIMES):
            for value in table[column].dropna() if column in table else ():
                if not 0 <= value <= MOST_MEASURED:
                    return (
                        f"The column {column!r} holds {value:g}: what is measured is 0 or more, "
                        "and empty where it was not measured."
                    )
    return ""


def _choices_are_ours(of: Submission) -> str:
    labels: dict[tuple[str, str], str] = {}
    for entry in of.run.manifest["cells"]:
        if entry["variant"]:
            continue
        name, data = entry["name"], of.data[entry["scenario"]]
        labels[entry["scenario"], name] = entry["track"]
        (ours, *_) = cell_entries(of.plan, data, name)
        # What was chosen for a plugin, and its weights, are its author's.
        compared = ("track", "parameters", "weights") if name not in of.plan.origins else ()
        for what in compared:
            if entry[what] != ours[what]:
                return (
                    f"The {what} of {name!r} on {entry['scenario']!r} are not those that come with "
                    "eitbench: run it again without choices and weights of your own."
                )
        if entry["track"] not in ("default", "tuned", "calibrated"):
            return f"{entry['track']!r} is no track that is ranked."
    for table in (of.run.samples, of.run.cells):
        for (scenario, name), rows in _rows_of(table).items():
            if set(rows["track"]) != {labels[scenario, name]}:
                return f"The track of {name!r} on {scenario!r} is not that of the manifest."
            if "suite" in rows and set(rows["suite"]) != {of.plan.suite.name}:
                return f"Rows of {name!r} on {scenario!r} say that they are of another suite."
    return ""


def _rows_of(table: pd.DataFrame) -> dict[tuple[str, str], pd.DataFrame]:
    """Rows of a table by scenario and method."""
    grouped = table.groupby(["scenario", "method"], sort=False)
    return {(str(scenario), str(method)): rows for (scenario, method), rows in grouped}


def _learned_apart(of: Submission) -> str:
    tests = {data.test.data_hash: name for name, data in of.data.items()}
    for (scenario, method), rows in _rows_of(of.run.cells).items():
        row, test = rows.iloc[0], of.data[scenario].test
        known = json.loads(row["prior_knowledge"] or "{}")
        learned = known.get("trained_on") or {}
        given = [data["data_hash"] for data in known.get("given", ())]
        if same := [
            tests[sha256] for sha256 in (*given, learned.get("train_data")) if sha256 in tests
        ]:
            return f"{method!r} says that it learned from the test split of {same[0]!r}."
        stated = stated_overlap(learned, of.data[scenario].scenario, test)
        overlap = max(np.nan_to_num([row["overlap"], stated]))
        if overlap:
            return (
                f"{overlap:.0f} of {len(test)} test samples of {scenario!r} are among those that "
                f"{method!r} learned from."
            )
        asked = json.loads(row["actions"] or "{}").get("test data")
        if asked:
            return f"{method!r} on {scenario!r} {describe_actions(row['actions'])}."
    return ""


def unknown_training(of: Submission) -> list[str]:
    """Return the methods whose training data are not known here, so that nothing is checked."""
    return [
        f"{method!r} on {scenario!r}"
        for (scenario, method), rows in _rows_of(of.run.cells).items()
        if rows["overlap"].isna().any()
    ]


def _frames_are_ours(of: Submission) -> str:
    run, cells = of.run, cells_of(of.run.samples)
    for name, ours in of.data.items():
        data = ours.test
        if run.manifest["data"][name]["hash"] != data.data_hash:
            return f"The data of {name!r} are not those of this version of eitbench."
        for (scenario, method), ordered in cells.items():
            if scenario != name:
                continue
            if of.same_numbers and ordered["input_hash"].tolist() != data.frame_hashes:
                return f"{method!r} was given other frames of {name!r} than ours."
            known = data.samples.drop(columns="sample")
            for column in known:
                if column not in ordered or not _same(ordered[column], known[column]):
                    return f"The column {column!r} of {method!r} on {name!r} was changed."
        scene, (attributes, arrays) = run.scene(name, range(len(data))), ours.truth()
        for what, value in {**attributes, "mask": arrays["mask"]}.items():
            if not np.array_equal(getattr(scene, what), value):
                return f"The scenario {name!r} is stored with another {what!r} than ours."
        truth = data.conductivity if data.truth == "conductivity" else data.classes
        if truth is not None and (scene.truth is None or not _agree(scene.truth, truth)):
            return f"The truth that is stored of {name!r} is not ours."
    return ""


def _same(one: Any, other: Any) -> bool:
    # A column that another scenario of the run lacks is stored as float.
    if other.dtype.kind in "iuf":
        return _agree(one.to_numpy(float), other.to_numpy(float))
    return bool(one.astype(str).tolist() == other.astype(str).tolist())


def _agree(one: Any, other: Any) -> bool:
    """True if arrays are equal but for what other versions of NumPy round otherwise."""
    return one.shape == other.shape and np.allclose(
        one, other, rtol=ROUNDING, atol=ROUNDING, equal_nan=True
    )


def _failures_are_reported(of: Submission) -> str:
    for (scenario, method), ordered in cells_of(of.run.samples).items():
        images = of.run.estimates(scenario, method, ordered["sample"].tolist())
        mask = of.data[scenario].test.sensor.mask
        if images is None:
            return f"There are no images of {method!r} on {scenario!r}."
        whole = np.isfinite(images[:, mask]).all(axis=1)
        if not np.array_equal(whole, ordered["status"] == "ok"):
            return (
                f"The status of {method!r} on {scenario!r} does not say which of its images are "
                "whole."
            )
    return ""


def _registrations_are_ours(of: Submission) -> str:
    for (scenario, method), rows in _rows_of(of.run.cells).items():
        validation = of.data[scenario].validation
        if validation is None:
            continue
        shape = (len(validation), *validation.sensor.image_shape)
        images = read_validation(of.run.path / METHOD_RUNS.arrays, scenario, method, shape)
        fitted = fit_registration(validation, images)
        stored = Similarity.from_json(rows["registration"].iloc[0])
        pairs = ((stored.scale, fitted.scale), (stored.turn, fitted.turn),
                 (stored.shift, fitted.shift))  # fmt: skip
        if not all(_agree(np.asarray(one), np.asarray(other)) for one, other in pairs):
            return (
                f"The registration of {method!r} on {scenario!r} does not follow from its images "
                "of the validation presses."
            )
    return ""


def _is_plausible(of: Submission) -> str:
    for (scenario, method), rows in cells_of(of.run.samples).items():
        psnr, place = rows["psnr"].mean(), rows["localisation_mm"].median()
        if psnr > PLAUSIBLE_PSNR_DB:
            told = f"a PSNR of {psnr:.1f} dB"
        elif rows["ssim"].isna().all() and place < PLAUSIBLE_PLACE_MM:
            told = f"places that are right to {place:.2g} mm"
        else:
            continue
        return (
            f"{method!r} on {scenario!r} has {told}, which is better than frames allow: look where "
            "it gets the truth from."
        )
    return ""


def _scores_are_ours(of: Submission) -> str:
    for cell, _ in rescored(of.run):
        if cell.changed:
            return (
                f"{cell.changed} of {cell.n} samples of {cell.method!r} on {cell.scenario!r} have "
                f"other figures than their stored images give: {', '.join(cell.figures)}."
            )
    return ""


def _leaderboard_follows(of: Submission) -> str:
    run = of.run
    try:
        stored = json.loads(read_json_file(run.path / LEADERBOARD).decode())
        rows = {(row["scenario"], row["method"]): row for row in stored}
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        return f"{LEADERBOARD} cannot be read ({type(error).__name__})."
    expected = [row for standing in standings([run]) for row in standing.rows]
    if len(stored) != len(expected):
        return f"{LEADERBOARD} has {len(stored)} rows, and the samples give {len(expected)}."
    for row in expected:
        there = rows.get((row["scenario"], row["method"]), {})
        for name, value in row.items():
            # A folder may be renamed.
            if name != "run" and not _agrees(there.get(name), value):
                return (
                    f"In {LEADERBOARD} the {name} of {row['method']!r} on {row['scenario']!r} is "
                    f"{there.get(name)}, and the samples give {value}."
                )
    return ""


def _agrees(stored: Any, value: Any) -> bool:
    if isinstance(value, float) and isinstance(stored, float | int):
        return bool(np.isclose(stored, value, rtol=ROUNDING, atol=ROUNDING))
    return bool(stored == value)


def _notes_are_ours(of: Submission) -> str:
    run = of.run
    for scenario in of.plan.suite.scenarios:
        if isinstance(scenario, RecordedScenario):
            n = run.manifest["data"][scenario.name]["n"]
            stored = run.notes.get(scenario.name, {})
            for name, value in notes_of(scenario, n).items():
                if not _agrees(stored.get(name), value):
                    return (
                        f"{NOTES_FILE} says {name} {stored.get(name)} of {scenario.name!r}, and "
                        f"its data say {value}."
                    )
    return ""


FIRST = (
    _holds_nothing_else,
    _says_who,
    _is_packaged,
    _names_its_version,
    _names_are_clear,
    _is_complete,
)
"""What fails one of these is not looked at any further."""

CHECKS: dict[str, Callable[[Submission], str]] = {
    "the directory holds what a run writes": _holds_nothing_else,
    "its author says what is asked": _says_who,
    "the suite is one of eitbench's": _is_packaged,
    "it names its version of eitbench": _names_its_version,
    "names are clear": _names_are_clear,
    "every sample of every method has its row": _is_complete,
    "tables and images hold what a run writes": _files_hold_nothing_else,
    "times and memory are possible": _measured_is_possible,
    "tracks, parameters and weights are ours": _choices_are_ours,
    "no test samples were learned from": _learned_apart,
    "frames, truth and geometry are ours": _frames_are_ours,
    "registrations are those of the stored images": _registrations_are_ours,
    "figures are those of the stored images": _scores_are_ours,
    "failures are reported": _failures_are_reported,
    "notes on recordings are ours": _notes_are_ours,
    "the leaderboard follows from the figures": _leaderboard_follows,
    "figures are plausible": _is_plausible,
}
