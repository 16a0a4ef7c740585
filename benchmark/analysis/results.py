"""Reads run directories, and sums their rows up to a leaderboard."""

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from eitbench.benchmark.analysis.prior_knowledge_text import in_words
from eitbench.benchmark.metrics.aggregation import LOAD_COLUMNS, aggregate
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS
from eitbench.benchmark.metrics.statistics import once
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.arrays_file import TRUTH
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, RUN_KINDS, RunKind
from eitbench.benchmark.rundir.store import SAMPLES, TRACKS
from eitbench.benchmark.rundir.tables import read_parquet, wrong_kind
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError
from eitbench.scenarios.limits import GZIP_EXPANSION, most_bytes, own_dataset
from eitbench.scenarios.sensors.described_sensor import MAX_PIXELS

Row = dict[str, Any]

# What is known of a scenario's data beside its rows, if it is recorded.
NOTES = ("reciprocity_error", "repeat_noise", "guess_mm")
NOTES_FILE = "recordings.json"
_NOTES = TypeAdapter(dict[str, dict[str, float | None]], config=ConfigDict(strict=True))

# Columns beside labels, metrics and costs, by what they hold.
TEXTS = (
    "input_hash",
    "status",
    "message",
    "phantom",
    "family",
    "machine",
    "prior_knowledge",
    "differs",
)
NUMBERS = (
    *("sample", "snr_db", "x_m", "y_m", "cc_undefined", "calibration_ms", "overlap"),
    *METRIC_COLUMNS,
    *LOAD_COLUMNS,
)


@dataclass(frozen=True, eq=False)
class Scene:
    """What is known of the images of a scenario.

    Attributes:
        bounds: (x_min, y_min, x_max, y_max) [m].
        background: conductivity of the untouched sensor [S/m].
        data_range: [S/m].
        mask: (H, W) pixels of the sensor.
        sample: (n,) sample numbers of `truth`.
        truth: (n, H, W) true conductivity [S/m] or classes; None where neither is known.
        has_classes: whether `truth` holds classes: -1 resistive, 0, +1 conductive.
    """

    bounds: tuple[float, float, float, float]
    background: float
    data_range: float
    mask: NDArray[np.bool_]
    sample: NDArray[np.int64]
    truth: NDArray[np.float64] | None
    has_classes: bool


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

    def scenarios(self) -> list[str]:
        """Names of the scenarios that have rows, in the order of the run."""
        return [] if self.samples.empty else list(self.samples["scenario"].unique())

    def cell(self, scenario: str, method: str) -> pd.DataFrame:
        """The sample rows of one method on one scenario."""
        of = (self.samples["scenario"] == scenario) & (self.samples["method"] == method)
        return self.samples[of]

    def scene(self, scenario: str, samples: Sequence[int]) -> Scene:
        """What is known of a scenario, with the truth of the given samples."""
        with self._images() as file:
            group = self._group(file, scenario, TRUTH)
            numbers, mask = self._numbers(group), own_dataset(group, "mask", MAX_PIXELS**2)[:]
            rows = _rows_of(numbers, samples)
            names = [name for name in ("conductivity", "classes") if name in group]
            truth = None
            if names:
                images = own_dataset(group, names[0], self._most())
                if images.shape != (len(numbers), *mask.shape):
                    raise ValueError("images and mask are of unlike shapes")
                truth = images[rows].astype(np.float64)
            x0, y0, x1, y1 = (float(value) for value in group.attrs["bounds"])
            return Scene(
                bounds=(x0, y0, x1, y1),
                background=float(group.attrs["background"]),
                data_range=float(group.attrs["data_range"]),
                mask=mask.astype(bool),
                sample=numbers[rows],
                truth=truth,
                has_classes=names == ["classes"],
            )

    def estimates(
        self, scenario: str, method: str, samples: Sequence[int]
    ) -> NDArray[np.float32] | None:
        """Conductivity (k, H, W) [S/m] of the given samples, NaN where there was no valid output.

        None where the run holds none of these samples of this method.
        """
        with self._images() as file:
            group = self._group(file, scenario, method)
            numbers = self._numbers(group)
            stored = own_dataset(group, "conductivity", self._most())
            if stored.ndim != 3 or len(stored) != len(numbers):
                raise ValueError("there is not an image for each sample")
            known = np.isin(samples, numbers)
            if not known.any():
                return None
            if 4 * len(samples) * math.prod(stored.shape[1:]) > self._most():
                raise ValueError("it claims to be larger than the file")
            images = np.full((len(samples), *stored.shape[1:]), np.nan, np.float32)
            images[known] = stored[_rows_of(numbers, np.array(samples)[known])]
            return images

    def _numbers(self, group: h5py.Group) -> NDArray[np.int64]:
        """Sample numbers (n,) of the images of a group."""
        return np.asarray(own_dataset(group, "sample", self._most())[:], dtype=np.int64)

    def _most(self) -> int:
        return most_bytes(self.path / self.kind.arrays, GZIP_EXPANSION)

    @contextmanager
    def _images(self) -> Iterator[h5py.File]:
        path = self.path / self.kind.arrays
        try:
            with h5py.File(path, "r") as file:
                yield file
        except EitbenchError:
            raise
        # HDF5 fails in whatever way the damage leads to.
        except Exception as error:
            raise DataCorruptError(f"{path} cannot be read: resume the run.") from error

    def _group(self, file: h5py.File, scenario: str, name: str) -> h5py.Group:
        try:
            return file[f"{scenario}/{name}"]
        except KeyError as error:
            raise DataCorruptError(
                f"{self.path / self.kind.arrays} holds no images of {name!r} on scenario "
                f"{scenario!r}: resume the run."
            ) from error


