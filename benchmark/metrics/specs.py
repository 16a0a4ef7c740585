"""The metrics of methods, each declared once, and the scores that sum SSIM, CC, RIE and PSNR up.

The scores are S as published, and the bounded B.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from eitbench.benchmark.metrics.aggregation import repeatability_db, strength_spearman
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.place_errors import (
    LEAST_PRESSES,
    NEIGHBOURS,
    p90_mm,
    unevenness,
    within,
    worst_tenth_mm,
)
from eitbench.scenarios.arrays import Array

_SIMULATED = "scenarios with a true conductivity"
_TRUE_CLASSES = "scenarios with true classes"
_TRUE_IMAGES = "scenarios with a true conductivity or true classes"
_PRESSES = "recorded scenarios with the places of single presses"
_SEVERAL = "recorded scenarios with touches of several contacts"
_RANGE = "the sensor's data range, 1.0 S/m for foam16"

_SPECS = (
    MetricSpec(
        "ssim",
        "SSIM",
        formula="mean over 7 x 7 windows of (2 mt mp + C1)(2 cov + C2) / ((mt^2 + mp^2 + C1)(vt +"
        " vp + C2)), C1 = (0.01 L)^2, C2 = (0.03 L)^2, sample (co)variance, as "
        "scikit-image",
        domain=_SIMULATED,
        best="max",
        mask="windows wholly inside the sensor, so a 3-pixel rim counts less",
        data_range=_RANGE,
        form=".3f",
        anchors=(0.0, 1.0),
        traps="A flat background fills most windows: doing nothing already scores high. Depends"
        " on the pixel size and on the data range; values for other grids do not compare.",
    ),
    MetricSpec(
        "cc",
        "CC",
        formula="Pearson correlation of t and p over pixels; with true classes, of the class (-1,"
        " 0, +1) and the contrast",
        domain=_TRUE_IMAGES,
        best="max",
        form=".3f",
        anchors=(0.0, 1.0),
        traps="Blind to scale and offset: an image of the wrong conductivity can reach 1. A "
        "constant image has no correlation; it counts as 0 and its row is flagged "
        "`cc_undefined`.",
    ),
    MetricSpec(
        "rie",
        "RIE",
        formula="||p - t|| / ||t||",
        domain=_SIMULATED,
        best="min",
        form=".4f",
        anchors=(1.0, 0.0),
        traps="Relative to the absolute conductivity, background included: it shrinks when the "
        "background grows, and doing nothing scores well.",
    ),
    MetricSpec(
        "psnr",
        "PSNR",
        formula="10 log10(L^2 / mean((p - t)^2))",
        domain=_SIMULATED,
        unit="dB",
        best="max",
        data_range=_RANGE,
        form=".2f",
        anchors=(0.0, 40.0),
        traps="At most 138.5 dB: images are kept in float32, and an error below its rounding "
        "says nothing, so that one perfect image does not make the mean infinite. A mean "
        "of logarithms: a few very good images raise it more than many bad ones lower it.",
    ),
    MetricSpec(
        "score",
        "S",
        formula="0.25 (SSIM + CC + PSNR) - 0.25 RIE, PSNR in dB",
        domain=_SIMULATED,
        best="max",
        data_range=_RANGE,
        form=".3f",
        traps="As published. PSNR is about twenty times as large as the other terms, so S ranks"
        " almost as PSNR does.",
    ),
    MetricSpec(
        "bounded",
        "B",
        formula="mean of SSIM, CC, 1 - RIE and PSNR / 40 dB, each kept within 0 and 1",
        domain=_SIMULATED,
        best="max",
        data_range=_RANGE,
        form=".3f",
        traps="Its anchors are fixed, so that it compares across runs, and its four parts weigh"
        " alike; that they should is a convention, too. Ranks follow S.",
    ),
    MetricSpec(
        "localisation_mm",
        "Localisation",
        formula="distance between the |contrast|-weighted centroids of true and found contacts, "
        "optimally assigned (simulated or classes); between the press and the centre of "
        "the |contrast| in excess of 1/4 of its largest value, mapped by the similarity "
        "with the least sum of distances on the validation split (positions); where touches have "
        "several contacts, between places and found contacts, so mapped and optimally assigned",
        domain="scenarios where contacts or positions are known",
        unit="mm",
        best="min",
        aggregate="median",
        form=".1f",
        traps="A contact that was missed is charged the distance to the nearest found one; an "
        "image without any is charged the sensor's diameter, and more where the similarity of "
        "recorded presses enlarges it. The similarity is fitted for"
        " each method, so a common shift, turn, mirror image or scale of its images costs"
        " nothing. The median hides the worst half.",
    ),
    MetricSpec(
        "localisation_p90_mm",
        "Localisation 90 %",
        formula="the distance of Localisation that 90 % of the presses stay within",
        domain=_PRESSES,
        unit="mm",
        best="min",
        aggregate=p90_mm,
        form=".1f",
        traps="As Localisation. Of few presses it rests on a handful.",
    ),
    *(
        MetricSpec(
            f"within_{mm}_mm",
            f"Within {mm} mm",
            formula=f"share of presses whose distance, as of Localisation, is at most {mm} mm",
            domain=_PRESSES,
            best="max",
            aggregate=within(mm),
            form=".1%",
            traps="In millimetres, whatever the size of the sensor: compare with guessing one "
            "place. Blind to how far the others are.",
        )
        for mm in (5, 10)
    ),
    MetricSpec(
        "unevenness",
        "Unevenness",
        formula="standard deviation over the presses of their local error / its mean; the local "
        f"error is the median distance of the {NEIGHBOURS} presses nearest to one",
        domain=f"{_PRESSES}, {LEAST_PRESSES} of them or more",
        best="min",
        aggregate=unevenness,
        form=".2f",
        traps="A method that is equally bad everywhere is even. Errors that do not depend on the "
        "place still give about 0.15, as each local error is of few presses. Neighbours are not "
        "drawn again for intervals.",
    ),
    MetricSpec(
        "worst_tenth_mm",
        "Worst tenth",
        formula="the local error, as of Unevenness, that a tenth of the presses reaches",
        domain=f"{_PRESSES}, {LEAST_PRESSES} of them or more",
        unit="mm",
        best="min",
        aggregate=worst_tenth_mm,
        form=".1f",
        traps="Of places, where Localisation 90 % is of presses: a few bad presses everywhere do "
        "not count, a region where half of them are lost does. Smaller spots than the nearest "
        f"{NEIGHBOURS} presses take up are not seen.",
    ),
    MetricSpec(
        "farthest_contact_mm",
        "Farthest contact",
        formula="largest of the distances that localisation takes the mean of, over the contacts "
        "of a touch",
        domain=_SEVERAL,
        unit="mm",
        best="min",
        aggregate="median",
        form=".1f",
        traps="As Localisation. A touch of one contact has but one distance.",
    ),
    MetricSpec(
        "contact_count_error",
        "Count error",
        formula="|contacts found - true contacts|; a contact is a connected region of one sign "
        "with |contrast| >= 1/4 of the image's largest and at least 0.1 % of the sensor",
        domain=f"{_TRUE_IMAGES}, and {_SEVERAL}",
        best="min",
        form=".2f",
        traps="Contacts weaker than a quarter of the strongest count neither in truth nor in "
        "estimate. Overshoot beside a contact counts as one if it is strong enough.",
    ),
    MetricSpec(
        "area_error",
        "Area error",
        formula="|area found - true area| / true area, all contacts together",
        domain=_TRUE_IMAGES,
        best="min",
        form=".2f",
        traps="Blind to place. A smooth image looks large at a quarter of its height.",
    ),
    MetricSpec(
        "iou",
        "IoU",
        formula="pixels in true and found contacts of the same sign / pixels in either",
        domain=_TRUE_IMAGES,
        best="max",
        form=".3f",
        traps="Blind to strength, hard on small contacts.",
    ),
    MetricSpec(
        "edge",
        "Edge",
        formula="step of p across the edges of true contacts / that of t: mean of what lies within "
        "3 % of the sensor's diameter inside, minus the same outside",
        domain=_SIMULATED,
        best=None,
        form=".2f",
        traps="1 is right, more says that an image overshoots. Falls with a wrong place or "
        "strength as with blur.",
    ),
    MetricSpec(
        "artefacts",
        "Artefacts",
        formula="norm of the contrast of p farther than 3 % of the sensor's diameter from true "
        "contacts / norm of the contrast of t",
        domain=_SIMULATED,
        best="min",
        form=".3f",
        traps="An empty image has none. Wide blur counts, too.",
    ),
    MetricSpec(
        "force_error",
        "Force error",
        formula="|F(p) - F(t)| / F(t), F the integral over the sensor of the pressure that the law "
        "of the foam (`scenarios.phantoms.press`) gives to a conductivity",
        domain="simulated soft presses",
        best="min",
        aggregate="median",
        form=".3f",
        traps="Blind to place and shape. The law is told: on a real sensor it has to be measured "
        "first, and hysteresis and creep add to the error. The law is curved, so that noise in an "
        "image adds to the force: 0.1 N on foam16 at 2 % of the background, 0.5 N at 5 %.",
    ),
    MetricSpec(
        "measured_force_error_n",
        "Measured force error",
        formula="|a + b s - F|, s the integrated |contrast| of all contacts of p, F the measured "
        "force; a and b >= 0 by least squares on the first 100 validation touches",
        domain="recorded scenarios with a measured force",
        unit="N",
        best="min",
        aggregate="median",
        form=".2f",
        traps="The line is fitted for each method, so that a common scale or offset of its images "
        "costs nothing, and images that say nothing get the mean force: compare with the spread of "
        "the forces. A straight line: a sensor that saturates has an error of its own. Sensitivity "
        "falls towards the centre, so place disturbs it.",
    ),
    MetricSpec(
        "measured_load_error_percent",
        "Measured load error",
        formula="the same over the largest load of these touches; of the pressure where no "
        "force is known",
        domain="recorded scenarios with a measured force or pressure",
        unit="%",
        best="min",
        aggregate="median",
        form=".1f",
        traps="As Measured force error. Per cent of the full scale, not of each load: small loads "
        "may be wrong by a multiple of themselves.",
    ),
    MetricSpec(
        "iou_resistive",
        "IoU resistive",
        formula="as IoU, contrast below the background only",
        domain=_TRUE_CLASSES,
        best="max",
        form=".3f",
        traps="Not defined where neither image has such a contact; 0 where only one has. With "
        "true classes there is no SSIM or PSNR: a class is not a conductivity, so there "
        "is no error in S/m to measure.",
    ),
    MetricSpec(
        "iou_conductive",
        "IoU conductive",
        formula="as IoU, contrast above the background only",
        domain=_TRUE_CLASSES,
        best="max",
        form=".3f",
        traps="As IoU resistive.",
    ),
    MetricSpec(
        "ktc_score",
        "KTC score",
        formula="mean of the SSIM of conductive and of resistive pixels, 256 x 256, in Gaussian "
        "windows of standard deviation 80 pixels, C1 = 1e-4, C2 = 9e-4; p is brought to these "
        "pixels by linear interpolation and cut into classes by Otsu's rule with two thresholds, "
        "the largest class being the background",
        domain="the levels of the Kuopio Tomography Challenge 2023",
        best="max",
        mask="the whole square, of which the tank is the disc",
        form=".3f",
        traps="The challenge's own: at most 1 an image, and 21 for its 21 images. A class that "
        "neither image holds counts 1, so that half of the score is won where there is only one "
        "kind of object and p shows no other; the windows are wide, so that shape counts little.",
    ),
    MetricSpec(
        "strength_spearman",
        "Strength",
        formula="Spearman correlation of the integrated |contrast|, of the strongest contact of "
        "simulated and of all contacts of recorded touches, with force, pressure or press depth",
        domain="scenarios where a force, a pressure or a press depth is known",
        best="max",
        aggregate=strength_spearman,
        form=".2f",
        traps="Ranks only. Sensitivity falls towards the centre, so place disturbs it. A method"
        " of constant strength gets 0.",
    ),
    MetricSpec(
        "repeatability_db",
        "Repeatability",
        formula="20 log10(rms contrast of touched frames / rms contrast of frames without a touch)",
        domain="recorded scenarios of which nothing but touched or untouched is known",
        unit="dB",
        best="max",
        aggregate=repeatability_db,
        form=".1f",
        traps="Says that a method responds to a touch more than to noise and drift, not that "
        "its image is right. Not defined for a method that never responds.",
    ),
)

METRICS = {spec.name: spec for spec in _SPECS}
"""By name, in the order of the columns of stored tables."""

METRIC_COLUMNS = (
    *(spec.name for spec in _SPECS if not callable(spec.aggregate)),
    "strength",
    "response",
    "found_x_m",
    "found_y_m",
    "expected_x_m",
    "expected_y_m",
)
"""Per sample, NaN where not defined; `found` and `expected` places are in the image's frame."""

