"""Stored runs: their manifest, tables and arrays, checked as they are read."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, TypeAdapter

from eitbench.benchmark.metrics.aggregation import LOAD_COLUMNS
from eitbench.benchmark.metrics.novelty import SCORES
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.folder import MOST_ENTRIES, read_json_file
from eitbench.benchmark.rundir.kinds import CONDITIONS, METHOD_RUNS, RUN_KINDS, RunKind
from eitbench.benchmark.rundir.plan import plugin_copy
from eitbench.benchmark.rundir.run_arrays import (
    Scene,
    kept_open,
    names_in,
    read_estimates,
    read_scene,
)
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS
from eitbench.benchmark.rundir.tables import read_parquet, wrong_kind
from eitbench.benchmark.workers.messages import plain_trace
from eitbench.methods.registry import MAX_NAME, METHOD_REGISTRY, OPERATOR_REGISTRY, PLACE_REGISTRY
from eitbench.scenarios.data.datasets import SNR_COLUMNS
from eitbench.scenarios.errors import DataCorruptError, InputError, counted
from eitbench.scenarios.recordings.descriptors import PLACES
from eitbench.scenarios.storage.try_reading import try_reading

# What is known of a scenario's data beside its rows, if it is recorded.
GUESS = {
    "guess_mm": "localisation_mm",
    **{f"guess_{name}": name for name in (
        "localisation_p90_mm", "within_5_mm", "within_10_mm", "unevenness", "worst_tenth_mm",
    )},
}  # fmt: skip
"""Notes on guessing one place, and the figures of a method that they stand beside."""
NOTES = ("reciprocity_error", "repeat_noise", *GUESS, "guess_force_n", "guess_load_percent")
NOTES_FILE = "recordings.json"
SHOWN, ROUNDED = "shown", "rounded"
"""Entries `images` of a manifest: of a record, and of a submission with rounded images, see
`reports.board`."""
STORED_NOTES = TypeAdapter(dict[str, dict[str, float | None]], config=ConfigDict(strict=True))

_FAMILIES = {"same": "the families of the test phantoms", "other": "other families of phantoms"}
_NOISE = {"tuning": "tuning", "train": "training samples", "validation": "validation samples"}

# Columns beside labels, metrics and costs, by what they hold.
TEXTS = (
    "input_hash",
    "status",
    "message",
    "phantom",
    "cluster",
    "family",
    "machine",
    "prior_knowledge",
    "differs",
    "actions",
    "trace",
    "source",
)
NUMBERS = (
    *("sample", *SNR_COLUMNS, "contacts", "cc_undefined", "overlap"),
    *("probe_distance_mm", "time_s", "cuts"),
    *(name for place in PLACES for name in place),
    *CONDITIONS,
    *METRIC_COLUMNS,
    *UNCERTAINTY,
    *SCORES,
    "novelty_ms",
    *LOAD_COLUMNS,
)


BUSY = 1.25
"""Beside what is timed, the calibration solve may take so many times the machine's fastest."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run directory.

    Attributes:
        path: the directory.
        kind: what it ranks.
        manifest: how the run was made.
        samples: one row per scenario, method (or operator) and sample.
        cells: one row per scenario and method (or operator).
        notes: figures of recorded scenarios, by scenario and by a name of `NOTES`.
        tracks: rows like `samples` of the tracks beside the ranked one; empty if none was run.
    """

    path: Path
    kind: RunKind
    manifest: dict[str, Any]
    samples: pd.DataFrame
    cells: pd.DataFrame
    notes: dict[str, dict[str, float | None]]
    tracks: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def whole(self) -> bool:
        """False of a record of the leaderboard, which has images of the samples shown alone."""
        return self.manifest.get("images") != SHOWN

    def scenarios(self) -> list[str]:
        """Return the names of the scenarios that have rows, in the order of the run."""
        return [] if self.samples.empty else list(self.samples["scenario"].unique())

    def n(self, scenario: str) -> int:
        """Return the number of samples of a scenario, as the manifest says."""
        return manifest.samples_of(self.manifest).get(scenario, 0)

    def cell(self, scenario: str, method: str) -> pd.DataFrame:
        """Return the sample rows of one method on one scenario."""
        return self._by_cell.get((scenario, method), self.samples.iloc[:0])

    @cached_property
    def _by_cell(self) -> dict[tuple[str, str], pd.DataFrame]:
        return rows_of(self.samples)

    @cached_property
    def parameters(self) -> dict[tuple[str, str], Any]:
        """Parameters that were given or not the defaults, by scenario and method (or operator)."""
        return {
            (str(cell.get("scenario")), str(cell.get("name"))): cell["parameters"]
            for cell in self.manifest["cells"]
            if cell.get("variant") == ""
            and (cell.get("parameters") or cell.get("track") == "given")
        }

    def scene(self, scenario: str, samples: Sequence[int]) -> Scene:
        """Read what is known of a scenario, with the truth of the given samples.

        Raises:
            DataCorruptError: the file of arrays does not hold it, or is damaged.
        """
        return read_scene(self.path / self.kind.arrays, scenario, samples, self.n(scenario))

    def estimates(
        self, scenario: str, method: str, samples: Sequence[int]
    ) -> NDArray[np.float32] | None:
        """Read conductivity (k, H, W) [S/m] of the given samples; see `read_estimates`.

        Raises:
            DataCorruptError: as for `scene`.
        """
        arrays, n = self.path / self.kind.arrays, self.n(scenario)
        return read_estimates(arrays, scenario, method, samples, n)


def read_run(path: Path) -> Run:
    """Read a run directory, which may come from somebody else.

    Raises:
        InputError: it is none, or its run was not finished.
        DataCorruptError: one of its files is damaged, or takes more than a run's can.
    """
    try_reading(path, _try_run, path)
    return _read_run(path)


def _try_run(path: Path) -> None:
    """Read a run, and look at all of its images, as far as a parser could stumble over them."""
    run = _read_run(path)
    with suppress(DataCorruptError):
        for _ in islice(names_in(path / run.kind.arrays), MOST_ENTRIES):
            pass
    if run.kind != METHOD_RUNS:
        return
    with kept_open(path / run.kind.arrays):
        for scenario in run.scenarios():
            with suppress(DataCorruptError):  # who asks for these images is told
                run.scene(scenario, [])
        for scenario, method in cells_of(run.samples):
            with suppress(DataCorruptError):
                run.estimates(scenario, method, [])


def _read_run(path: Path) -> Run:
    content = manifest.read(path)
    kinds = [kind for kind in RUN_KINDS.values() if (path / kind.table).is_file()]
    if not (path / SAMPLES).is_file() or not kinds:
        if content["status"] == "finished":
            tables = " or ".join(kind.table for kind in RUN_KINDS.values())
            lost = tables if (path / SAMPLES).is_file() else SAMPLES
            raise DataCorruptError(
                f"{path} lacks {lost}, though its run was finished: take the folder again from "
                "where it came from."
            )
        raise InputError(
            f"The run in {path} has no results yet: finish it with "
            f"`{manifest.resume_command(path)}`."
        )
    notes, kind = path / NOTES_FILE, kinds[0]
    labels = ("scenario", kind.name, *kind.labels)
    try:
        noted = STORED_NOTES.validate_json(read_json_file(notes)) if notes.is_file() else {}
    except ValueError as error:
        raise DataCorruptError(f"{notes} is damaged: delete it and run the suite again.") from error
    # Tracks have rows of the same samples, once each.
    most = sum(manifest.samples_of(content).values()) * max(1, len(content["cells"]))
    needed = ("suite", *labels, "sample", "status", "cluster")
    needed += METRIC_COLUMNS if kind == METHOD_RUNS else ()
    samples = checked_table(path / SAMPLES, kind, needed, most)
    cells = checked_table(path / kind.table, kind, (*labels, "source"), most)
    if len(samples) and cells.empty:
        raise DataCorruptError(f"{path / kind.table} is empty: run the suite again.")
    if unknown := sorted({*samples.get("scenario", ())} - content["data"].keys()):
        raise DataCorruptError(
            f"The manifest of {path} says nothing of the data of {unknown[0]!r}: run the suite "
            "again."
        )
    return Run(
        path,
        kind,
        content,
        samples,
        cells,
        noted,
        checked_table(path / TRACKS, kind, labels, most)
        if (path / TRACKS).is_file()
        else pd.DataFrame(),
    )


def fastest_solves(cells: pd.DataFrame, about: Mapping[str, Any]) -> dict[str, float]:
    """The fastest calibration solve that is known of each machine of a run, by its name [ms].

    Args:
        cells: of the run; those that have no `calibration_ms` do not count.
        about: its manifest; empty of tables that came without one.
    """
    fastest: dict[str, float] = {}
    if {"machine", "calibration_ms"} <= set(cells):
        solves = cells[cells["calibration_ms"] > 0].groupby("machine")["calibration_ms"].min()
        fastest = {str(machine): float(solve) for machine, solve in solves.items()}
    own, solve = about.get("machine", {}).get("cpu"), about.get("calibration_ms")
    if own and solve:
        fastest[own] = min(fastest.get(own, np.inf), solve)
    return fastest


def rows_of(table: pd.DataFrame) -> dict[tuple[str, str], pd.DataFrame]:
    """Rows of a table by scenario and method, in the order of the run."""
    if table.empty:
        return {}
    grouped = table.groupby(["scenario", "method"], sort=False)
    return {(str(scenario), str(method)): rows for (scenario, method), rows in grouped}


def cells_of(samples: pd.DataFrame) -> dict[tuple[str, str], pd.DataFrame]:
    """Rows of each scenario and method, by sample, in the order of the run."""
    return {cell: in_order(rows) for cell, rows in rows_of(samples).items()}


def in_order(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows by sample."""
    return rows if rows["sample"].is_monotonic_increasing else rows.sort_values("sample")


