"""Methods that come after a record was made: their rows, beside those that it has.

A record stays what it is. A newer one takes the rows of the methods that nobody ran again, with
their images and checksums, as they stand in the older one; its manifest is that of the older one,
and names under `ADDED` the runs that further rows are from.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.rundir.manifest import ADDED, Manifest

_OF_A_RUN = (
    *("started", "finished", "resumed", "versions", "machine", "git_commit"),
    *("calibration_ms", "jobs"),
)
"""What a manifest says of how a run was made."""


def check_same_frames(kept: Run, about: Manifest, samples: pd.DataFrame) -> None:
    """Check that a run with the manifest `about` and these `samples` is of the frames of a record.

    Raises:
        InputError: it is not.
    """
    for scenario, rows in samples.groupby("scenario", sort=False):
        frames = [
            of.drop_duplicates("sample").set_index("sample")["input_hash"].sort_index()
            for of in (rows, kept.samples[kept.samples["scenario"] == scenario])
        ]
        declared = [of["data"].get(scenario, {}).get("hash") for of in (about, kept.manifest)]
        # A method that is too slow has the first frames alone.
        if declared[0] != declared[1] or not frames[0].equals(frames[1].loc[frames[0].index]):
            raise InputError(
                f"The frames of {scenario!r} are others than in {kept.path}: run the whole suite."
            )


def joined(kept: Run, older: pd.DataFrame | None, newer: pd.DataFrame) -> pd.DataFrame:
    """Rows of a table of a record that are not run again, and the newer ones, by scenario."""
    if older is None:
        return newer
    again = older[kept.kind.name].isin(newer[kept.kind.name].unique())
    table = pd.concat([older[~again], newer], ignore_index=True)
    order = {name: k for k, name in enumerate(kept.manifest["data"])}
    return table.sort_values("scenario", key=lambda c: c.map(order), kind="stable")


def joined_manifest(kept: Manifest, about: Manifest) -> Manifest:
    """The manifest of a record with the rows of a run with the manifest `about` beside its own."""
    ran = list(about["plan"]["names"])

    def others(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [entry for entry in entries if entry["name"] not in ran]

    before = [
        of | {"names": [name for name in of["names"] if name not in ran]}
        for of in kept.get(ADDED, [])
    ]
    run = {name: about[name] for name in _OF_A_RUN} | {"names": ran}
    suite = about["plan"]["suite"]
    names = [*(name for name in kept["plan"]["names"] if name not in ran), *ran]
    skipped = {k: v for k, v in kept["skipped"].items() if k.rsplit("/", 1)[-1] not in ran}
    return kept | {
        "plan": kept["plan"] | {"suite": suite, "names": names},
        "cells": [*others(kept["cells"]), *about["cells"]],
        "skipped": skipped | about["skipped"],
        ADDED: [*(of for of in before if of["names"]), run],
    }
