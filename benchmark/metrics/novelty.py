"""Figures of novelty: how well a score tells frames of a condition that methods do not know.

Scores of a frame are judged alike: what it shows without an image, the residual of the exact model
at the image that a method returns, absolute and relative to the touch, and the uncertainty and the
novelty that it states. Frames without an image have the greatest score: not to answer is right
where a frame is not known.

Sources: Hanley and McNeil, Radiology 143(1), 1982 (area under the ROC curve); Hendrycks and Gimpel,
ICLR 2017 (its use for examples out of distribution).
"""

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.statistics import quantile, ranks
from eitbench.methods.problem import Problem, no_split
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.data.datasets import Dataset, same_reference
from eitbench.scenarios.physics.forward import forward_model

FALSE_ALARMS = 0.05
"""Share of familiar frames that may be called novel."""

_FRAMES = "frames of suites that declare conditions which methods do not know"

KNOWN_FRAMES = 300
"""Validation frames that show what is usual."""
LEAST_SPREAD = 0.01
"""Of the numbers of a frame: where all familiar frames share a reference, it has none."""
FRAME = "frame"
"""Name of the score that needs no image."""

SCORES = {
    spec.name: spec
    for spec in (
        MetricSpec(
            FRAME,
            "Frame",
            formula="the greatest |z| of three numbers, in standard deviations "
            f"({LEAST_SPREAD:g} at least) from the mean of {KNOWN_FRAMES} familiar validation "
            "frames: log |v - v_ref| / |v_ref|, the "
            "cosine of v - v_ref and v_ref, and log |v_ref / g - F(untouched)|",
            domain=_FRAMES,
            best=None,
            form=".2f",
            mask="all measurements",
            traps="It needs no image, and says nothing of one. It finds a reference frame that is "
            "not of the sensor before anybody touches it.",
        ),
        MetricSpec(
            "residual",
            "Residual",
            formula="|(v - v_ref) - g (F(p) - F(untouched))| / |v_ref|, F the exact model, p kept "
            "within the sensor's range of conductivity, g the gain of the reference frame",
            domain=_FRAMES,
            best=None,
            form=".4f",
            mask="all measurements",
            traps="The baseline. F is on the grid that methods are given. All measurements count "
            "alike, also for methods that take gains out of them. A strong regularisation leaves a "
            "large residual of every frame. What an image explains wrongly leaves none.",
        ),
        MetricSpec(
            "relative_residual",
            "Relative residual",
            formula="the same over |v - v_ref|",
            domain=_FRAMES,
            best=None,
            form=".3f",
            mask="all measurements",
            traps="A weak touch has much of it, from noise alone.",
        ),
        MetricSpec(
            "sharpness",
            "Stated uncertainty",
            formula="root of the mean variance of the draws over pixels",
            domain=f"{_FRAMES}, by methods that state an uncertainty, where the truth is known",
            unit="S/m",
            best=None,
            form=".4f",
            traps="It says how far the touch may be from the image, if it is a touch as known.",
        ),
        MetricSpec(
            "novelty",
            "Stated novelty",
            formula="the score that the method returns",
            domain=f"{_FRAMES}, by methods that state it",
            best=None,
            form=".3g",
            mask="as the method likes",
            traps="Only the order of frames counts; scores of two methods do not compare.",
        ),
    )
}
"""The scores that are judged, by the name of their column."""

NOVELTY = {
    spec.name: spec
    for spec in (
        MetricSpec(
            "auroc",
            "AUROC",
            formula="share of pairs of a familiar and a novel frame in which the novel one has the "
            "greater score, equal ones counted half",
            domain=_FRAMES,
            best="max",
            aggregate=None,
            form=".3f",
            mask="frames",
            traps="0.5 is a coin, and less than 0.5 calls the novel frames the more familiar ones. "
            "No threshold is chosen: see Caught. It depends on how far the novel condition is.",
        ),
        MetricSpec(
            "caught",
            "Caught",
            formula=f"share of novel frames with a score above that of all but "
            f"{FALSE_ALARMS:.0%} of the familiar ones",
            domain=_FRAMES,
            best="max",
            aggregate=None,
            form=".1%",
            mask="frames",
            traps="The threshold is that of the test frames themselves, which a user has not.",
        ),
        MetricSpec(
            "ordered",
            "Orders errors",
            formula="rank correlation of the score with the error of the image (-PSNR, or that of "
            "the place), over the frames of both conditions",
            domain=f"{_FRAMES}, where the truth is known",
            best="max",
            aggregate=None,
            form=".2f",
            mask="frames",
            traps="Novel frames may have good images. A faint touch has a small error whatever its "
            "image is.",
        ),
    )
}
"""The figures of a score; methods are ranked by the first."""