def checked_table(
    path: Path, kind: RunKind, needed: Iterable[str] = (), most_rows: int | None = None
) -> pd.DataFrame:
    """Read a table of a run directory that has all `needed` columns, each of the right kind.

    Raises:
        DataCorruptError: it is none.
    """
    table = read_table(path, most_rows)
    for name in needed:
        if len(table) and name not in table:
            raise DataCorruptError(f"{path} has no column {name!r}: run the suite again.")
    texts = ("suite", "scenario", kind.name, *kind.labels, *kind.facts, *TEXTS)
    for name in ("suite", "scenario", kind.name, *kind.labels):
        for text in table[name].dropna().unique() if name in table else ():
            if not isinstance(text, str) or len(text.encode()) > MAX_NAME:
                raise DataCorruptError(
                    f"The column {name!r} of {path} holds a name of more than {MAX_NAME} bytes: "
                    "run the suite again with a shorter one."
                )
    if wrong := wrong_kind(table, texts, (*kind.metrics, *kind.costs, *NUMBERS)):
        raise DataCorruptError(f"The column {wrong!r} of {path} is damaged: run the suite again.")
    described = {"prior_knowledge": describe_prior_knowledge, "actions": describe_actions}
    for name, describe in described.items():
        try:
            for text in table[name].unique() if name in table else ():
                describe(text)
        except ValueError as error:
            raise DataCorruptError(
                f"The column {name!r} of {path} is damaged: run the suite again."
            ) from error
    return table


