"""A card per metric: what it says, where it is defined and what it hides; reports print them."""

from dataclasses import dataclass
from typing import Literal

SENSOR = "pixels whose centre lies inside the sensor"
_SIMULATED = "scenarios with a true conductivity"
_TRUE_IMAGES = "scenarios with a true conductivity or true classes"
_RANGE = "the sensor's data range, 1.0 S/m for foam16"


@dataclass(frozen=True)
class MetricCard:
    """What a reader must know of a metric.

    Attributes:
        name: column name.
        title: as printed in tables.
        formula: in words or symbols; t is the truth, p the estimate, both in S/m. Of operators, v
            are the model's clean voltages, w the operator's, z and y the same standardised.
        domain: scenarios it is computed for.
        unit: "1" where it has none.
        best: whether more or less is better; None where it is descriptive.
        mask: which pixels or measurements count.
        data_range: the range of conductivity it uses, if any.
        average: how it is summed up over the samples of a scenario.
        traps: what it hides or rewards.
    """

    name: str
    title: str
    formula: str
    domain: str
    unit: str
    best: Literal["max", "min"] | None
    mask: str
    data_range: str
    average: Literal["mean", "median", "whole scenario"]
    traps: str


METRICS: dict[str, MetricCard] = {
    card.name: card
    for card in (
        MetricCard(
            "ssim",
            "SSIM",
            "mean over 7 x 7 windows of (2 mt mp + C1)(2 cov + C2) / ((mt^2 + mp^2 + C1)"
            "(vt + vp + C2)), C1 = (0.01 L)^2, C2 = (0.03 L)^2, sample (co)variance, as "
            "scikit-image",
            _SIMULATED,
            "1",
            "max",
            "windows wholly inside the sensor, so a 3-pixel rim counts less",
            _RANGE,
            "mean",
            "A flat background fills most windows: doing nothing already scores high. Depends on "
            "the pixel size and on the data range; values for other grids do not compare.",
        ),
        MetricCard(
            "cc",
            "CC",
            "Pearson correlation of t and p over pixels; with true classes, of the class "
            "(-1, 0, +1) and the contrast",
            _TRUE_IMAGES,
            "1",
            "max",
            SENSOR,
            "none",
            "mean",
            "Blind to scale and offset: an image of the wrong conductivity can reach 1. A constant "
            "image has no correlation; it counts as 0 and its row is flagged `cc_undefined`.",
        ),
        MetricCard(
            "rie",
            "RIE",
            "||p - t|| / ||t||",
            _SIMULATED,
            "1",
            "min",
            SENSOR,
            "none",
            "mean",
            "Relative to the absolute conductivity, background included: it shrinks when the "
            "background grows, and doing nothing scores well.",
        ),
        MetricCard(
            "psnr",
            "PSNR",
            "10 log10(L^2 / mean((p - t)^2))",
            _SIMULATED,
            "dB",
            "max",
            SENSOR,
            _RANGE,
            "mean",
            "At most 138.5 dB: images are kept in float32, and an error below its rounding says "
            "nothing, so that one perfect image does not make the mean infinite. A mean of "
            "logarithms: a few very good images raise it more than many bad ones lower it.",
        ),
        MetricCard(
            "score",
            "S",
            "0.25 (SSIM + CC + PSNR) - 0.25 RIE, PSNR in dB",
            _SIMULATED,
            "1",
            "max",
            SENSOR,
            _RANGE,
            "mean",
            "As published. PSNR is about twenty times as large as the other terms, so S ranks "
            "almost as PSNR does.",
        ),
        MetricCard(
            "bounded",
            "B",
            "mean of SSIM, CC, 1 - RIE and PSNR / 40 dB, each kept within 0 and 1",
            _SIMULATED,
            "1",
            "max",
            SENSOR,
            _RANGE,
            "mean",
            "Its anchors are fixed, so that it compares across runs, and its four parts weigh "
            "alike; that they should is a convention, too. Ranks follow S.",
        ),
        MetricCard(
            "localisation_mm",
            "Localisation",
            "distance between the |contrast|-weighted centroids of true and found contacts, "
            "optimally assigned (simulated or classes); between the press and the centre of the "
            "|contrast| in excess of 1/4 of its largest value, mapped by the similarity with the "
            "least sum of distances on the validation split (positions)",
            "scenarios where contacts or positions are known",
            "mm",
            "min",
            SENSOR,
            "none",
            "median",
            "A contact that was missed is charged the distance to the nearest found one; an image "
            "without any is charged the sensor's diameter. The similarity is fitted for each "
            "method, so a common shift, turn, mirror image or scale of its images costs nothing. "
            "The median hides the worst half.",
        ),
        MetricCard(
            "contact_count_error",
            "Count error",
            "|contacts found - true contacts|; a contact is a connected region of one sign with "
            "|contrast| >= 1/4 of the image's largest and at least 0.1 % of the sensor",
            _TRUE_IMAGES,
            "1",
            "min",
            SENSOR,
            "none",
            "mean",
            "Contacts weaker than a quarter of the strongest count neither in truth nor in "
            "estimate. Overshoot beside a contact counts as one if it is strong enough.",
        ),
        MetricCard(
            "area_error",
            "Area error",
            "|area found - true area| / true area, all contacts together",
            _TRUE_IMAGES,
            "1",
            "min",
            SENSOR,
            "none",
            "mean",
            "Blind to place. A smooth image looks large at a quarter of its height.",
        ),
        MetricCard(
            "iou",
            "IoU",
            "pixels in true and found contacts of the same sign / pixels in either",
            _TRUE_IMAGES,
            "1",
            "max",
            SENSOR,
            "none",
            "mean",
            "Blind to strength, hard on small contacts.",
        ),
        MetricCard(
            "iou_resistive",
            "IoU resistive",
            "as IoU, contrast below the background only",
            "scenarios with true classes",
            "1",
            "max",
            SENSOR,
            "none",
            "mean",
            "Not defined where neither image has such a contact; 0 where only one has. With true "
            "classes there is no SSIM or PSNR: a class is not a conductivity, so there is no "
            "error in S/m to measure.",
        ),
        MetricCard(
            "iou_conductive",
            "IoU conductive",
            "as IoU, contrast above the background only",
            "scenarios with true classes",
            "1",
            "max",
            SENSOR,
            "none",
            "mean",
            "As IoU resistive.",
        ),
        MetricCard(
            "strength_spearman",
            "Strength",
            "Spearman correlation of the strongest contact's integrated |contrast| with pressure "
            "or press depth",
            "scenarios where a pressure or a press depth is known",
            "1",
            "max",
            SENSOR,
            "none",
            "whole scenario",
            "Ranks only. Sensitivity falls towards the centre, so place disturbs it. A method of "
            "constant strength gets 0.",
        ),
        MetricCard(
            "repeatability_db",
            "Repeatability",
            "20 log10(rms contrast of touched frames / rms contrast of untouched frames)",
            "recorded scenarios of which nothing but touched or untouched is known",
            "dB",
            "max",
            SENSOR,
            "none",
            "whole scenario",
            "Says that a method responds to a touch more than to noise and drift, not that its "
            "image is right. Not defined for a method that never responds.",
        ),
    )
}
