"""Hidden test sets: drawn with a key that is secret, and whose SHA-256 is published before.

Who tunes or trains on the open test split, or stores its truth, is good on these frames alone. A
hidden set has the same families, ranges, tolerances, noise and numbers of samples. So a method that
is worse there by more than chance has learned the open frames, not the problem.
"""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, StringConstraints, ValidationError, model_validator
from scipy import special

from eitbench.benchmark.analysis.leaderboard import Entry, made_with, ranked_boards, ranking_figure
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.benchmark.metrics.aggregation import aggregate
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.statistics import (
    MIN_CLUSTERS,
    draw,
    holm,
    intervals,
    once,
    student_t,
)
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.declaration import Declaration, Name, read_declaration
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.limits import check_regular
from eitbench.scenarios.suites.suite import Suite, drawn_with

KEY_BYTES = 32
KEYS = "hidden.toml"
"""Beside the versions of the leaderboard: the hashes of all keys."""
FOLDER = "hidden"
"""In a version of the leaderboard: a record of figures of each run on a hidden set."""

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}\z")]
_Text = Annotated[str, Field(max_length=200)]


class PublishedKey(Declaration):
    """The hash of a secret key, which is published before the key is used.

    Attributes:
        version: of the leaderboard.
        suite: name of the suite.
        sha256: of the 32 bytes of the key.
        retired: the key itself (hex), once it is retired, so that anybody can draw its set.
    """

    version: _Text
    suite: Name
    sha256: Sha256
    retired: Sha256 | None = None

    @model_validator(mode="after")
    def _is_its_key(self) -> Self:
        key = bytes.fromhex(self.retired or "")
        if self.retired and hashlib.sha256(key).hexdigest() != self.sha256:
            raise ValueError("the retired key has another hash")
        return self


class PublishedKeys(Declaration):
    """The file `hidden.toml`."""

    keys: tuple[PublishedKey, ...] = ()


class Gap(Declaration):
    """A method on the open test split of a scenario and on its hidden one.

    Attributes:
        scenario, method: names.
        code: SHA-256 (hex) of the file of the method; None of a method of eitbench.
        figure: the figure that ranks the scenario.
        n: number of samples of each set.
        clusters: the fewest that are independent in one of the two.
        open, hidden: the figure.
        difference, low, high: hidden minus open, with its 95 % interval; the ends are None of
            fewer than `MIN_CLUSTERS` clusters.
        p: of no difference, two-sided, adjusted for all gaps of its run (Holm); None as above.
        falls: True if the method is worse on the hidden set by more than chance.
    """

    scenario: _Text
    method: _Text
    code: Sha256 | None = None
    figure: _Text
    n: int
    clusters: int
    open: float
    hidden: float
    difference: float
    low: float | None
    high: float | None
    p: float | None
    falls: bool


class HiddenRecord(Declaration):
    """What is published of a run on a hidden set: figures of whole scenarios, nothing of a sample.

    Attributes:
        suite: its name.
        key: SHA-256 (hex) of the secret key.
        made, eitbench, git_commit: when and with what.
        data: SHA-256 (hex) of the declared parameters of each open and hidden set, by scenario.
        gaps: of the methods that both runs hold.
    """

    suite: Name
    key: Sha256
    made: _Text
    eitbench: _Text
    git_commit: _Text | None
    data: dict[str, tuple[_Text, _Text]]
    gaps: tuple[Gap, ...]


def new_key(path: Path) -> str:
    """Write a random key to the new file `path`, for its owner alone to read.

    Returns:
        The SHA-256 (hex) that is to be published.

    Raises:
        InputError: there is something already.
        OSError: it cannot be written.
    """
    key = secrets.token_bytes(KEY_BYTES)
    try:
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise InputError(f"{path} is there already: name a new file for the key.") from error
    with os.fdopen(opened, "w") as file:
        file.write(f"{key.hex()}\n")
    return hashlib.sha256(key).hexdigest()


def read_key(path: Path) -> bytes:
    """Read the key that `new_key` wrote.

    Raises:
        InputError: the file cannot be read, or holds no key.
    """
    try:
        check_regular(path)
        with path.open() as file:
            text = file.read(2 * KEY_BYTES + 2).strip()
        key = bytes.fromhex(text)
    except OSError as error:
        raise InputError(f"Cannot read the key {path}: {error.strerror}.") from error
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise InputError(
            f"{path} holds no key: `eitbench hidden new-key FILE` writes one of 64 hex digits."
        )
    return key


def hidden_suite(suite: Suite, version: str, key: bytes, published: Path) -> Suite:
    """Return the suite with its test splits drawn with `key`, whose hash has to be published.

    Raises:
        InputError: no hash, or another one, is published for this suite and version, or a suite
            without touches that are drawn.
    """
    keys = read_declaration("Key", published, PublishedKeys).keys
    known = [of.sha256 for of in keys if (of.version, of.suite) == (version, suite.name)]
    sha256 = hashlib.sha256(key).hexdigest()
    if not known:
        raise InputError(
            f"{published} has no key of suite {suite.name!r} in version {version}: publish its "
            f"hash there first, sha256 = {sha256!r}."
        )
    if sha256 not in known:
        raise InputError(
            f"This key is not the published one of suite {suite.name!r} in version {version}: its "
            f"SHA-256 is {sha256}, and {published} says {known[0]}."
        )
    return drawn_with(suite, key)


