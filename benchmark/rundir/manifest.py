"""The manifest of a run: its plan, data, versions and machine."""

import importlib.metadata
import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import psutil
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import eitbench
from eitbench.benchmark.rundir.folder import check_folder, read_json_file
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.suites.suite import Suite

FILE_NAME = "manifest.json"
ADDED = "added"
"""Entry of a manifest: the runs that a record took later `cells` from, as SCENARIO/METHOD."""
MOST_SAMPLES = 1_000_000
"""Of a scenario: more would fill memory wherever its images are read."""
PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "torch",
    "pandas",
    "h5py",
    "pyarrow",
    "netgen-mesher",
    "threadpoolctl",
    "pyeit",
)

Manifest = dict[str, Any]


def now() -> str:
    """The time in UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def environment() -> Manifest:
    """Versions, machine and git commit, which a reader needs to assess or repeat a run."""
    return {
        "versions": versions(),
        "machine": machine(),
        "git_commit": git_commit(),
    }


def versions() -> dict[str, str | None]:
    """Versions of Python, eitbench and the libraries that shape the numbers."""
    found: dict[str, str | None] = {
        "python": platform.python_version(),
        "eitbench": eitbench.__version__,
    }
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
    return found


def changed_versions(before: Mapping[str, str | None]) -> list[str]:
    """The packages of `versions` that have another one now than `before`."""
    return [name for name, version in versions().items() if version != before.get(name)]


def machine() -> dict[str, str | int | None]:
    """Processor, cores, memory and operating system; no host or user name."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "memory_mb": psutil.virtual_memory().total // 2**20,
        "os": platform.platform(),
    }


CPUINFO = Path("/proc/cpuinfo")


@cache
def cpu_model() -> str:
    """The processor's name, with its family and model (or maker and part) where Linux tells them.

    Virtual machines give processors of different speed, and of different rounding, one name.
    """
    known: dict[str, str] = {}
    if CPUINFO.is_file():
        for line in CPUINFO.read_text(errors="replace").splitlines():
            key, _, value = line.partition(":")
            if value.strip():  # of several processors the first
                known.setdefault(key.strip(), value.strip())
    name = known.get("model name") or platform.processor() or platform.machine()
    kind = ", ".join(f"{key} {known[of]}" for key, of in _KINDS.items() if of in known)
    return f"{name} ({kind})" if kind else name


_KINDS = {
    "family": "cpu family", "model": "model", "maker": "CPU implementer", "part": "CPU part",
}  # fmt: skip
"""What tells processors apart, by the names that Linux has for it on x86 and on ARM."""


