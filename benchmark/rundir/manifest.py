"""The manifest of a run: what was asked for, on which data, with which versions and machine."""

import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import psutil
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import eitbench
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import Suite

FILE_NAME = "manifest.json"
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
)

Manifest = dict[str, Any]

# What a run is continued from.
_NEEDED: dict[str, type] = {
    "status": str,
    "batch": int,
    "resumed": list,
    "skipped": dict,
    "refused": dict,
    "plan": dict,
    "data": dict,
    "cells": list,
}
_NEEDED_OF_CELL: dict[str, type] = {
    "scenario": str,
    "name": str,
    "variant": str,
    "track": str,
    "parameters": dict,
    "spent": dict,
}


def now() -> str:
    """The time in UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def environment() -> Manifest:
    """Versions, machine and git commit: what a reader needs to judge or repeat a run."""
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


def machine() -> dict[str, str | int | None]:
    """Processor, cores, memory and operating system; no host or user name."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "memory_mb": psutil.virtual_memory().total // 2**20,
        "os": platform.platform(),
    }


@cache
def cpu_model() -> str:
    """The processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def git_commit() -> str | None:
    """The commit of the checkout eitbench runs from, "-dirty" if changed; None if installed."""
    root = Path(eitbench.__file__).resolve().parents[3]
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
    """The command as typed, its program without the folder."""
    return " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])


def read(run: Path) -> Manifest:
    """The manifest of the run directory `run`.

    Raises:
        InputError: no run directory, or one whose manifest cannot be read.
    """
    path = run / FILE_NAME
    if not path.is_file():
        raise InputError(f"{run} is not a run directory: it holds no {FILE_NAME}.")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"The manifest {path} cannot be read: {error}.") from error
    if not isinstance(manifest, dict):
        raise InputError(f"The manifest {path} is not a JSON object.")
    check_kinds(manifest, path)
    return manifest


class _Told(BaseModel):
    """The kinds of what a manifest tells, where it tells it; the rest is only printed."""

    model_config = ConfigDict(strict=True, frozen=True)


class _Data(_Told):
    hash: str | None = None
    n: int | None = None
    inverse_crime: bool | None = None


class _Plugin(_Told):
    path: str
    sha256: str
    names: list[str]


class _Suite(_Told):
    name: str = ""
    scenarios: list[dict[str, Any]] = []


class _Plan(_Told):
    suite: _Suite = _Suite()
    names: list[str] = []
    scenarios: list[str] = []
    limit: int | None = None
    plugins: list[_Plugin] = []


class _Manifest(_Told):
    status: str = "finished"
    plan: _Plan = _Plan()
    data: dict[str, _Data] = {}
    cells: list[dict[str, Any]] = []
    machine: dict[str, str | int | float | None] = {}
    versions: dict[str, str | None] = {}
    skipped: dict[str, str] = {}
    calibration_ms: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


def check_kinds(manifest: Manifest, path: Path) -> None:
    """Refuse a manifest that tells something of another kind than eitbench writes.

    Raises:
        InputError: it does.
    """
    try:
        _Manifest.model_validate(manifest)
    except ValidationError as error:
        (first, *_) = error.errors(include_url=False)
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"The manifest {path} is damaged: {where}: {first['msg']}.") from error


def suite_of(manifest: Manifest) -> Suite:
    """The suite of the run that `manifest` tells of.

    Raises:
        InputError: it does not tell it, or not as this version of eitbench declares suites.
    """
    try:
        return Suite.model_validate(manifest["plan"]["suite"])
    except (KeyError, ValidationError) as error:
        raise InputError(
            "The manifest of the run does not hold its suite as this version of eitbench declares "
            "suites: run it again."
        ) from error


def read_resumable(run: Path) -> Manifest:
    """The manifest of a run that is to be continued.

    Raises:
        InputError: as for `read`, or something that is needed is missing.
    """
    manifest = read(run)
    missing = _missing(manifest, _NEEDED)
    for cell in () if missing else manifest["cells"]:
        missing = missing or _missing(cell, _NEEDED_OF_CELL)
    for data in () if missing else manifest["data"].values():
        missing = missing or _missing(data, {"hash": str})
    if missing:
        raise InputError(
            f"{run} cannot be resumed: its manifest is incomplete ({missing!r}). Start a new run."
        )
    return manifest


def _missing(content: object, needed: dict[str, type]) -> str:
    """The first of `needed` that `content` does not hold, or ""."""
    for name, kind in needed.items():
        if not isinstance(content, dict) or not isinstance(content.get(name), kind):
            return name
    return ""
