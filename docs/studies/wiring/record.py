"""The record of the doctor of wiring: recorded sets wired wrongly at random, and what it says.

`python -m docs.studies.wiring.record [--count N] [SET...]` wires up to 10 frames of each set in N
ways (200 by default), drawn with seed 0, and shows them to the doctor: beside the model alone,
beside the reference frame of the set as a frame known to be right, and, where places are known, the
reference frame and ten presses beside the model. It writes `wiring.csv`, or the rows of the sets
that are named into it, one row for each set, evidence and kind of fault, of which `make tables`
makes the tables of docs/wiring.md. `--misfits` writes `misfits.csv` instead: what the right wiring
of each set's reference frame leaves of it beside the model, and what the best one does. Sets of
which only differences were measured have no whole frames and are left out.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
from docs.studies.wiring.scramble import put_right, scramble

from eitbench.scenarios.recordings.fetch import fetch_recording
from eitbench.scenarios.recordings.registry import RECORDED_SETS
from eitbench.scenarios.wiring.diagnosis import diagnose
from eitbench.scenarios.wiring.evidence import Completion, all_values, modelled_resistances
from eitbench.scenarios.wiring.touches import Touches

OUT = Path(__file__).resolve().parent / "wiring.csv"
SETS = (
    "sciospec-tank", "jku-tank-adjacent", "jku-tank-diagonal", "jku-tank-hybrid",
    "jku-tank-opposite", "pyeidors-tank", "ohmc16-start", "superpose500-start", "ohmc16",
    "superpose500", "ohmc8", "hydrogel-two-probes", "hydrogel-damage", "hydrogel-multitouch",
    "hydrogel-rectangle", "hydrogel-fixed", "hydrogel-repeats", "ktc2023",
)  # fmt: skip
FRAMES = 10


def scored(name: str, count: int) -> list[dict[str, object]]:
    """The rows of one set."""
    recorded = RECORDED_SETS[name]
    recording = recorded.read(fetch_recording(recorded))
    sensor = recorded.sensor()
    modelled = modelled_resistances(sensor)
    completion = Completion(sensor, modelled)
    by = {"model": all_values(modelled), "known frame": completion.all_values(recording.reference)}
    cells: dict[tuple[str, str], Counter[str]] = {}
    start = time.process_time()
    samples = recording.samples
    placed = np.zeros(len(samples), dtype=bool)
    if "x_m" in samples:
        placed = np.isfinite(samples["x_m"].to_numpy(dtype=float))
    if "contacts" in samples:
        placed &= samples["contacts"].to_numpy() == 1
    if placed.sum() >= FRAMES:
        by["model, ten presses"] = by["model"]
    for evidence, expected in by.items():
        # No model describes these skins: the answer is a refusal, of which fewer say as much.
        skin = evidence == "model" and sensor.pattern.magnitudes
        for k in range(count // 10 if skin else count):
            rng = np.random.default_rng([0, k])
            n = len(recording.voltages)
            rows = np.sort(rng.choice(n, min(FRAMES, n), replace=False))
            frames = recording.voltages[rows]
            if "touched" in recording.samples:
                empty = recording.voltages[~recording.samples["touched"].to_numpy(dtype=bool)]
                if len(empty):
                    frames = empty[np.sort(rng.choice(len(empty), min(FRAMES, len(empty)), False))]
            pressed = np.empty(0, dtype=int)
            if evidence == "model, ten presses":
                pressed = rng.choice(np.flatnonzero(placed), FRAMES, replace=False)
                frames = np.stack([recording.reference, *recording.voltages[pressed]])
            truth = scramble(frames, completion, rng)
            touches, shown = None, truth.frames
            if len(pressed):
                shown = truth.frames[:1]
                places = samples[["x_m", "y_m"]].to_numpy(dtype=float)[pressed]
                touches = Touches(truth.frames[1:] - truth.frames[0], places)
            found = diagnose(shown, sensor, expected, touches)
            right = put_right(found, truth, modelled)
            fault = "swapped" if truth.wiring.swapped else "dead" if truth.dead >= 0 else "none"
            answer = "refused" if found.certainty == "refused" else "right" if right else "wrong"
            whole = found.certainty == "sure"
            cell = cells.setdefault((evidence, fault), Counter())
            cell.update([answer, *(["whole"] if whole and answer == "right" else []), "n"])
            cell["best_right"] += right
            if answer == "wrong" or (answer == "refused" and VERBOSE):
                print(
                    name, evidence, fault, k, answer, right, f"{found.misfit:.3f}",
                    f"{found.runner_up:.3f}", found.dead, truth.dead, found.wiring, truth.wiring,
                    found.order.title, "|", truth.order.title, truth.magnitudes, file=sys.stderr,
                )  # fmt: skip
    spent = (time.process_time() - start) / sum(cell["n"] for cell in cells.values())
    columns = ("n", "right", "whole", "wrong", "refused", "best_right")
    return [
        {"set": name, "evidence": evidence, "fault": fault, "seconds": round(spent, 3)}
        | {column: cell[column] for column in columns}
        for (evidence, fault), cell in sorted(cells.items())
    ]


def misfits(name: str) -> dict[str, object]:
    """The row of one set: misfits of its reference frame beside the model."""
    recorded = RECORDED_SETS[name]
    reference = recorded.read(fetch_recording(recorded)).reference
    found = diagnose(reference[None], recorded.sensor())
    return {"set": name, "right": round(found.declared_misfit, 3), "best": round(found.misfit, 3)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--misfits", action="store_true")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("sets", nargs="*")
    given = parser.parse_args()
    VERBOSE = given.verbose
    if given.misfits:
        pd.DataFrame(map(misfits, SETS)).to_csv(OUT.with_name("misfits.csv"), index=False)
        sys.exit()
    known = pd.read_csv(given.out) if given.sets and given.out.exists() else pd.DataFrame()
    tables = dict(tuple(known.groupby("set"))) if len(known) else {}
    for of in given.sets or SETS:
        tables[of] = pd.DataFrame(scored(of, given.count))
        ordered = [tables[name] for name in SETS if name in tables]
        pd.concat(ordered).to_csv(given.out, index=False)
        print(tables[of].to_string(header=True, index=False), flush=True)