def hidden_record(open_run: Run, hidden_run: Run) -> HiddenRecord:
    """Compare the methods that both runs hold: of a suite, and of the same with a hidden set.

    Raises:
        InputError: one of the runs is of the wrong kind or not finished, they are of different
            suites or numbers of samples, a method was not the same in both, or none is in both.
    """
    _check_pair(open_run, hidden_run)
    of_open, of_hidden = _entries(open_run), _entries(hidden_run)
    found: list[Gap] = []
    for cell, entry in of_hidden.items():
        if (other := of_open.get(cell)) is None:
            continue
        scenario, method = cell
        if made_with(other) != made_with(entry):
            raise InputError(
                f"{method!r} on {scenario!r} has other parameters, weights or code in "
                f"{hidden_run.path} than in {open_run.path}: run both anew with the same."
            )
        if len(other.cell) != len(entry.cell):
            raise InputError(
                f"{method!r} on {scenario!r} has {len(other.cell)} open samples and "
                f"{len(entry.cell)} hidden ones: run both with the same number."
            )
        found.append(_gap(other, entry))
    if not found:
        raise InputError(f"{open_run.path} and {hidden_run.path} have no method in common.")
    about, data = hidden_run.manifest, (open_run.manifest["data"], hidden_run.manifest["data"])
    return HiddenRecord(
        suite=about["plan"]["suite"]["name"],
        key=about["hidden"],
        made=str(about["started"])[:10],
        eitbench=str(about["versions"]["eitbench"]),
        git_commit=about["git_commit"],
        data={
            name: (data[0][name]["hash"], data[1][name]["hash"])
            for name in dict.fromkeys(gap.scenario for gap in found)
        },
        gaps=_tested(found),
    )


def _check_pair(open_run: Run, hidden_run: Run) -> None:
    for run, hidden in ((open_run, False), (hidden_run, True)):
        if run.kind != METHOD_RUNS:
            raise InputError(f"{run.path} is no run of imaging methods.")
        if bool(run.manifest.get("hidden")) != hidden:
            what = "of an open suite" if hidden else "of a hidden set"
            raise InputError(
                f"{run.path} is a run {what}: name the open run first, and that of the hidden set "
                "(eitbench hidden run) second."
            )
        if run.manifest["status"] != "finished":
            raise InputError(f"The run in {run.path} is not finished.")
    names = [run.manifest["plan"]["suite"]["name"] for run in (open_run, hidden_run)]
    if names[0] != names[1]:
        raise InputError(
            f"{open_run.path} is of suite {names[0]!r} and {hidden_run.path} of {names[1]!r}."
        )


def _entries(run: Run) -> dict[tuple[str, str], Entry]:
    return {
        (entry.row["scenario"], entry.row["method"]): entry
        for board in ranked_boards([run])
        for entry in board
    }


def _gap(open_entry: Entry, hidden_entry: Entry) -> Gap:
    rows = [open_entry.row, hidden_entry.row]
    by = ranking_figure(rows, METHOD_RUNS)
    # A method that failed on all hidden frames has none in its row, and charged ones in its cell.
    if by is None or rows[0][by] is None or by not in hidden_entry.cell:
        raise InputError(
            f"{rows[0]['method']!r} has no figure that ranks on {rows[0]['scenario']!r}."
        )
    spec = METHOD_RUNS.metrics[by]
    (before, drawn, some), (after, others, more) = (
        _drawn(entry, spec) for entry in (open_entry, hidden_entry)
    )
    difference, clusters = after - before, min(some, more)
    low = high = p = None
    if clusters >= MIN_CLUSTERS:
        # Both sets are drawn from with the same random numbers: moved by one, they are independent.
        differences = others - np.roll(drawn, 1, axis=0)
        low, high = map(float, intervals(np.asarray(difference), differences, clusters))
        t = float(student_t(difference, differences, clusters))
        p = float(2 * special.stdtr(clusters - 1, -abs(t)))
    return Gap(
        scenario=rows[0]["scenario"],
        method=rows[0]["method"],
        code=manifests.code_sha256(open_entry.run.manifest, rows[0]["method"]) or None,
        figure=by,
        n=len(open_entry.cell),
        clusters=clusters,
        open=before,
        hidden=after,
        difference=difference,
        low=low,
        high=high,
        p=p,
        falls=False,
    )


class _Drawn(NamedTuple):
    """A figure, its values in bootstrap draws, and the number of clusters."""

    value: float
    drawn: Array
    clusters: int


def _drawn(entry: Entry, spec: MetricSpec) -> _Drawn:
    cell = entry.cell.sort_values("sample")

    def figure(counts: Array) -> Array:
        return aggregate(cell, [spec], counts)[:, 0]

    clusters = cell["cluster"]
    value = float(once(figure, len(cell)))
    return _Drawn(value, draw(figure, clusters), int(clusters.nunique()))