def _rows_of(numbers: NDArray[np.int64], samples: Iterable[int]) -> list[int]:
    """Row numbers of the given samples, rising as HDF5 wants them; samples are stored in order."""
    return sorted(np.flatnonzero(np.isin(numbers, list(samples))).tolist())


def read_run(path: Path) -> Run:
    """Read a run directory.

    Raises:
        InputError: it is none, or its run was not finished.
        DataCorruptError: one of its files is damaged.
    """
    content = path / manifest.FILE_NAME
    if not content.is_file():
        raise InputError(f"{path} is not a run directory: it holds no {manifest.FILE_NAME}.")
    kinds = [kind for kind in RUN_KINDS.values() if (path / kind.table).is_file()]
    if not (path / SAMPLES).is_file() or not kinds:
        raise InputError(
            f"The run in {path} has no results yet: finish it with `eitbench run --resume {path}`."
        )
    notes, kind = path / NOTES_FILE, kinds[0]
    labels = ("scenario", kind.name, *kind.labels)
    told = read_json(content)
    manifest.check_kinds(told, content)
    samples = checked_table(path / SAMPLES, kind, ("suite", *labels, "sample", "status"))
    cells = checked_table(path / kind.table, kind, labels)
    if len(samples) and cells.empty:
        raise DataCorruptError(f"{path / kind.table} is empty: run again.")
    return Run(
        path,
        kind,
        told,
        samples,
        cells,
        _read_notes(notes) if notes.is_file() else {},
        checked_table(path / TRACKS, kind, labels) if (path / TRACKS).is_file() else pd.DataFrame(),
    )


def checked_table(path: Path, kind: RunKind, needed: Iterable[str] = ()) -> pd.DataFrame:
    """A table of a run directory with all `needed` columns, and each of the right kind.

    Raises:
        DataCorruptError: it is none.
    """
    table = read_table(path)
    for name in needed:
        if len(table) and name not in table:
            raise DataCorruptError(f"{path} has no column {name!r}: run again.")
    texts = ("suite", "scenario", kind.name, *kind.labels, *kind.facts, *TEXTS)
    if wrong := wrong_kind(table, texts, (*kind.metrics, *kind.costs, *NUMBERS)):
        raise DataCorruptError(f"The column {wrong!r} of {path} is damaged: run again.")
    if "prior_knowledge" in table:
        try:
            for told in table["prior_knowledge"].unique():
                in_words(_text(told))
        except ValueError as error:
            raise DataCorruptError(
                f"The column 'prior_knowledge' of {path} is damaged: run again."
            ) from error
    return table


def _read_notes(path: Path) -> dict[str, dict[str, float | None]]:
    try:
        return _NOTES.validate_python(read_json(path))
    except ValidationError as error:
        raise DataCorruptError(f"{path} does not hold figures of recordings: run again.") from error


def failures(run: Run) -> list[str]:
    """One sentence for each method or operator that failed on a scenario, with its first reason."""
    subject = run.kind.name
    failed = run.samples[run.samples["status"] != "ok"]
    return [
        f"{name!r} on {scenario!r}: {len(rows)} samples failed, the first ({rows.iloc[0]['status']}"
        f"): {' '.join(str(rows.iloc[0]['message']).split())}"
        for (scenario, name), rows in failed.groupby(["scenario", subject], sort=False)
    ]


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object of a run directory.

    Raises:
        DataCorruptError: it is none.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise DataCorruptError(f"{path} is not valid JSON: run again.") from error
    if not isinstance(content, dict):
        raise DataCorruptError(f"{path} does not hold a JSON object: run again.")
    return content


def read_table(path: Path) -> pd.DataFrame:
    """A Parquet file of a run directory.

    Raises:
        DataCorruptError: it cannot be read.
    """
    try:
        return read_parquet(path)
    # Damaged tables fail in whatever way the damage leads to.
    except Exception as error:
        raise DataCorruptError(f"{path} is not a readable Parquet file: run again.") from error


@dataclass(frozen=True, eq=False)
class Entry:
    """A method or operator on a board.

    Attributes:
        run: where it was run.
        row: its row of the leaderboard.
        cell: its samples.
    """

    run: Run
    row: Row
    cell: pd.DataFrame


def leaderboard_rows(runs: Sequence[Run]) -> list[Row]:
    """One row per run, scenario and method (or operator), ranked among those of the same data.

    Figures are means over the samples (localisation: the median), of which failed ones are charged
    what an image of the untouched sensor gets; None where not defined, or where all failed. The
    best value has rank 1, those that lack samples come after those that have all, those without a
    figure last, and equals share a rank. Operators have figures of their valid samples only, and
    rank after those that lost none.

    Raises:
        InputError: some of the runs rank methods and others operators.
    """
    return [entry.row for board in ranked_boards(runs) for entry in board]


