"""Checks of what a submission shows: frames, truth, images, figures and standings.

Data, truth and geometry are ours; figures and the registration are computed again from the stored
images. That the images are those of the method only a rerun tells, see `rerun`.

Each check returns what is wrong, as a sentence; "" where nothing is.
"""

from __future__ import annotations

import json
import re
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.recording_notes import notes_of
from eitbench.benchmark.analysis.rescore import ROUNDING, rescored, stored_text
from eitbench.benchmark.analysis.results import (
    NOTES_FILE,
    cells_of,
    rows_of,
)
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.findings.uncertainty import stored_curves
from eitbench.benchmark.metrics.evaluation import fit_calibration, fit_registration
from eitbench.benchmark.metrics.load import LoadCalibration
from eitbench.benchmark.metrics.uncertainty import LEVELS, UNCERTAINTY, coverages
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.folder import read_json_file
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.run_arrays import read_validation
from eitbench.benchmark.submissions.submission import LEADERBOARD, Submission
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.similarity import Similarity
from eitbench.scenarios.suites.scenario import RecordedScenario

ADDED_BY_REPORTS = {
    "cites": r"[\w.,:+-]{0,200}",
    "gap": "",
    "tier": r"(self-reported( \(its times are self-reported\))?)?",
}
"""Entries of a row of the leaderboard that no standing has, and what they may hold."""

COVERAGES = tuple(f"coverage_{level}" for level in LEVELS)

STATED_OF_ALL = ("crps", "sharpness", "ause")
"""Of a method that states an uncertainty: runs charge these of frames without an image, too."""

CURVES_APART = 1e-5
"""Difference of shares and errors [S/m] that the rounding of stored curves may cause."""

PLAUSIBLE_PSNR_DB = 45.0
"""Networks have less on clean data; an exact fit on the mesh of the data may have more, and is then
looked at by somebody. Frames of the untouched sensor, which any small image fits, do not count."""

PLAUSIBLE_PLACE_MM = 0.1
"""A press is placed by a robot that is not more accurate."""


def frames_are_ours(of: Submission) -> str:
    """Frames, descriptions, geometry or truth that are not ours."""
    run, cells = of.run, cells_of(of.run.samples)
    for name, ours in of.data.items():
        data = ours.test
        if run.manifest["data"][name] != manifests.about_data(data):
            return f"The data of {name!r} are not those of this version of eitbench."
        for (scenario, method), ordered in cells.items():
            if scenario != name:
                continue
            if of.same_numbers and ordered["input_hash"].tolist() != data.frame_hashes:
                return f"{method!r} was given other frames of {name!r} than ours."
            known = data.samples.drop(columns="sample")
            for column in known:
                if column not in ordered or not _same(ordered[column], known[column]):
                    return f"The column {column!r} of {method!r} on {name!r} was changed."
        scene, (attributes, arrays) = run.scene(name, range(len(data))), ours.truth()
        for what, value in {**attributes, "mask": arrays["mask"]}.items():
            if not np.array_equal(getattr(scene, what), value):
                return f"The scenario {name!r} is stored with another {what!r} than ours."
        truth = data.conductivity if data.truth == "conductivity" else data.classes
        if truth is not None and (scene.truth is None or not _agree(scene.truth, truth)):
            return f"The truth that is stored of {name!r} is not ours."
    return ""


def _same(one: Any, other: Any) -> bool:
    # A column that another scenario of the run lacks is stored as float.
    if other.dtype.kind in "iuf":
        return _agree(one.to_numpy(float), other.to_numpy(float))
    return bool(one.astype(str).tolist() == other.astype(str).tolist())


def _agree(one: Any, other: Any) -> bool:
    """True if arrays are equal but for what other versions of NumPy round otherwise."""
    return one.shape == other.shape and np.allclose(
        one, other, rtol=ROUNDING, atol=ROUNDING, equal_nan=True
    )


def failures_are_reported(of: Submission) -> str:
    """A status that the stored image contradicts, or a count that no status gives."""
    cells = rows_of(of.run.cells)
    for (scenario, method), ordered in cells_of(of.run.samples).items():
        images = of.run.estimates(scenario, method, ordered["sample"].tolist())
        mask = of.data[scenario].test.sensor.mask
        if images is None:
            return f"There are no images of {method!r} on {scenario!r}."
        background, outside = of.data[scenario].test.sensor.background, images[:, ~mask]
        if not np.isclose(outside, background, rtol=1e-6, atol=0)[np.isfinite(outside)].all():
            return (
                f"Images of {method!r} on {scenario!r} hold more than the background outside of "
                "the sensor, which no run writes."
            )
        whole = np.isfinite(images[:, mask]).all(axis=1)
        if not np.array_equal(whole, ordered["status"] == "ok"):
            return (
                f"The status of {method!r} on {scenario!r} does not say which of its images are "
                "whole."
            )
        if not np.array_equal(whole, ordered["message"] == ""):
            return (
                f"Messages of {method!r} on {scenario!r} are not those of its failed samples alone."
            )
        counted = {"n": len(ordered), "coverage": (ordered["status"] == "ok").mean()}
        cell = cells[scenario, method]
        if any(not np.isclose(cell[name], value).all() for name, value in counted.items()):
            return (
                f"methods.parquet counts other samples of {method!r} on {scenario!r} than there "
                "are, or other valid ones."
            )
    return ""