ANCHORS = {spec.name: spec.anchors for spec in _SPECS if spec.anchors is not None}
"""Values that count as 0 and as 1 in the bounded score: nothing in common with the truth and all of
it; an error as large as the truth and none; an error of the whole data range and of 1 % of it."""


def score(ssim: ArrayLike, cc: ArrayLike, rie: ArrayLike, psnr: ArrayLike) -> Array:
    """Weighted score S = 0.25 (SSIM + CC + PSNR) - 0.25 RIE as published, with PSNR in dB."""
    total = np.asarray(ssim, float) + np.asarray(cc, float) + np.asarray(psnr, float)
    return np.asarray(0.25 * (total - np.asarray(rie, float)))


def anchored(figures: Mapping[str, ArrayLike]) -> Array:
    """SSIM, CC, RIE and PSNR (n,) between their `ANCHORS` as numbers from 0 to 1: (n, 4)."""
    columns = [
        (np.asarray(figures[name], float) - low) / (high - low)
        for name, (low, high) in ANCHORS.items()
    ]
    return np.stack(columns, axis=-1).clip(0.0, 1.0)


def bounded_score(figures: Mapping[str, ArrayLike]) -> Array:
    """Mean of SSIM, CC, RIE and PSNR (n,), each between its `ANCHORS`: (n,), from 0 to 1."""
    return np.asarray(anchored(figures).mean(axis=-1))
