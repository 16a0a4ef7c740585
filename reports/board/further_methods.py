"""Methods that come after a record was made: their rows, beside those that it has.

A record stays what it is. A newer one takes the rows of the methods that nobody ran again, with
their images and checksums, as they stand in the older one; its manifest is that of the older one,
and names under `ADDED` the runs that further rows are from.
"""

from __future__ import annotations

import pandas as pd

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.rundir.manifest import ADDED, Manifest

_OF_A_RUN = (
    *("started", "finished", "resumed", "versions", "machine", "git_commit"),
    *("calibration_ms", "jobs"),
)
"""What a manifest says of how a run was made."""


def on_frames_of(kept: Run, about: Manifest, samples: pd.DataFrame) -> pd.DataFrame:
    """The `samples` of a run with the manifest `about`, with the hashes of frames of a record.

    On another kind of processor the same frames differ in their last bits, and so their hashes:
    those of the record name its frames, and `same_bits` says whether they are these to the last.

    Raises:
        InputError: they are other frames, by what is declared of them.
    """
    frames = ["scenario", "sample"]
    known = kept.samples.drop_duplicates(frames).set_index(frames)["input_hash"]
    for scenario, rows in samples.groupby("scenario", sort=False):
        declared = [of["data"].get(scenario, {}).get("hash") for of in (about, kept.manifest)]
        if declared[0] != declared[1]:
            raise InputError(
                f"The frames of {scenario!r} are others than in {kept.path}: run the whole suite."
            )
        assert set(rows["sample"]) <= set(known[scenario].index)
    return samples.assign(input_hash=known.loc[pd.MultiIndex.from_frame(samples[frames])].array)


def joined(kept: Run, older: pd.DataFrame | None, newer: pd.DataFrame) -> pd.DataFrame:
    """Rows of a table of a record that are not run again, and the newer ones, by scenario."""
    if older is None:
        return newer
    cell = ["scenario", kept.kind.name]
    ran = pd.MultiIndex.from_frame(newer[cell].drop_duplicates())
    again = pd.MultiIndex.from_frame(older[cell]).isin(ran)
    table = pd.concat([older[~again], newer], ignore_index=True)
    order = {name: k for k, name in enumerate(kept.manifest["data"])}
    return table.sort_values("scenario", key=lambda c: c.map(order), kind="stable")


def joined_manifest(kept: Manifest, about: Manifest, same_bits: bool) -> Manifest:
    """The manifest of a record with the rows of a run with the manifest `about` beside its own.

    `same_bits` is true if the frames of both are the same to the last bit.
    """
    ran = [f"{cell['scenario']}/{cell['name']}" for cell in about["cells"]]
    before = [
        of | {"cells": [cell for cell in of["cells"] if cell not in ran]}
        for of in kept.get(ADDED, [])
    ]
    run = {name: about[name] for name in _OF_A_RUN} | {"cells": ran, "same_bits": same_bits}
    names = dict.fromkeys([*kept["plan"]["names"], *about["plan"]["names"]])
    taken = [cell for cell in kept["cells"] if f"{cell['scenario']}/{cell['name']}" not in ran]
    return kept | {
        "plan": kept["plan"] | {"suite": about["plan"]["suite"], "names": list(names)},
        "cells": [*taken, *about["cells"]],
        "skipped": {k: v for k, v in kept["skipped"].items() if k not in ran} | about["skipped"],
        ADDED: [*(of for of in before if of["cells"]), run],
    }