def ranked_boards(runs: Sequence[Run]) -> list[list[Entry]]:
    """The rows of `leaderboard_rows` with what they come from, those of the same data together.

    Raises:
        InputError: some of the runs rank methods and others operators, or two share a name.
    """
    for run in runs:
        if run.kind != runs[0].kind:
            raise InputError(
                f"{runs[0].path} ranks {runs[0].kind.name}s and {run.path} {run.kind.name}s: ask "
                "for their leaderboards one after the other."
            )
    for name, count in Counter(run.path.name for run in runs).items():
        if count > 1:
            raise InputError(f"{count} of the runs are called {name!r}: give their folders names.")
    entries = [
        Entry(run, _row(run, keys, cell), cell) for run in runs for keys, cell in _cells(run)
    ]
    ranked = []
    for rows in boards(entry.row for entry in entries):
        kind = runs[0].kind
        _rank(rows, kind)
        of = [entry for entry in entries if any(entry.row is row for row in rows)]
        ranked.append(sorted(of, key=lambda entry: (entry.row["rank"], entry.row[kind.name])))
    return ranked


def boards(rows: Iterable[Row]) -> list[list[Row]]:
    """The rows that may be compared, together: of one suite, scenario and data."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        key = tuple(row[name] for name in ("suite", "scenario", "data_hash", "data_n"))
        found.setdefault(key, []).append(row)
    return list(found.values())


def _cells(run: Run) -> Iterable[tuple[Row, pd.DataFrame]]:
    if run.samples.empty:
        return
    keys = ["suite", "scenario", run.kind.name, *run.kind.labels]
    for values, cell in run.samples.groupby(keys, sort=False):
        yield dict(zip(keys, map(str, values), strict=True)), cell


def _row(run: Run, keys: Row, cell: pd.DataFrame) -> Row:
    kind = run.kind
    valid = cell[cell["status"] == "ok"]
    data = run.manifest.get("data", {}).get(keys["scenario"], {})
    row: Row = {
        **keys,
        "run": run.path.name,
        "n": len(cell),
        "coverage": len(valid) / len(cell),
        "rank": None,
    }
    of = run.cells
    for name in ("scenario", kind.name, *kind.labels):
        of = of[of[name] == keys[name]]
    known: Row = dict(of.iloc[0]) if len(of) else {}
    # Failed samples of methods hold what an image of the untouched sensor gets.
    counted = cell if kind == METHOD_RUNS and len(valid) else valid
    specs = tuple(kind.metrics.values())
    figures = once(lambda counts: aggregate(counted, specs, counts), len(counted))
    for spec, value in zip(specs, figures, strict=True):
        row[spec.name] = _plain(known.get(spec.name) if spec.aggregate is None else value)
    for name in kind.costs:
        row[name] = _plain(known.get(name))
    for name in kind.facts:
        row[name] = str(known.get(name, ""))
    row |= {"data_hash": data.get("hash"), "data_n": data.get("n")}
    row["inverse_crime"] = data.get("inverse_crime")
    row["machine"] = _text(known.get("machine")) or None
    if kind == METHOD_RUNS:
        solve = known.get("calibration_ms")
        frame = row["frame_ms_p50"]
        row["frame_solves"] = _plain(frame / solve if solve and frame is not None else None)
        noted = run.notes.get(keys["scenario"], {})
        row |= {name: _plain(noted.get(name)) for name in NOTES}
        row["prior_knowledge"] = in_words(_text(known.get("prior_knowledge")))
        row["overlap"] = _plain(known.get("overlap"))
    return row


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _plain(value: Any) -> float | None:
    number = float("nan") if value is None else float(value)
    return number if np.isfinite(number) else None


def is_whole(row: Row) -> bool:
    """Whether a row is of all samples of its scenario, or as far as is known."""
    return row["data_n"] is None or row["n"] >= row["data_n"]


def ranking_figure(board: Iterable[Row], kind: RunKind) -> str | None:
    """The name of the figure that ranks the rows of one scenario; None where none has one."""
    rows = list(board)
    return next((n for n in kind.ranked_by if any(row[n] is not None for row in rows)), None)


def _rank(board: list[Row], kind: RunKind) -> None:
    """Give the rows of one scenario their ranks, 1 the best."""
    name = ranking_figure(board, kind)
    keys = [_place(row, name, kind) for row in board]
    for row, key in zip(board, keys, strict=True):
        row["rank"] = 1 + sum(other < key for other in keys)


def _place(row: Row, name: str | None, kind: RunKind) -> tuple[bool, bool, float]:
    """Sorts rows from the best to the worst."""
    value = None if name is None else row[name]
    if name is None or value is None:
        return True, True, 0.0
    lost = not is_whole(row) or (kind != METHOD_RUNS and row["coverage"] < 1)
    return False, lost, -kind.metrics[name].sign * value
