"""How far superposition holds on a real skin, and what presses of the skin itself allow.

A press changes the frame in a direction that depends on its place. Kernel ridge regression learns
this direction from single presses; a touch of two contacts is then fitted by two directions with
gains of at least 0. Superposed pairs are explained as well as this map of directions is. Real pairs
are explained less: by what superposition misses, by two weeks of drift between the presses and the
pairs, by another probe, and by places that are known to 5 mm; the fit cannot tell these apart.

The same fit finds two contacts: the two places on a grid, of all pairs, that explain a frame best.
It has seen a hundred presses of the skin, and shows what their frames would allow an image to show.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from eitbench.benchmark.findings.two_touch import told_apart
from eitbench.benchmark.metrics.evaluation import REGISTRATION_FRAMES
from eitbench.benchmark.metrics.tactile import distances
from eitbench.benchmark.rundir.manifest import git_commit, now, versions
from eitbench.methods.places.kernel_ridge import gaussian
from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.superposed import DISTANCES_MM, TOLERANCE_MM

SINGLE, REAL = "superpose500", "hydrogel-two-probes"
TOUCHES = {
    "superposed-pairs": "superposed-pairs",
    "real-pairs": REAL,
    "superposed-pairs-cam09-05": "superposed-pairs-cam09-05",
}
"""Scenarios of the suite `two-touch`, and their recorded sets."""
FIT = "fit of two presses"
_LENGTH, _RIDGE = 0.015, 0.3
_STEP = 0.005
_QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_REAL_DISTANCES_MM = (20.0, 75.0, 108.0)


@dataclass(frozen=True, eq=False)
class Directions:
    """The unit direction (M,) in which a press at a place changes the frame, from known presses.

    Attributes:
        places: (n, 2) [m].
        weights: (n, M) of the kernels around them.
        size: (M,) typical change of each value, relative to the reference.
    """

    places: Array
    weights: Array
    size: Array

    def __call__(self, places: Array) -> Array:
        """Directions (k, M) at `places` (k, 2) [m]."""
        found = gaussian(_LENGTH, places, self.places) @ self.weights
        return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def learned_directions(places: Array, change: Array) -> Directions:
    """Learn from presses at `places` (n, 2) [m] that make relative changes (n, M)."""
    size = np.median(np.abs(change), axis=0)
    scaled = change / size
    unit = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    system = gaussian(_LENGTH, places, places) + _RIDGE * np.eye(len(places))
    return Directions(places, np.linalg.solve(system, unit), size)


def explained(directions: Directions, change: Array, places: Array) -> Array:
    """Share (n,) of the squared norm of changes (n, M) that presses at `places` (n, k, 2) explain.

    Each contact has a gain of its own, at least 0; all values count in units of their typical size.
    """
    share = np.empty(len(change))
    for n, (values, at) in enumerate(zip(change / directions.size, places, strict=True)):
        known = at[np.isfinite(at).all(axis=1)]
        _, left = nnls(directions(known).T, values)
        share[n] = max(1 - (left / np.linalg.norm(values)) ** 2, 0.0)  # but for rounding
    return share


def fitted_pairs(directions: Directions, change: Array) -> Array:
    """Places (n, 2, 2) [m] of the two presses that explain each change (n, M) best."""
    reach = np.linalg.norm(directions.places, axis=1).max()
    line = np.arange(-reach, reach + _STEP, _STEP)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= reach]
    unit = directions(grid)
    first, second = np.triu_indices(len(grid), 1)
    cosine = (unit @ unit.T)[first, second]
    found = np.empty((len(change), 2, 2))
    for n, along in enumerate((change / directions.size) @ unit.T):
        a, b = along[first], along[second]
        both = (a - cosine * b > 0) & (b - cosine * a > 0)  # else a gain would be negative
        share = (a**2 + b**2 - 2 * cosine * a * b) / (1 - cosine**2)
        best = int(np.where(both, share, 0.0).argmax())
        found[n] = grid[[first[best], second[best]]]
    return found


def superposition() -> pd.DataFrame:
    """What single presses explain of held-out presses, of superposed and of real pairs.

    The map learns from the test presses of `superpose500`; its validation presses are held out.

    Returns:
        One row per kind and distance of pairs: `kind`, `distance_mm` (0 for single presses), `n`,
        `median`, `least` and `most` of the share of the change that is explained.
    """
    places, change, test = _presses(SINGLE)
    directions = learned_directions(places[test, 0], change[test])
    held, held_change = places[~test, 0], change[~test]
    rows = [_row("single presses", 0.0, explained(directions, held_change, held[:, None]))]
    first, second = np.triu_indices(len(held), 1)
    apart = 1e3 * np.linalg.norm(held[first] - held[second], axis=1)
    for distance in _REAL_DISTANCES_MM:
        near = np.abs(apart - distance) <= TOLERANCE_MM
        i, j = first[near], second[near]
        pairs = np.stack([held[i], held[j]], axis=1)
        share = explained(directions, held_change[i] + held_change[j], pairs)
        rows.append(_row("superposed pairs", distance, share))
    tips, of_pairs, test = _presses(REAL)
    tips, of_pairs = tips[test], of_pairs[test]
    apart = 1e3 * np.linalg.norm(tips[:, 0] - tips[:, 1], axis=1)
    for kind, at in (("real pairs", tips), ("real pairs, turned places", tips @ _QUARTER_TURN)):
        share = explained(directions, of_pairs, at)
        rows += [_row(kind, d, share[np.isclose(apart, d)]) for d in _REAL_DISTANCES_MM]
    return pd.DataFrame(rows)


def _presses(name: str) -> tuple[Array, Array, Mask]:
    """Places (n, k, 2) [m], changes (n, M) relative to the reference, and the test rows (n,)."""
    recording = read_recording(name)
    change = (recording.voltages - recording.reference) / recording.reference
    return (
        contact_places(recording.samples),
        change,
        (recording.samples["split"] == "test").to_numpy(dtype=bool),
    )


def _row(kind: str, distance: float, share: Array) -> dict[str, object]:
    return {
        "kind": kind,
        "distance_mm": distance,
        "n": len(share),
        "median": float(np.median(share)),
        "least": float(share.min()),
        "most": float(share.max()),
    }


def fitted_touches() -> pd.DataFrame:
    """Touches of the suite `two-touch` found by a fit of two known presses, as rows of a run.

    The map learns from the presses that register images in the suite, the first 100 of the
    validation split. The fit is told that there are two contacts.

    Returns:
        Columns `scenario`, `method`, `sample`, `probe_distance_mm`, `contacts`,
        `contact_count_error` (NaN), `localisation_mm`, `farthest_contact_mm`, as `told_apart` of
        `eitbench.benchmark.findings.two_touch` takes them.
    """
    tables = []
    for scenario, name in TOUCHES.items():
        places, change, test = _presses(name)
        known = np.flatnonzero(~test)[:REGISTRATION_FRAMES]
        directions = learned_directions(places[known, 0], change[known])
        two = test & np.isfinite(places).all(axis=(1, 2))
        found = fitted_pairs(directions, change[two])
        error = 1e3 * np.array(
            [distances(true, at) for true, at in zip(places[two], found, strict=True)]
        )
        apart = 1e3 * np.linalg.norm(places[two, 0] - places[two, 1], axis=1)
        declared = np.array(DISTANCES_MM)
        tables.append(
            pd.DataFrame(
                {
                    "scenario": scenario,
                    "method": FIT,
                    "sample": np.arange(len(found)),
                    "probe_distance_mm": declared[np.abs(apart[:, None] - declared).argmin(axis=1)],
                    "contacts": 2,
                    "contact_count_error": np.nan,
                    "localisation_mm": error.mean(axis=1),
                    "farthest_contact_mm": error.max(axis=1),
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def record(command: str) -> dict[str, object]:
    """Both experiments as plain values, with the command, the files and the versions."""
    apart = told_apart(fitted_touches()).drop(columns="counted")
    return {
        "command": command,
        "written": now(),
        "versions": versions(),
        "git_commit": git_commit(),
        "files": {
            file.path: file.sha256
            for name in (SINGLE, *TOUCHES.values())
            for file in recorded_set(name).files
        },
        "explained": superposition().to_dict("records"),
        "told_apart": apart.to_dict("records"),
    }
