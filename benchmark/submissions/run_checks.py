"""Checks of what a submission says of itself: files, names, version, plan, parameters, training.

Each check returns what is wrong, as a sentence; "" where nothing is.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Collection, Hashable, Mapping
from pathlib import Path

import numpy as np
from packaging.version import InvalidVersion, Version

from eitbench.benchmark.analysis.rescore import FIGURES
from eitbench.benchmark.analysis.results import (
    cells_of,
    describe_actions,
    rows_of,
)
from eitbench.benchmark.metrics.novelty import SCORES
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.run.prior_knowledge import stated_overlap
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.folder import unknown_entries
from eitbench.benchmark.rundir.kinds import CONDITIONS, METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import TRUTH, names_in
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS
from eitbench.benchmark.rundir.tables import columns_of, metadata_of
from eitbench.benchmark.submissions.statement import STATEMENT, read_statement, unfilled
from eitbench.benchmark.submissions.submission import FILES, FOLDER, Submission
from eitbench.methods.registry import METHOD_REGISTRY, RESERVED, registries, usable_name
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.storage.files import sha256_of
from eitbench.scenarios.suites.suite import load_suite, suites

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


TABLE_METADATA = {b"pandas", b"ARROW:schema"}

MANIFEST_KEYS = {
    *("format", "status", "command_line", "started", "finished", "resumed", "versions"),
    *("machine", "git_commit", "calibration_ms", "jobs", "batch", "threads", "seeds", "plan"),
    *("data", "skipped", "refused", "cells", "images", "rescored"),
}

CELL_KEYS = {"scenario", "name", "variant", "track", "parameters", "spent", "weights"}

Code = tuple[str, ...]
"""Digests of the copies of the plugin that a name is from; of a package, its stated address."""


def holds_nothing_else(of: Submission) -> str:
    """What the folder holds that no run writes, or a copy of a plugin that was changed."""
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
        if not copy.is_file() or sha256_of(copy) != plugin.sha256:
            return (
                f"The copy {plugin.kept.as_posix()} of a plugin is missing or was changed: send "
                "what the run wrote."
            )
    if (of.run.path / STATEMENT).is_file():
        folders = {"plugins"} if copies else set()
        for path in of.run.path.iterdir():
            if path.name not in (folders if path.is_dir() else FILES):
                return f"A submission has no {path.name!r}: delete it."
        above = of.run.path.resolve().parent
        if above.parent.name == FOLDER and above.name != of.plan.suite.name:
            return f"It belongs into {FOLDER}/{of.plan.suite.name}, and not {above.name}."
        if of.run.path.resolve().name == of.plan.suite.name:
            return f"It has the name of its suite, {of.plan.suite.name!r}: rename the folder."
    return ""


def says_who(of: Submission) -> str:
    """What the author's statement lacks."""
    # A run that is no submission yet has none: `submission make` writes it.
    return unfilled(read_statement(of.run.path)) if (of.run.path / STATEMENT).is_file() else ""


def is_packaged(of: Submission) -> str:
    """The suite is not one of this version."""
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


def names_its_version(of: Submission) -> str:
    """The version or commit that made the run cannot be told, or is newer than this one."""
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


def names_are_clear(of: Submission) -> str:
    """A name of a method is ours, or looks like another one."""
    registered = METHOD_REGISTRY.known()
    every = {name for registry in registries() for name in registry.known()} | {*RESERVED}
    known = {folded(name): name for name in every}
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
        if name in every and name not in registered:
            return f"{name!r} is what eitbench calls something else: choose another name."
        if known.setdefault(folded(name), name) != name:
            return f"{name!r} looks like {known[folded(name)]!r}: choose another name."
    return _taken_by_another(of)


def _taken_by_another(of: Submission) -> str:
    """A name that another submission of the same version has, which is not of the same code."""
    here = of.run.path.resolve()
    if here.parent.parent.name != FOLDER:  # it is nowhere yet
        return ""
    ours = _codes(here)
    for path in sorted(here.parent.parent.glob(f"*/*/{manifests.FILE_NAME}")):
        if path.parent == here:
            continue
        try:
            theirs = _codes(path.parent)
        except EitbenchError:  # one that is damaged is in nobody's way
            continue
        alike = {folded(name): name for name in theirs}
        for name, code in ours.items():
            other = alike.get(folded(name))
            if other is not None and (other, theirs[other]) != (name, code):
                return (
                    f"The submission {path.parent.parent.name}/{path.parent.name} has {other!r}, "
                    f"which is not the code of {name!r}: choose another name."
                )
    return ""