def git_commit() -> str | None:
    """The commit of the checkout eitbench runs from, "-dirty" if changed; None if installed."""
    root = Path(eitbench.__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    try:
        commit = _git(root, "rev-parse", "HEAD")
        return commit + ("-dirty" if _git(root, "status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-C", str(root), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10)
    return done.stdout.strip()


def command_line() -> str:
    """The command as a shell takes it, its program without the folder."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Line = Annotated[str, Field(max_length=200)]


class _Part(BaseModel):
    """Values of the right kinds; what is not declared is only printed."""

    model_config = ConfigDict(strict=True, frozen=True)


class _Data(_Part):
    hash: str
    n: Annotated[int, Field(ge=0, le=MOST_SAMPLES)]
    inverse_crime: bool | None
    sensor: _Line


class _Plugin(_Part):
    path: str
    sha256: str
    names: list[str]


class _Suite(_Part):
    name: _Line
    scenarios: list[dict[str, Any]]


class _Plan(_Part):
    suite: _Suite
    names: list[str]
    scenarios: list[str]
    limit: int | None
    plugins: list[_Plugin]


class _Resumed(_Part):
    """When a run went on, and by which code."""

    time: _Line
    git_commit: _Line | None


class _Added(_Part):
    """A run that a record took later cells from."""

    cells: list[_Line]
    same_bits: bool
    started: _Line
    machine: dict[str, _Line | int | float | None]
    versions: dict[str, _Line | None]
    git_commit: _Line | None
    resumed: list[_Resumed] = []


class _Cell(_Part):
    parameters: dict[str, Any] = {}


class _Manifest(_Part):
    """Values that results are shown from."""

    status: str
    plan: _Plan
    data: dict[_Line, _Data]
    cells: list[_Cell]
    machine: dict[str, _Line | int | float | None]
    versions: dict[str, _Line | None]
    skipped: dict[str, str]
    calibration_ms: _Positive
    started: _Line
    git_commit: _Line | None
    resumed: list[_Resumed] = []
    hidden: _Line | None = None
    added: list[_Added] = []


def read(run: Path) -> Manifest:
    """Read the manifest of the run directory `run`, after a look at all that the directory holds.

    Raises:
        InputError: `run` holds none.
        DataCorruptError: it is damaged, or something in the directory is no file.
    """
    path = run / FILE_NAME
    if not path.is_file():
        inside = sorted(path.parent for path in run.glob(f"*/{FILE_NAME}"))
        instead = f"; {inside[0]} is one" if inside else ""
        raise InputError(f"{run} is not a run directory: it holds no {FILE_NAME}{instead}.")
    check_folder(run)
    try:
        content = json.loads(read_json_file(path).decode())
        json.dumps(content, ensure_ascii=False).encode()  # its texts are Unicode
        if not isinstance(content, dict):
            raise ValueError("it is not a JSON object")
        _Manifest.model_validate(content)
    except ValidationError as error:
        where, reason = first_problem(error)
        raise DataCorruptError(
            f"The manifest {path} is damaged ({where}: {reason}): {_WITHOUT}."
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise DataCorruptError(
            f"The manifest {path} cannot be read ({error}): {_WITHOUT}."
        ) from error
    return content


_WITHOUT = "take it from a copy of the run, or run the suite again"


def check_own(run: Path, manifest: Manifest, instead: str) -> None:
    """Check that files may be written into a run directory; `instead` ends the sentence if not.

    Raises:
        InputError: it is a record or a submission, which are checked by what they hold.
    """
    if manifest.get("images"):
        raise InputError(f"{run} is a record or a submission, which stays as it is: {instead}.")


_REASONS = {
    "missing": "it is missing",
    "extra_forbidden": "nothing of this name belongs here",
    "model_type": "it is no object in braces",
}


def first_problem(error: ValidationError) -> tuple[str, str]:
    """Place and reason of the first problem."""
    first = error.errors(include_url=False)[0]
    reason = _REASONS.get(first["type"], first["msg"])
    return ".".join(map(str, first["loc"])), reason.removeprefix("Value error, ")


def origin(manifest: Manifest, name: str, scenario: str = "") -> Manifest:
    """What a manifest says of the run that a cell is from: itself, or an entry of `ADDED`.

    Without a scenario it is the newest run that cells of a method or operator are from.
    """
    for run in reversed(manifest.get(ADDED, [])):
        for cell in run["cells"]:
            of_scenario, _, of_name = cell.partition("/")
            if of_name == name and scenario in ("", of_scenario):
                return dict(run)
    return manifest


def starts(manifest: Manifest) -> list[tuple[str, str | None]]:
    """When and by which commit one run began, then when it was resumed."""
    resumed = [(of["time"], of["git_commit"]) for of in manifest.get("resumed", [])]
    return [(manifest["started"], manifest["git_commit"]), *resumed]


def commits(manifest: Manifest) -> list[str | None]:
    """The commits of the code of one run, each once."""
    return list(dict.fromkeys(commit for _, commit in starts(manifest)))


def samples_of(manifest: Manifest) -> dict[str, int]:
    """Return the number of test samples of each scenario of a run."""
    return {name: data["n"] for name, data in manifest["data"].items()}


def suite_of(manifest: Manifest) -> Suite:
    """Return the suite of the run that `manifest` describes.

    Raises:
        InputError: it does not hold it, or not as this version of eitbench declares suites.
    """
    try:
        return Suite.model_validate(manifest["plan"]["suite"])
    except (KeyError, ValidationError) as error:
        raise InputError(
            "The manifest describes its suite in a way that this version of eitbench does not "
            "read: run the suite again."
        ) from error


def about_data(test: Dataset) -> dict[str, Any]:
    """What a manifest says of the test frames of a scenario."""
    return {
        "hash": test.data_hash,
        "inverse_crime": test.inverse_crime,
        "n": len(test),
        "truth": test.truth,
        "sensor": test.sensor.name,
    }


def code_sha256(manifest: Manifest, name: str) -> str:
    """SHA-256 (hex) of the file that a method of somebody else was in; "" for one of ours."""
    plan = manifest["plan"]
    files = [plugin["sha256"] for plugin in plan["plugins"] if name in plugin["names"]]
    return str(files[0] if files else plan.get("installed", {}).get(name, ""))


def resume_command(run: Path) -> str:
    """The command that continues the run directory, to be pasted into a shell."""
    return f"eitbench run --resume {shlex.quote(str(run))}"