_ACTIONS = TypeAdapter(dict[str, list[str]])
_DID = {
    "network": "used the network",
    "program": "started a program",
    "test data": "asked for test data",
}


class _Given(BaseModel):
    split: str
    samples: int


class _Tuned(BaseModel):
    trials: int = 0
    edges: list[str] = []


class _Weights(BaseModel):
    train_samples: int = 0
    seed: str = ""
    unlimited: bool = False


class _PriorKnowledge(BaseModel):
    """The part of `prior_knowledge_columns` (`eitbench.benchmark.run`) that is shown in words."""

    model: bool
    conductivity_range: bool
    noise: list[Literal["tuning", "train", "validation"]]
    tuned: _Tuned
    given: list[_Given]
    trained_on: _Weights
    families: Literal["same", "other"] | None = None


def describe_prior_knowledge(text: object) -> str:
    """Return the column `prior_knowledge` of a cell as a phrase; "" where it is empty.

    Raises:
        ValueError: the text is not JSON of this form.
    """
    if not isinstance(text, str) or not text:
        return ""
    known = _PriorKnowledge.model_validate_json(text)
    parts = []
    if known.model:
        parts.append("knows the nominal contact impedance")
    if known.conductivity_range:
        parts.append("knows the conductivity range")
    if known.noise:
        ways = " and ".join(_NOISE[way] for way in known.noise)
        parts.append(f"learned the noise level from {ways}")
    if known.tuned.trials:
        edges = ", ".join(known.tuned.edges)
        where = f" ({edges} at the edge of the search range)" if edges else ""
        parts.append(f"tuned with {known.tuned.trials} trials{where}")
    for given in known.given:
        kind = "training" if given.split == "train" else given.split
        parts.append(f"learned from {given.samples:,} {kind} samples")
    return "; ".join(parts + _weights(known)) or "the reference frame only"


def describe_training(text: object) -> str:
    """Return what the column `prior_knowledge` says of training data; "" where there were none.

    Raises:
        ValueError: the text is not JSON of this form.
    """
    if not isinstance(text, str) or not text:
        return ""
    known = _PriorKnowledge.model_validate_json(text)
    given = [f"{of.samples:,} training samples" for of in known.given if of.split == "train"]
    return "; ".join(given + _weights(known))