def _codes(submission: Path) -> dict[str, Code]:
    """Where the code of each method is: in a copy of a plugin, or at the address that is stated."""
    plan = manifests.read(submission)["plan"]
    stated = (str(read_statement(submission).code),)
    return {
        name: tuple(of["sha256"] for of in plan["plugins"] if name in of["names"]) or stated
        for name in plan["names"]
    }


def folded(name: str) -> str:
    """Return what names that look alike have in common: case, separators, digits like letters."""
    plain = unicodedata.normalize("NFKC", name).casefold().translate(_ALIKE)
    return plain.replace("rn", "m").replace("vv", "w")


_ALIKE = str.maketrans({"0": "o", "1": "l", "i": "l", "|": "l", "5": "s", **dict.fromkeys("-_ .")})


def left_out(skipped: Collection[str], sensors: Mapping[str, Hashable], name: str) -> list[str]:
    """Return the scenarios of a method's plan that its run rightly lacks.

    A network fits one sensor: of a sensor all scenarios may be left out, but not single ones.

    Args:
        skipped: those that the manifest says were left out, as SCENARIO/METHOD.
        sensors: of each scenario of the suite.
        name: of the method.
    """
    stated = [scenario for scenario in sensors if f"{scenario}/{name}" in skipped]
    can = {sensor for scenario, sensor in sensors.items() if scenario not in stated}
    return [scenario for scenario in stated if can and sensors[scenario] not in can]


def is_complete(of: Submission) -> str:
    """A scenario, a method or a sample is missing, or there is one too many."""
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
    tests = {name: data.test.sensor for name, data in of.data.items()}
    sensors = {name: (sensor.name, sensor.image_shape) for name, sensor in tests.items()}
    out = {name: left_out(run.manifest["skipped"], sensors, name) for name in plan.names}
    expected = [(where, name) for where in sensors for name in plan.names if where not in out[name]]
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


def files_hold_nothing_else(of: Submission) -> str:
    """A column or an array that no run writes."""
    run, names = of.run, set[str]()
    described = {column for data in of.data.values() for column in data.test.samples}
    for table, known in ((SAMPLES, SAMPLE_COLUMNS | described), (METHOD_RUNS.table, CELL_COLUMNS)):
        if more := columns_of(run.path / table) - known:
            return f"{table} has a column {min(more)!r}, which no run writes: delete it."
        if others := metadata_of(run.path / table) - TABLE_METADATA:
            return f"{table} holds {min(others).decode(errors='replace')!r}, which no run writes."
    for what, more in (
        ("The manifest", run.manifest.keys() - MANIFEST_KEYS),
        (
            "The machine of the manifest",
            run.manifest["machine"].keys() - manifests.machine().keys(),
        ),
        ("A cell of the manifest", set().union(*run.manifest["cells"]) - CELL_KEYS),
    ):
        if more:
            return f"{what} holds {min(more)!r}, which no run writes: delete it."
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


def measured_is_possible(of: Submission) -> str:
    """A time, a rate or a memory that cannot be."""
    for table in (of.run.cells, of.run.samples):
        for column in (*METHOD_RUNS.costs, *CONDITIONS, *TIMES):
            for value in table[column].dropna() if column in table else ():
                if not 0 <= value <= MOST_MEASURED:
                    return (
                        f"The column {column!r} holds {value:g}: what is measured is 0 or more, "
                        "and empty where it was not measured."
                    )
    return ""


def tracks_are_ranked(of: Submission) -> str:
    """A track that is not ranked, or not that of the rows.

    Parameters and weights are the author's own: no method of eitbench can be submitted.
    """
    labels: dict[tuple[str, str], str] = {}
    for entry in of.run.manifest["cells"]:
        if entry["variant"]:
            continue
        labels[entry["scenario"], entry["name"]] = entry["track"]
        if entry["track"] not in ("default", "tuned", "calibrated"):
            return f"{entry['track']!r} is no track that is ranked."
    for table in (of.run.samples, of.run.cells):
        for (scenario, name), rows in rows_of(table).items():
            if set(rows["track"]) != {labels[scenario, name]}:
                return f"The track of {name!r} on {scenario!r} is not that of the manifest."
            if "suite" in rows and set(rows["suite"]) != {of.plan.suite.name}:
                return f"Rows of {name!r} on {scenario!r} say that they are of another suite."
    return ""


def learned_apart(of: Submission) -> str:
    """A method learned from test samples, as far as it can be told."""
    tests = {data.test.data_hash: name for name, data in of.data.items()}
    for (scenario, method), rows in rows_of(of.run.cells).items():
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
