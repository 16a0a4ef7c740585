"""Records of the leaderboard: made from whole runs, small enough to be kept in git."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pandas as pd
from pandas.api.types import is_float_dtype

from eitbench.benchmark import InputError, atomic_write, atomic_write_json
from eitbench.benchmark.analysis.recording_notes import noted
from eitbench.benchmark.analysis.results import (
    BUSY,
    NOTES_FILE,
    SHOWN,
    Run,
    fastest_solves,
    read_run,
)
from eitbench.benchmark.findings.acuity_seen import SEEN_FILE, seen_table
from eitbench.benchmark.findings.drift import ALARMS_FILE, alarms
from eitbench.benchmark.run.timing import CALM_LOAD, PATIENCE_S, calibration_solves
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.few_bytes import packed, rounded, with_short_hashes
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import TRUTH, Scene
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.submissions.sums import note_sums
from eitbench.reports.board.changes import VERSION, checksums, version_key
from eitbench.reports.board.further_methods import (
    check_joins,
    joined,
    joined_manifest,
    on_frames_of,
    without_replaced,
)
from eitbench.reports.figures.cases import case_samples
from eitbench.reports.page.images import FEW_STEPS, shown_families, shown_samples

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

TIMES = ("frame_ms", "uncertainty_ms", "novelty_ms", "forward_ms", "grad_ms")
"""Columns of samples with what a method or operator took."""

SPEEDS = (
    *("frame_ms_p50", "frame_ms_p95", "frame_ms_p99"),
    *("first_frame_ms", "forward_ms", "grad_ms", "batch_fps"),
)
"""Columns of cells with a speed of a method or operator, which the load of the machine changes."""

STEPS = 125
"""Values of an image over its range: images of records are rounded to these (`picture_step`); to
`FEW_STEPS` where there are so many that a page shows no more of them."""

PLACE_STEP = 2**-17
"""Places in images are rounded to whole steps [m], of 8 um: they are drawn; errors are figures."""

COMPRESSION: dict[str, Any] = {"compression": "brotli", "compression_level": 11}
"""Of tables: a sixth smaller than gzip makes them."""


def write_record(run_path: Path, out: Path, older: Path | None = None) -> Path:
    """Keep a whole run of a suite as a record in the new folder `out`.

    Args:
        run_path: the run.
        out: the record.
        older: a record of the same frames, from which the rows of methods that the run lacks are
            taken; without one the run has to have all.

    Raises:
        InputError: the run is not finished, limited, or not of all methods (or operators) and
            scenarios of its suite; or one failed on all samples of a scenario; or there is a record
            already, which is never edited.
        DataCorruptError: it cannot be read.
    """
    check_new(out)
    run, kept = read_run(run_path), None if older is None else read_run(older)
    if why := _never(run):
        raise InputError(f"{run_path} is no whole run: {why}.")
    cells = _without_busy_times(run, out).assign(checksums=checksums(run))
    # All methods repeat the hashes of frames.
    samples = with_short_hashes(run.samples)
    notes, seen, found = run.notes | noted(run.manifest), seen_table(run), alarms(run)
    content = _without_paths(run.manifest) | {"images": SHOWN}
    if kept is not None:
        kept = without_replaced(kept, run)
        check_joins(kept, run)
        named, notes = on_frames_of(kept, samples), kept.notes | notes
        same_bits = bool((named["input_hash"] == samples["input_hash"]).all())
        samples = joined(run, kept.samples, named)
        cells = joined(run, kept.cells, cells)
        seen = joined(run, seen_table(kept), seen)
        found = joined(run, alarms(kept), found)
        content = joined_manifest(kept.manifest, content, same_bits)
    if lacking := _lacking(run, content, cells) or _failed(run, samples):
        raise InputError(f"{run_path} is no whole run: {lacking}.")
    staged = out.with_name(f".{out.name}.part")
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    if notes:
        atomic_write_json(staged / NOTES_FILE, notes)
    cells.to_parquet(staged / run.kind.table, index=False, **COMPRESSION)
    _write_rounded(samples, staged / SAMPLES)
    # A line for each entry, for git, and no blanks.
    text = json.dumps(content, indent=0, separators=(",", ":"), allow_nan=False) + "\n"
    atomic_write(staged / manifest.FILE_NAME, text.encode())
    if run.kind is METHOD_RUNS:  # operators have no images
        columns = len(cells) + cells["scenario"].nunique()  # with the truth of each scenario
        steps = STEPS if shown_families(columns) > 1 else FEW_STEPS
        _write_images(run, kept, staged / run.kind.arrays, steps)
        if not seen.empty:
            _write_rounded(seen, staged / SEEN_FILE)
        if not found.empty:
            found.to_parquet(staged / ALARMS_FILE, index=False, **COMPRESSION)
    staged.rename(out)
    note_sums(sorted(out.iterdir()))
    return out


def _without_paths(content: manifest.Manifest) -> manifest.Manifest:
    """The manifest of a run with commands that anybody can repeat, in place of those as typed.

    These name folders of one machine; the number of jobs has an entry of its own.
    """
    again = {"command_line": f"eitbench board {content['plan']['suite']['name']} --runs RUNS"}
    return content | again | {"resumed": [entry | again for entry in content["resumed"]]}


def _write_rounded(table: pd.DataFrame, path: Path) -> None:
    """Write a table with a row for each sample to `path`, in a quarter of what a run takes.

    The bytes of numbers, which are `rounded`, are split, so that equal ones stand beside each
    other; texts are written once. A column is one page: pages are compressed apart, and methods
    repeat the description of every frame.
    """
    numbers = [str(name) for name in table if is_float_dtype(table[name])]
    others = [name for name in table if name not in numbers]
    few = {name: rounded(table[name]) for name in numbers}
    for name in few.keys() & {"found_x_m", "found_y_m"}:
        few[name] = np.round(table[name] / PLACE_STEP) * PLACE_STEP
    table.assign(**few).to_parquet(
        path,
        index=False,
        use_dictionary=others,
        use_byte_stream_split=numbers,
        dictionary_pagesize_limit=2**28,
        max_rows_per_page=2**28,
        write_page_checksum=True,
        **COMPRESSION,
    )


def _without_busy_times(run: Run, out: Path) -> pd.DataFrame:
    """The cells of a run without those times that were measured beside something else.

    There the calibration solve took much longer than the fastest that this run and other records
    know of the same machine, or other programs kept cores busy. A ratio of the two would mislead,
    too: the load changes meanwhile, and programs that share a cache slow networks down by more.
    """
    cells = run.cells.copy()
    fastest = _fastest(out.parents[1], run)
    cells["busy"] = cells["calibration_ms"] > BUSY * cells["machine"].map(fastest)
    cells["busy"] |= cells["load"] > CALM_LOAD
    cells.loc[cells["busy"], [name for name in SPEEDS if name in cells]] = np.nan
    return cells


def calm_ms(records: Path) -> float:
    """The most that the calibration solve may take beside what a record has times of, here [ms]."""
    solves = [*calibration_solves(), *calibration_solves()]
    return BUSY * min(_fastest(records).get(manifest.cpu_model(), np.inf), *solves)


def _fastest(records: Path, *runs: Run) -> dict[str, float]:
    """The fastest calibration solve of each machine of `runs` and of all records [ms]."""
    others = [read_run(path.parent) for path in sorted(records.glob(f"2*/*/{manifest.FILE_NAME}"))]
    fastest: dict[str, float] = {}
    for of in (*runs, *others):
        for machine, solve in fastest_solves(of.cells, of.manifest).items():
            fastest[machine] = min(solve, fastest.get(machine, np.inf))
    return fastest


def check_version(version: str) -> None:
    """Check that there can be a version of this name.

    Raises:
        InputError: it is no year and number.
    """
    if not VERSION.fullmatch(version):
        raise InputError(f"A version is a year and a number, such as 2026.1; got {version!r}.")


def check_new(out: Path) -> None:
    """Check that there is no record in `out`, which is `RECORDS/VERSION/SUITE`, and can be one.

    Raises:
        InputError: there is one, no such version can be, or a file is in the way.
    """
    check_version(out.parent.name)
    in_the_way = [path for path in out.parents if path.exists() and not path.is_dir()]
    if in_the_way:
        raise InputError(f"{in_the_way[0]} is a file: name a folder for records with --records.")
    if out.exists():
        raise InputError(
            f"{out} is there already, and records are never edited: give a new --version."
        )


def _never(run: Run) -> str:
    """Why nothing makes a record of a run, as a part of a sentence; "" if something may."""
    if run.manifest.get("hidden"):
        return "it holds frames of a hidden set, of which only figures are published"
    if not run.whole:
        return "it is a record itself, with images of few samples"
    if run.manifest["plan"]["limit"] != manifest.suite_of(run.manifest).limit:
        return "it was limited to some test samples"
    return ""


def _lacking(run: Run, content: manifest.Manifest, cells: pd.DataFrame) -> str:
    """What a record with these `cells` lacks of its suite, as a part of a sentence; or ""."""
    suite = manifest.suite_of(run.manifest)
    left_out = {**content["skipped"], **content["refused"]}
    ran = set(zip(cells["scenario"], cells[run.kind.name], strict=True))
    for scenario in (s.name for s in suite.scenarios):
        if scenario not in set(cells["scenario"]):
            return f"it lacks the scenario {scenario!r}"
        for name in suite.names:
            if (scenario, name) not in ran and f"{scenario}/{name}" not in left_out:
                return f"it lacks the {run.kind.name} {name!r} on {scenario!r}"
    return ""


def _failed(run: Run, samples: pd.DataFrame) -> str:
    """Which method has failed on all samples of a scenario, as a part of a sentence; or ""."""
    of_cell = ["scenario", run.kind.name]
    worked = (
        samples.assign(ok=samples["status"] == "ok").groupby(of_cell, observed=True)["ok"].any()
    )
    for scenario, name in worked.index[~worked]:
        return f"the {run.kind.name} {name!r} failed on all samples of {scenario!r}"
    return ""


def _write_images(run: Run, kept: Run | None, path: Path, steps: int) -> None:
    """Write truth and images of the samples that are shown, rounded to `steps`.

    Beside `kept` images they are of the samples that these are of.
    """
    # The newest format takes 4 kB less for each group.
    with h5py.File(path, "w", libver="latest") as out:
        if kept is not None:
            _copy_images(kept, run, out)
        _add_images(run, out, steps)


def _copy_images(kept: Run, run: Run, out: h5py.File) -> None:
    """Copy the images of a record, but those of what was run again."""
    with h5py.File(kept.path / kept.kind.arrays, "r") as older:
        for scenario in kept.scenarios():
            stay, again = (
                set(of.cells.loc[of.cells["scenario"] == scenario, run.kind.name])
                for of in (kept, run)
            )
            for name in older[scenario].keys() & ({TRUTH} | stay - again):
                older.copy(f"{scenario}/{name}", out.require_group(scenario))


def _add_images(run: Run, out: h5py.File, steps: int) -> None:
    """Add the images of a run, of the samples whose truth is there if it is."""
    with h5py.File(run.path / run.kind.arrays, "r") as file:
        for scenario in run.scenarios():
            of, groups = file[scenario], set(file[scenario])
            shown = {*shown_samples(run, scenario), *case_samples(run, scenario)}
            if scenario in out:
                shown = set(out[f"{scenario}/{TRUTH}/sample"][:].tolist())
                groups.remove(TRUTH)
            scene = run.scene(scenario, sorted(shown))
            for name in sorted(groups):
                _write_group(of[name], scene, out.create_group(f"{scenario}/{name}"), steps)
                assert name == TRUTH or run.kind.array in out[f"{scenario}/{name}"]


def picture_step(images: NDArray[np.floating], scene: Scene, steps: int) -> float:
    """The step [S/m] to which images (n, H, W) are rounded, of which a picture has `steps`.

    They are of the data range; where no truth gives pictures their colours, of the images' own
    contrast, which on real sensors is a small part of it.
    """
    largest = float(np.nan_to_num(np.abs(images - scene.background)).max(initial=0.0))
    if scene.truth is not None or not largest:
        return scene.data_range / steps
    # An image has 15 bits for its values, and these are near to the background.
    return max(largest / steps, scene.background / 2**14)


def _write_group(group: h5py.Group, scene: Scene, out: h5py.Group, steps: int) -> None:
    """Write what a run keeps of a method, or of the truth, for the samples of the `scene`."""
    out.attrs.update(group.attrs)
    rows = np.flatnonzero(np.isin(group["sample"][:], scene.sample))
    out["sample"] = group["sample"][:][rows]
    for key in group.keys() - {"sample", "validation"}:
        values = group[key][:] if key == "mask" else group[key][rows]
        images = values.dtype.kind == "f" and values.ndim > 1
        step = picture_step(values, scene, steps) if images else 0.0
        values = packed(values, step) if images else values
        layout = {"compression": "gzip", "compression_opts": 9, "shuffle": True}
        stored = out.create_dataset(key, data=values, **(layout if values.ndim > 1 else {}))
        if images:
            stored.attrs["step"] = step


def cost(
    suite: str, records: Path, names: Sequence[str] = (), scenarios: Sequence[str] = ()
) -> str:
    """What a run of a `suite` cost when it was last recorded in `records`, as a sentence.

    It is of all its methods and scenarios, or of those with `names` on `scenarios`.
    """
    found = list(records.glob(f"2*/{suite}/{manifest.FILE_NAME}"))
    if not found:
        return f"The cost of {suite!r} is not known: no version has a record of it."
    newest = max(found, key=lambda path: version_key(path.parents[1].name))
    run = read_run(newest.parent)
    size = sum(path.stat().st_size for path in run.path.iterdir()) / 1e6
    if scenarios:
        samples, cells = (of[of["scenario"].isin(scenarios)] for of in (run.samples, run.cells))
        run = replace(run, samples=samples, cells=cells)
    what = ", ".join(names) or f"all {run.kind.name}s"
    on = f"{suite!r} ({', '.join(scenarios)})" if scenarios else repr(suite)
    spent = spent_s(run).reindex(list(names) or run.cells[run.kind.name].unique()).dropna()
    if spent.empty:
        return f"The cost of {what} on {on} is not known: no version has it."
    slowest = spent.idxmax()
    frames = pd.Series({name: run.n(name) for name in run.scenarios()}).sum()
    return (
        f"On {on}, {what} took {spent.sum() / 60:.1f} "
        f"minutes on one core for at most {frames:,} frames each in version "
        f"{newest.parents[1].name}, data and scoring not counted, most of it {slowest!r}; its "
        f"record has {size:.1f} MB. With one job, "
        f"up to {PATIENCE_S:g} s more for each of "
        f"{len(spent) * len(run.scenarios())} cells while the machine is busy."
    )


def spent_s(run: Run) -> pd.Series:
    """Time [s] of each method or operator of a run, frames and set-up together."""
    name = run.kind.name
    times = [column for column in TIMES if column in run.samples]
    frames = run.samples.groupby(name)[times].sum().sum(axis=1) / 1e3
    return frames.add(run.cells.groupby(name)["setup_s"].sum(), fill_value=0)
