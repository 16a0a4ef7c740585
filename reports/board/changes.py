"""What differs between a record and that of the version before, sample by sample.

A method that nobody changed keeps its figures to the last bit on the same kind of machine: records
round them, and keep checksums of what they were. Those that changed are named, with the reason, in
the file `REASONS` of the newer version.
"""

from __future__ import annotations

import json
import re
import tomllib
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter, ValidationError

from eitbench.benchmark import DataCorruptError, InputError
from eitbench.benchmark.analysis.leaderboard import SAME
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.metrics.novelty import SCORES
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.few_bytes import rounded

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

VERSION = re.compile(r"20\d\d\.[1-9]\d*")
"""Of the leaderboard: a year and a number, each version in one way only."""
REASONS = "changed.toml"
"""In the folder of a version: by the name of a method, why its figures changed, and by the words
of `Changes.gone`, why something is gone."""
_REASONS = _SUMS = TypeAdapter(dict[str, str])


@dataclass(frozen=True)
class Changes:
    """How a record differs from an older one of the same suite.

    Attributes:
        older: the version of the older one.
        exact: the same kind of machine made all of both, so that figures are compared to the last
            bit; cells of different machines may differ by `SAME`, the rounding of processors.
            Nothing is exact where no cell is in both.
        kept: the methods that were run again and have all figures as before.
        taken: those all of whose rows are from the same runs in both records.
        changed: of each other method that is in both, what changed, in words.
        unlike: scenarios whose data are others, which are not compared.
        gone: what only the older one has: scenarios, methods of scenarios, figures, in words.
    """

    older: str
    exact: bool
    kept: list[str]
    taken: list[str]
    changed: dict[str, str]
    unlike: list[str]
    gone: list[str]


def changes(older: Path, newer: Path) -> Changes:
    """Compare the record `newer` with the record `older`, both VERSION/SUITE.

    Raises:
        InputError, DataCorruptError: one of them is no run, or damaged.
    """
    before, after = read_run(older), read_run(newer)
    data = [run.manifest["data"] for run in (before, after)]
    both = [name for name in after.scenarios() if name in data[0] and name in data[1]]
    same = [name for name in both if data[0][name]["hash"] == data[1][name]["hash"]]
    figures = [name for name in _figures(after) if name in before.samples]
    gone = [f"the scenario {name}" for name in before.scenarios() if name not in both]
    tables_of = {name: [_by_method(run, name) for run in (before, after)] for name in both}
    for scenario, (old, new) in tables_of.items():
        gone += [f"{name} on {scenario}" for name in old if name not in new]
    gone += [f"the figure {name}" for name in _figures(before) if name not in figures]
    sums = [_checksums_of(run) for run in (before, after)]
    differing: dict[str, list[str]] = {}
    taken = set[str]()
    alike: list[bool] = []
    for scenario in same:
        tables = tables_of[scenario]
        for method in tables[0].keys() & tables[1].keys():
            origins = [manifest.origin(run.manifest, method, scenario) for run in (before, after)]
            one, other = (rounded(table[method][figures].to_numpy(float)) for table in tables)
            says = []
            alike.append(exact := _machine(origins[0]) == _machine(origins[1]))
            allowed = 0.0 if exact else SAME
            if one.shape != other.shape:
                says.append(f"{len(one)} samples became {len(other)} ({scenario})")
            else:
                # Of a figure that is 0 in some samples, a share of what it is in others.
                sizes = pd.DataFrame(np.abs(one))
                usual = sizes.where((sizes > 0) & (sizes < np.inf)).median().fillna(0.0).to_numpy()
                equal = np.isclose(one, other, allowed, allowed * usual, equal_nan=True)
                if n := int((~equal.all(axis=1)).sum()):
                    says.append(f"{n} of {len(one)} samples of {scenario}")
                elif exact and (
                    unlike := _unlike(*(of.get((scenario, method), {}) for of in sums))
                ):
                    says.append(f"the last bits of {unlike[0]} on {scenario}")
            if says or _run(origins[0]) != _run(origins[1]):
                differing.setdefault(method, []).extend(says)
            else:
                taken.add(method)
    return Changes(
        older=older.parent.name,
        exact=bool(alike) and all(alike),
        kept=sorted(name for name, says in differing.items() if not says),
        taken=sorted(taken - differing.keys()),
        changed={name: ", ".join(says) for name, says in sorted(differing.items()) if says},
        unlike=[name for name in both if name not in same],
        gone=gone,
    )