def registrations_are_ours(of: Submission) -> str:
    """A registration or calibration that does not follow from the images of validation presses."""
    for scenario, method in rows_of(of.run.cells):
        text = partial(stored_text, of.run, scenario, method)
        validation, fitted, calibration = of.data[scenario].validation, None, None
        if validation is not None:
            shape = (len(validation), *validation.sensor.image_shape)
            images = read_validation(of.run.path / METHOD_RUNS.arrays, scenario, method, shape)
            calibration = fit_calibration(validation, images)
            if validation.truth == "position":
                fitted = fit_registration(validation, images)
        for name, same in (
            ("registration", _same_registration(text("registration"), fitted)),
            ("load calibration", _same_load(text("load_calibration"), calibration)),
        ):
            if not same:
                return (
                    f"The {name} of {method!r} on {scenario!r} does not follow from its images of "
                    "the validation presses."
                )
    return ""


def _same_registration(stored: str, fitted: Similarity | None) -> bool:
    if fitted is None or not stored:
        return fitted is None and not stored
    found = Similarity.from_json(stored)
    pairs = ((found.scale, fitted.scale), (found.turn, fitted.turn), (found.shift, fitted.shift))
    return all(_agree(np.asarray(one), np.asarray(other)) for one, other in pairs)


def _same_load(stored: str, fitted: LoadCalibration | None) -> bool:
    if fitted is None or not stored:
        return fitted is None and not stored
    found = LoadCalibration.from_json(stored)
    numbers = (np.array([of.offset, of.slope, of.full_scale]) for of in (found, fitted))
    return found.quantity == fitted.quantity and _agree(*numbers)


def scores_are_ours(of: Submission) -> str:
    """Figures that the stored images do not give."""
    for cell, _ in rescored(of.run):
        if cell.changed:
            return (
                f"{cell.changed} of {cell.n} samples of {cell.method!r} on {cell.scenario!r} have "
                f"other figures than their stored images give: {', '.join(cell.figures)}."
            )
    return ""


def statements_are_whole(of: Submission) -> str:
    """An uncertainty or a novelty that some frames of a scenario have, and others lack."""
    for (scenario, method), rows in cells_of(of.run.samples).items():
        known = {
            name: np.isfinite(rows[name]) if name in rows else np.zeros(len(rows), bool)
            for name in (*STATED_OF_ALL, "novelty")
        }
        scored = of.data[scenario].test.conductivity is not None
        asked: dict[str, Any] = {}
        if any(known[name].any() for name in STATED_OF_ALL):
            asked |= dict.fromkeys(STATED_OF_ALL if scored else ("sharpness",), True)
        if known["novelty"].any():
            asked["novelty"] = rows["status"] == "ok"
        for name, frames in asked.items():
            if (known[name] != frames).any():
                title = UNCERTAINTY[name].title if name in UNCERTAINTY else "stated novelty"
                return (
                    f"Some frames of {scenario!r} have no finite {title} of {method!r}, which "
                    "every run writes: run it again."
                )
    return ""


def curves_follow(of: Submission) -> str:
    """Curves of stated uncertainty that the figures of its frames, or mathematics, contradict."""
    for (scenario, method), rows in cells_of(of.run.samples).items():
        curves = stored_curves(of.run, stored_text(of.run, scenario, method, "uncertainty"))
        for name, spec in UNCERTAINTY.items():
            highest = 1.0 + CURVES_APART if "coverage" in name else np.inf  # sums are rounded
            values = rows[name].dropna() if name in rows else pd.Series(dtype=float)
            # The radius is infinite where no draw has a contact.
            possible = np.isfinite(values) | (name == "place_radius_mm")
            possible &= values.between(-CURVES_APART, highest)
            if spec.unit != "ms" and not possible.all():
                return f"The {spec.title} of {method!r} on {scenario!r} has values that cannot be."
        stated = [rows[name].mean() if name in rows else np.nan for name in COVERAGES]
        if curves is None:
            # Those of a run are missing only where draws and truth agree on every pixel.
            scored = "crps" in rows and np.isfinite(rows["crps"]).any()
            if np.isfinite(stated).any() or (scored and _touched(of.data[scenario].test)):
                return f"The curves of what {method!r} states on {scenario!r} are missing."
            continue
        covered = [float(share) for share in coverages(np.array(curves.ranks)).values()]
        by_deviation, by_error = np.array(curves.sparsified)
        away = [*np.subtract(stated, covered), by_deviation[0] - by_error[0]]
        if (
            not (np.abs(away) < CURVES_APART).all()
            or (by_deviation < by_error - CURVES_APART).any()
        ):
            return (
                f"The curves of what {method!r} states on {scenario!r} do not follow from its "
                "figures."
            )
    return ""