def _tested(found: Sequence[Gap]) -> tuple[Gap, ...]:
    """The gaps with p adjusted for all of them, and what follows from it."""
    adjusted = iter(holm([gap.p for gap in found if gap.p is not None]))
    tested = []
    for gap in found:
        p = None if gap.p is None else float(next(adjusted))
        worse = METHOD_RUNS.metrics[gap.figure].sign * gap.difference < 0
        falls = p is not None and p < SIGNIFICANT and worse
        tested.append(gap.model_copy(update={"p": p, "falls": falls}))
    return tuple(tested)


def published_keys(version: Path) -> tuple[PublishedKey, ...]:
    """Read the hashes of keys beside the folder of a version; empty where there is no such file.

    Raises:
        InputError: the file declares something wrong.
    """
    path = version.resolve().parent / KEYS
    return read_declaration("Key", path, PublishedKeys).keys if path.is_file() else ()


def is_retired(keys: Iterable[PublishedKey], sha256: str) -> bool:
    """True if the key of this SHA-256 is published itself: anybody can draw its hidden set."""
    return any(of.sha256 == sha256 and of.retired for of in keys)


def write_hidden(record: HiddenRecord, version: Path) -> Path:
    """Keep the record in the folder of a version of the leaderboard, beside earlier ones.

    Raises:
        InputError: one of its gaps is there already, its key is published, or the hash of its key
            is not, for this suite and version.
    """
    keys = published_keys(version)
    wanted = version.resolve().name, record.suite, record.key
    if wanted not in {(of.version, of.suite, of.sha256) for of in keys}:
        raise InputError(
            f"The key of this hidden set was not published for suite {record.suite!r} in version "
            f"{wanted[0]}: figures are kept of keys whose hash was published before, in "
            f"{version.resolve().parent / KEYS}."
        )
    if is_retired(keys, record.key):
        raise InputError(
            f"The key of this hidden set of {record.suite!r} is published, so that anybody could "
            "prepare a method for it: figures that are kept need a new key."
        )
    there = [of for of in read_hidden(version) if of.suite == record.suite]
    known = {_of_code(gap) for of in there if of.key == record.key for gap in of.gaps}
    for gap in record.gaps:
        if _of_code(gap) in known:
            raise InputError(
                f"{version} has a figure of {gap.method!r} on the hidden set of {gap.scenario!r} "
                "already, and figures are never edited: run other methods, or make a new version."
            )
    path = version / FOLDER / f"{record.suite}-{_last_number(version, record.suite) + 1}.json"
    atomic_write(path, (record.model_dump_json(indent=1) + "\n").encode())
    return path


def _last_number(version: Path, suite: str) -> int:
    names = (path.stem for path in (version / FOLDER).glob(f"{suite}-*.json"))
    numbers = (name.removeprefix(f"{suite}-") for name in names)
    return max((int(number) for number in numbers if number.isdecimal()), default=0)


def _of_code(gap: Gap) -> tuple[str, str, str | None]:
    return gap.scenario, gap.method, gap.code


def read_hidden(version: Path) -> list[HiddenRecord]:
    """Read the records of a version of the leaderboard, of a suite the oldest first; may be empty.

    Raises:
        DataCorruptError: one of them is damaged.
    """
    found = []
    paths = (version / FOLDER).glob("*.json")
    for path in sorted(paths, key=lambda path: (len(path.name), path.name)):
        try:
            found.append(HiddenRecord.model_validate_json(read_json_file(path), strict=True))
        except (ValidationError, ValueError) as error:
            raise DataCorruptError(f"{path} is damaged: take it from the repository.") from error
    return found


def gap_of(records: Iterable[HiddenRecord], run: Run, scenario: str, method: str) -> Gap | None:
    """Return the gap of a method of `run`, if it was run on the hidden set of its data.

    It is the same method if it has the same name and code, and the same figure of the open set:
    with other parameters, weights or a newer package it has another.
    """
    plan, data = run.manifest["plan"], run.manifest["data"][scenario]["hash"]
    code = manifests.code_sha256(run.manifest, method) or None
    suite = plan["suite"]["name"]
    for record in records:
        if record.suite != suite or record.data.get(scenario, ("", ""))[0] != data:
            continue
        for gap in record.gaps:
            if _of_code(gap) == (scenario, method, code) and _has_figure(run, gap):
                return gap
    return None


def _has_figure(run: Run, gap: Gap) -> bool:
    """True if the method of a `gap` has its figure of the open set in `run`, too."""
    cell = run.cell(gap.scenario, gap.method)
    spec = METHOD_RUNS.metrics[gap.figure]
    if len(cell) != gap.n or spec.name not in cell:
        return False
    value = once(lambda counts: aggregate(cell, [spec], counts)[:, 0], len(cell))
    # Records have rounded figures of samples.
    return bool(np.isclose(float(value), gap.open, rtol=1e-4, atol=1e-6))