def frame_scores(data: Dataset, known: Dataset) -> Array:
    """The score `FRAME` (n,) of frames, by what is usual in `known` frames of the sensor."""
    usual = _checks(known)
    apart = (_checks(data) - usual.mean(axis=0)) / np.maximum(usual.std(axis=0), LEAST_SPREAD)
    return np.asarray(np.abs(apart).max(axis=1))


def _checks(data: Dataset) -> Array:
    """The three numbers (n, 3) of frames, see `FRAME`."""
    model = forward_model(data.sensor)
    untouched = model.voltages(model.background)
    problem = Problem(data.sensor, data.references[0], no_split)
    found = np.empty((len(data), 3))
    for rows in same_reference(data.references):
        reference = problem.reference = data.references[rows.start]
        changes, size = data.voltages[rows] - reference, np.linalg.norm(reference)
        strengths = np.linalg.norm(changes, axis=1) / size
        misfit = np.linalg.norm(reference / problem.gain - untouched) / np.linalg.norm(untouched)
        found[rows, 0] = np.log(np.maximum(strengths, 1e-300))
        found[rows, 1] = changes @ reference / size**2 / np.maximum(strengths, 1e-300)
        found[rows, 2] = np.log(max(float(misfit), 1e-300))
    return found


def residuals(data: Dataset, images: Images) -> dict[str, Array]:
    """The residuals (n,) of `SCORES` of the exact model at `images` (n, H, W) [S/m].

    NaN of images that are not finite.
    """
    sensor, model = data.sensor, forward_model(data.sensor)
    low, high = sensor.conductivity_range
    problem = Problem(sensor, data.references[0], no_split)
    untouched = model.voltages(model.background)
    found = {name: np.full(len(data), np.nan) for name in ("residual", "relative_residual")}
    for rows in same_reference(data.references):
        problem.reference = data.references[rows.start]
        for n in range(rows.start, rows.stop):
            image = np.where(sensor.mask, images[n].astype(np.float64), sensor.background)
            if np.isfinite(image).all():
                image = image.clip(low * sensor.background, high * sensor.background)
                explained = problem.gain * (model.voltages(image) - untouched)
                seen = data.voltages[n] - problem.reference
                missing = np.linalg.norm(seen - explained)
                found["residual"][n] = missing / np.linalg.norm(problem.reference)
                found["relative_residual"][n] = missing / max(float(np.linalg.norm(seen)), 1e-300)
    return found


def auroc_and_caught(counts: Array, scores: Array, novel: NDArray[np.bool_]) -> Array:
    """The figures `NOVELTY` (b, 2) of `scores` (n,), drawn `counts` (b, n) times each.

    Args:
        counts: see `statistics.draw`.
        scores: NaN counts as greater than all others.
        novel: (n,) true of frames of the novel condition.
    """
    scores = np.where(np.isnan(scores), np.inf, scores)
    of_novel, of_familiar = counts[:, novel].sum(axis=1), counts[:, ~novel].sum(axis=1)
    # Mann and Whitney's U from mean ranks among all frames.
    total = (counts * ranks(counts, scores))[:, novel].sum(axis=1)
    auroc = (total - of_novel * (of_novel + 1) / 2) / (of_novel * of_familiar)
    limits = quantile(counts[:, ~novel], scores[~novel], 1 - FALSE_ALARMS)
    caught = (counts[:, novel] * (scores[novel] > limits[:, None])).sum(axis=1) / of_novel
    return np.stack([auroc, caught], axis=1)