def _weights(known: _PriorKnowledge) -> list[str]:
    parts = []
    if count := known.trained_on.train_samples:
        seed = f" with seed {known.trained_on.seed}" if known.trained_on.seed else ""
        track = " of unlimited simulation" if known.trained_on.unlimited else ""
        parts.append(f"weights trained once{seed} on {count:,} samples{track}")
    if known.families:
        parts.append(f"trained on {_FAMILIES[known.families]}")
    return parts


def describe_actions(text: object) -> str:
    """Return what the column `actions` of a cell says that a reader should know; else "".

    That is the network, programs, and the test data; files that it read or wrote are not.

    Raises:
        ValueError: the text is not JSON of this form.
    """
    if not isinstance(text, str) or not text:
        return ""
    known = _ACTIONS.validate_json(text)
    told = (f"{_DID[kind]} ({known[kind][0]})" for kind in _DID if known.get(kind))
    return " and ".join(told)


def plugin_copies(run: Run) -> list[str]:
    """Return the copies of plugins that a run directory holds, seen from there."""
    sums = [str(plugin["sha256"]) for plugin in run.manifest["plan"]["plugins"]]
    # What a manifest names may lie elsewhere, and so may what a link leads to.
    copies = [plugin_copy(each) for each in sums if re.fullmatch("[0-9a-f]{64}", each)]
    return [
        copy
        for copy in copies
        if (run.path / copy).is_file() and not (run.path / copy).is_symlink()
    ]


def code_place(run: Run, name: str) -> str:
    """Return where the code of a method or operator is: in the run directory, or in eitbench."""
    for plugin in run.manifest["plan"]["plugins"]:
        if name in plugin["names"]:
            return f"{plugin_copy(plugin['sha256'])} in the run {run.path.name}"
    module: str | None = None
    # A name of one registry is in no other.
    for registry in (
        (METHOD_REGISTRY, PLACE_REGISTRY) if run.kind.name == "method" else (OPERATOR_REGISTRY,)
    ):
        registry.import_built_in()  # and no package of others
        own = (m for m in registry.built_in if name in registry.of_module(f"eitbench.methods.{m}"))
        module = module or next(own, None)
    if module is None:
        return "an installed package"
    about = manifest.origin(run.manifest, name)
    version = about["versions"].get("eitbench") or ""
    commit = about["git_commit"] or ""
    at = ", ".join(part for part in (version, commit[:10] and f"commit {commit[:10]}") if part)
    return f"methods/{module.replace('.', '/')}.py of eitbench {at}".strip()


def failures(run: Run) -> list[str]:
    """One sentence for each method or operator that failed on a scenario, with its first reason."""
    return [sentence for sentence, _ in failures_with_traces(run)]


def failures_with_traces(run: Run) -> list[tuple[str, str]]:
    """Return the sentences of `failures`, and where each first raised an error, "" if not known."""
    if run.samples.empty:
        return []
    failed = run.samples[run.samples["status"] != "ok"]
    cells = run.cells.set_index(["scenario", run.kind.name])
    found = []
    for of, rows in failed.groupby(["scenario", run.kind.name], sort=False):
        (scenario, name), first = of, rows.iloc[0]
        trace = cells["trace"].get(of, "") if "trace" in cells else ""
        found.append(
            (
                f"{name!r} on {scenario!r}: {counted(len(rows), 'sample')} failed, the first "
                f"({first['status']}): {' '.join(str(first['message']).split())}",
                plain_trace(trace) if isinstance(trace, str) else "",
            )
        )
    return found


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object of a run directory.

    Raises:
        DataCorruptError: it is none.
    """
    try:
        content = json.loads(read_json_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise DataCorruptError(f"{path} is not valid JSON: run the suite again.") from error
    if not isinstance(content, dict):
        raise DataCorruptError(f"{path} does not hold a JSON object: run the suite again.")
    return content


def read_table(path: Path, most_rows: int | None = None) -> pd.DataFrame:
    """Read a Parquet file of a run directory; see `read_parquet`.

    Raises:
        DataCorruptError: it cannot be read.
    """
    try:
        return read_parquet(path, most_rows)
    # Damaged tables fail in whatever way the damage leads to.
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise DataCorruptError(
            f"{path} is not a readable Parquet file ({reason}): run the suite again."
        ) from error
