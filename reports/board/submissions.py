"""Submissions: a run as a folder that a pull request can hold, to be checked by anybody."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import h5py
import numpy as np

from eitbench.benchmark import InputError, atomic_write_json
from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import NOTES_FILE, ROUNDED
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import TRUTH, rounded_images
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.submissions.check import check_submission
from eitbench.benchmark.submissions.statement import STATEMENT, Statement
from eitbench.benchmark.submissions.submission import open_submission
from eitbench.reports.tables.leaderboard import ranked_rows, write_leaderboard

TOLERANCE, TOLERANCE_MM = 1e-3, 0.1
"""By which rounding images may change a figure that ranks a method, in its unit and in mm; and by
as much of the figure as the first. A pixel of our sensors is wider than 1 mm, and a median of few
presses jumps from one press to the next. Figures that rank nothing may move: shares, counts and
ranks of few presses jump by a whole press where one of them crosses a limit."""


@dataclass(frozen=True)
class Written:
    """The folder of a submission.

    Attributes:
        folder: the folder.
        moved: the figure that rounding moved most beyond the tolerance, so that images are as they
            were, as a part of a sentence; "" where they are rounded.
        size: of all its files [bytes].
    """

    folder: Path
    moved: str
    size: int


def write_submission(run: Path, out: Path, *, jobs: int = 1) -> Written:
    """Write the run directory `run` as a submission into the new folder `out`.

    Images are rounded (`rounded_images`), and figures computed again from these, where that changes
    no figure that ranks a method by more than is tolerated. `submission.json` is to be filled in.

    Raises:
        InputError: `submission check` would refuse the run, for the same reason; or `out` is there,
            or its name is none of a submission.
        DataUnavailableError, DataCorruptError: data or the run cannot be read.
    """
    if not re.fullmatch("[a-z0-9-]+", out.name):
        raise InputError(
            f"{out.name!r} cannot name a submission: give --out a folder whose name has small "
            "letters, digits and hyphens alone."
        )
    if out.exists():
        raise InputError(f"{out} is there already: name a new folder with --out.")
    if out.name == manifest.read(run)["plan"]["suite"]["name"]:
        raise InputError(f"{out.name!r} is the name of the suite: give the folder another one.")
    if (run / STATEMENT).is_file():
        raise InputError(f"{run} is a submission already.")
    problems = [of.problem for of in check_submission(open_submission(run, jobs=jobs))]
    if any(problems):
        raise InputError(next(filter(None, problems)))
    staged = out.with_name(f".{out.name}.part")
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    for name in (manifest.FILE_NAME, SAMPLES, METHOD_RUNS.table, NOTES_FILE):
        if (run / name).is_file():
            shutil.copyfile(run / name, staged / name)
    if (run / "plugins").is_dir():
        shutil.copytree(run / "plugins", staged / "plugins")
    arrays = METHOD_RUNS.arrays
    _round_images(run / arrays, staged / arrays)
    content = _without_folders(manifest.read(run))
    atomic_write_json(staged / manifest.FILE_NAME, content | {"images": ROUNDED})
    rescore(staged)
    if moved := _moved(run, staged):
        atomic_write_json(staged / manifest.FILE_NAME, content)
        for name in (SAMPLES, arrays):
            shutil.copyfile(run / name, staged / name)
    write_leaderboard(ranked_rows([staged]), staged, ("json",))
    atomic_write_json(staged / STATEMENT, Statement().model_dump())
    staged.rename(out)
    return Written(out, moved, sum(p.stat().st_size for p in out.rglob("*") if p.is_file()))


def _without_folders(content: manifest.Manifest) -> manifest.Manifest:
    """The manifest without folders of the machine that the run was made on, which is published."""
    plan = content["plan"]
    plugins = [of | {"path": Path(of["path"]).name} for of in plan["plugins"]]
    return content | {
        "plan": plan | {"plugins": plugins},
        "command_line": _without_folder(content["command_line"]),
        "resumed": [
            of | {"command_line": _without_folder(of["command_line"])} for of in content["resumed"]
        ],
    }


def _without_folder(command: str) -> str:
    """The command with the names of files and folders alone."""
    words = []
    for word in shlex.split(command):
        option, equals, value = word.rpartition("=")  # --out=RUN
        # Neither the address of a cluster nor parameters, which are JSON, are paths.
        path = re.search(r"[/\\]", value) and not re.search(r"://|^[{\[]", value)
        words.append(option + equals + (PureWindowsPath(value).name if path else value))
    return shlex.join(words)


def _round_images(source: Path, target: Path) -> None:
    """Copy the arrays of a run with rounded images; those that register a method stay whole."""
    with h5py.File(source, "r") as file, h5py.File(target, "w") as kept:
        for scenario, groups in file.items():
            background = float(groups[TRUTH].attrs["background"])
            for name, group in groups.items():
                of = kept.create_group(f"{scenario}/{name}")
                of.attrs.update(group.attrs)
                for key, stored in group.items():
                    values = stored[:]
                    if name != TRUTH and key == METHOD_RUNS.array:
                        values, _ = rounded_images(values, background)
                    layout = {
                        "chunks": stored.chunks, "compression": "gzip", "compression_opts": 9,
                        "shuffle": True,
                    }  # fmt: skip
                    of.create_dataset(key, data=values, **(layout if stored.chunks else {}))


def _moved(run: Path, rounded: Path) -> str:
    """The figure that ranks and differs most beyond the tolerance, in words; "" if none does."""
    before, after = (ranked_rows([path]) for path in (run, rounded))
    rows = {(row["scenario"], row["method"]): row for row in after}
    found = []
    for row in before:
        other = rows[row["scenario"], row["method"]]
        for name in METHOD_RUNS.ranked_by:
            one, two = (np.nan if of[name] is None else of[name] for of in (row, other))
            allowed = TOLERANCE_MM if METHOD_RUNS.metrics[name].unit == "mm" else TOLERANCE
            if not np.isclose(one, two, rtol=TOLERANCE, atol=allowed, equal_nan=True):
                change = abs(two - one)
                said = f"{name} of {row['method']!r} on {row['scenario']!r} by {change:.2g}"
                found.append((-np.nan_to_num(change, nan=np.inf), said))
    return min(found)[1] if found else ""