def _touched(data: Dataset) -> bool:
    return data.conductivity is not None and bool(
        (data.conductivity[:, data.sensor.mask] != data.sensor.background).any()
    )


def leaderboard_follows(of: Submission) -> str:
    """Rows of the leaderboard that the samples do not give."""
    run = of.run
    try:
        stored = json.loads(read_json_file(run.path / LEADERBOARD).decode())
        rows = {(row["scenario"], row["method"]): row for row in stored}
    except FileNotFoundError:
        return f"{LEADERBOARD} is missing: send the whole folder that `submission make` wrote."
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        return f"{LEADERBOARD} cannot be read as a list of rows ({type(error).__name__})."
    found = [(row, standing) for standing in standings([run]) for row in standing.rows]
    if len(stored) != len(found):
        return f"{LEADERBOARD} has {len(stored)} rows, and the samples give {len(found)}."
    for row, standing in found:
        there = rows.get((row["scenario"], row["method"]), {})
        for name, value in row.items():
            # A folder may be renamed.
            if name != "run" and not _agrees(there.get(name), value):
                return (
                    f"In {LEADERBOARD} the {name} of {row['method']!r} on {row['scenario']!r} is "
                    f"{there.get(name)}, and the samples give {value}."
                )
        if there.get("why_not") != standing.why_not:
            return (
                f"In {LEADERBOARD} the why_not of {row['method']!r} on {row['scenario']!r} is not "
                f"that of eitbench: {standing.why_not!r}."
            )
        for name in there.keys() - row.keys() - {"why_not"}:
            said = ADDED_BY_REPORTS.get(name)
            if said is None or not re.fullmatch(said, str(there[name])):
                return f"{LEADERBOARD} holds {name!r} {there[name]!r:.80}, which no run writes."
    return ""


def _agrees(stored: Any, value: Any) -> bool:
    if isinstance(value, float) and isinstance(stored, float | int):
        return bool(np.isclose(stored, value, rtol=ROUNDING, atol=ROUNDING))
    return bool(stored == value)


def notes_are_ours(of: Submission) -> str:
    """Notes on recordings that the data do not give."""
    run = of.run
    recorded = {s.name for s in of.plan.suite.scenarios if isinstance(s, RecordedScenario)}
    if more := run.notes.keys() - recorded:
        return f"{NOTES_FILE} says something of {min(more)!r}, which is no recorded scenario."
    for scenario in of.plan.suite.scenarios:
        if isinstance(scenario, RecordedScenario):
            n = run.manifest["data"][scenario.name]["n"]
            stored = run.notes.get(scenario.name, {})
            for name, value in notes_of(scenario, n).items():
                if not _agrees(stored.get(name), value):
                    return (
                        f"{NOTES_FILE} says {name} {stored.get(name)} of {scenario.name!r}, and "
                        f"its data say {value}."
                    )
    return ""


def is_plausible(of: Submission) -> str:
    """Figures that are better than frames allow."""
    for (scenario, method), rows in cells_of(of.run.samples).items():
        truth = of.data[scenario].test.conductivity
        touched = (
            np.ones(len(rows), dtype=bool) if truth is None else np.ptp(truth, axis=(1, 2)) > 0
        )
        psnr = rows.loc[rows["sample"].isin(np.flatnonzero(touched)), "psnr"].mean()
        place = rows["localisation_mm"].median()
        if psnr > PLAUSIBLE_PSNR_DB:
            told = f"a PSNR of {psnr:.1f} dB"
        elif rows["ssim"].isna().all() and place < PLAUSIBLE_PLACE_MM:
            told = f"places that are right to {place:.2g} mm"
        else:
            continue
        return (
            f"{method!r} on {scenario!r} has {told}, which is better than frames allow: look where "
            "it gets the truth from."
        )
    return ""
