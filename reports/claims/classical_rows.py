"""The published classical rows: the images of NOSER and TV here, read in two ways beside them."""

from typing import Any, TypedDict

from eitbench.benchmark.analysis.difference_images import (
    FIGURES,
    Readings,
    implied_rms,
    read_both_ways,
    read_constants,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.claims.evidence import SCENARIO, Evidence, NotMeasuredError
from eitbench.reports.claims.rules import agreeing
from eitbench.reports.tables.published import SSIM_IN_WORDS, TABLE_II

CLASSICAL = ("noser", "tv")

ReadingRow = dict[str, Any]
"""`reading`, the name of a reading, and its figures by a name of `FIGURES`."""


class MethodReadings(TypedDict):
    """Readings of one classical method.

    `conditions` says what they rest on, or why there are none; `says` compares them with the
    published row, which is the first of `rows`.
    """

    method: str
    conditions: str
    says: str
    rows: list[ReadingRow]


class ClassicalReadings(TypedDict):
    """Readings of the classical methods and of constant images.

    `says` compares the truths that the published and our figures were computed against.
    """

    methods: list[MethodReadings]
    constants: list[ReadingRow]
    says: str


def classical_readings(evidence: Evidence) -> ClassicalReadings:
    """Read the stored images of every classical method in two ways.

    Raises:
        InputError: several runs hold the same method.
        DataCorruptError: a run does not hold its images.
    """
    methods: list[MethodReadings] = []
    constants: Readings = {}
    for method in CLASSICAL:
        published = {"reading": "published", **dict.fromkeys(FIGURES), "ssim": SSIM_IN_WORDS}
        readings = MethodReadings(
            method=method, conditions="", says="", rows=[published | dict(TABLE_II[method])]
        )
        methods.append(readings)
        try:
            measured = evidence.of(METHOD_RUNS, method)
        except NotMeasuredError as missing:
            readings["conditions"] = str(missing)
            continue
        images = (measured.run, SCENARIO, method)
        ours, factor = read_both_ways(images, TABLE_II[method]["rie"])
        constants = constants or read_constants(images)
        readings["conditions"] = measured.conditions
        readings["says"] = _consistency(method, ours, factor)
        readings["rows"] += _rows(ours)
    return ClassicalReadings(
        methods=methods, constants=_rows(constants), says=_on_the_truth(constants)
    )


def _rows(readings: Readings) -> list[ReadingRow]:
    return [{"reading": name, **figures} for name, figures in readings.items()]


def _consistency(method: str, readings: Readings, factor: float | None) -> str:
    """Describe the readings of a method beside its published row."""
    published, label = TABLE_II[method], method.upper()
    absolute, plain, _, *rest = readings.values()
    sentences = [
        f"Read as absolute maps the images of {label} have CC {absolute['cc']:.2f} and PSNR "
        f"{absolute['psnr']:.1f} dB; without their background RIE {plain['rie']:.2f}, PSNR "
        f"{plain['psnr']:.2f} dB and SSIM {plain['ssim']:.2f}."
    ]
    if all(agreeing(method, plain).values()):
        sentences.append(_consistent(label, "of a difference image without its background"))
    elif factor is not None:
        (scaled,) = rest
        sentences.append(
            f"Taken {factor:.2g} times as strong they have the published RIE "
            f"{published['rie']:.2f}, which all but decides PSNR ({scaled['psnr']:.2f} dB), and "
            f"SSIM {scaled['ssim']:.2f}."
        )
        if all(agreeing(method, scaled).values()):
            what = "of such a difference image, of other strength than ours"
            sentences.append(_consistent(label, what))
        else:
            sentences.append(f"The published row of {label} is not consistent with that either.")
    return " ".join(sentences)


def _consistent(label: str, what: str) -> str:
    return (
        f"The published row of {label} is consistent with the score {what}; that does not exclude "
        "other explanations."
    )


def _on_the_truth(constants: Readings) -> str:
    """Compare the truth that RIE and PSNR of a published row imply with ours."""
    levels = [implied_rms(TABLE_II[name]["rie"], TABLE_II[name]["psnr"]) for name in CLASSICAL]
    sentences = (
        "RIE and PSNR of one image together give the root mean square of its truth, whatever the "
        "method, and so do their means where errors are alike: "
        f"{levels[0]:.3f} of the data range by the published row of NOSER, {levels[1]:.3f} by that "
        "of TV."
    )
    if constants:
        zero, contrast = (implied_rms(1.0, figures["psnr"]) for figures in constants.values())
        absolute = all(abs(level - zero) < abs(level - contrast) for level in levels)
        sentences += (
            f" Here it is {zero:.3f} for absolute maps and {contrast:.3f} for contrasts. So the "
            f"published rows are consistent with images scored against "
            f"{'absolute maps' if absolute else 'contrasts'}."
        )
    return sentences