def checksums(run: Run) -> list[str]:
    """Return a checksum of the exact values of each figure, as JSON, for each cell of a run."""
    keys, figures, found = ["scenario", run.kind.name], _figures(run), []
    samples = dict(list(run.samples.sort_values("sample").groupby(keys)[figures]))
    for cell in run.cells[keys].itertuples(index=False, name=None):
        exact = {name: values.to_numpy("<f8").tobytes() for name, values in samples[cell].items()}
        found.append(json.dumps({n: f"{zlib.crc32(of):08x}" for n, of in exact.items()}))
    return found


def _checksums_of(record: Run) -> dict[tuple[str, str], dict[str, str]]:
    """Its `checksums`, by scenario and method; without any it keeps the exact numbers."""
    cells = record.cells
    kept = cells["checksums"] if "checksums" in cells else checksums(record)
    keys = zip(cells["scenario"], cells[record.kind.name], strict=True)
    try:
        return dict(zip(keys, map(_SUMS.validate_json, kept), strict=True))
    except ValidationError as error:
        raise DataCorruptError(
            f"The column 'checksums' of {record.path} is damaged: take the record from git again."
        ) from error


def _unlike(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    return [name for name in one if name in other and one[name] != other[name]]


def _figures(run: Run) -> list[str]:
    """Columns of samples with figures that do not depend on the load of the machine."""
    known = dict(run.kind.metrics) | UNCERTAINTY | SCORES
    return [name for name, spec in known.items() if spec.unit != "ms" and name in run.samples]


def last_before(newer: Path) -> Path | None:
    """The newest record of the same suite in a version before that of `newer`, VERSION/SUITE."""
    version = version_key(newer.parent.name)
    found = [
        path.parent
        for path in newer.parents[1].glob(f"2*/{newer.name}/{manifest.FILE_NAME}")
        if version_key(path.parents[1].name) < version
    ]
    return max(found, key=lambda path: version_key(path.parent.name), default=None)


def version_key(version: str) -> tuple[int, ...]:
    """What sorts versions: 2026.10 comes after 2026.9."""
    return tuple(map(int, version.split(".")))


def reasons(version: Path) -> dict[str, str]:
    """Why figures of methods changed in a version, by name; none without the file.

    Raises:
        InputError: the file does not hold texts by name.
    """
    file = version / REASONS
    if not file.is_file():
        return {}
    try:
        return _REASONS.validate_python(tomllib.loads(file.read_text(encoding="utf-8")))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise InputError(f'{file} should hold lines such as tv = "it stops later".') from error


def in_words(found: Changes, why: Mapping[str, str]) -> list[str]:
    """What changed, a sentence each."""
    sure = "to the last bit" if found.exact else "to the rounding of another processor"
    said = []
    if n := len(found.kept):
        kept = f"{n} method{'s' * (n != 1)} that ran again kept all figures {sure}"
        said.append(f"Against {found.older}, {kept}.")
    if n := len(found.taken):
        said.append(f"Rows of {n} method{'s' * (n != 1)} are those of {found.older}.")
    for name, what in found.changed.items():
        reason = why.get(name, "why is not said")
        said.append(f"Against {found.older}, {name} changed ({what}): {reason.rstrip('.')}.")
    for what in found.gone:
        reason = why.get(what, "why is not said")
        said.append(f"Since {found.older}, {what} is gone: {reason.rstrip('.')}.")
    if found.unlike:
        said.append(f"Data of {', '.join(found.unlike)} are others, and not compared.")
    return said


def _run(origin: manifest.Manifest) -> Any:
    """What tells runs apart: the second in which they began, and their commit."""
    return origin["started"], origin["git_commit"]


def _machine(origin: manifest.Manifest) -> Any:
    """What decides the last bits of a cell's figures: the processor and the libraries."""
    versions = {k: v for k, v in origin["versions"].items() if k != "eitbench"}
    return origin["machine"].get("cpu"), versions


def _by_method(run: Run, scenario: str) -> dict[str, pd.DataFrame]:
    rows = run.samples[run.samples["scenario"] == scenario]
    grouped = rows.groupby(run.kind.name, sort=False)
    return {str(name): of.sort_values("sample") for name, of in grouped}
