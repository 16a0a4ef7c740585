"""The audit of the published classical rows: the same images, read in two ways."""

from dataclasses import dataclass

from eitbench.benchmark.analysis.readings import (
    Images,
    Reading,
    Readings,
    implied_rms,
    read_both_ways,
    read_constants,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.claims.claims import agreeing
from eitbench.reports.claims.evidence import SCENARIO, Evidence, NotMeasuredError
from eitbench.reports.tables.published import TABLE_II

CLASSICAL = ("noser", "tv")


@dataclass(frozen=True)
class MethodAudit:
    """One classical method.

    Attributes:
        conditions: what the readings rest on; the reason where there are none.
        says: what the published row is consistent with.
    """

    method: str
    readings: tuple[Reading, ...]
    conditions: str
    says: str


@dataclass(frozen=True)
class Audit:
    """The classical methods, and what constant images score beside them.

    Attributes:
        says: what the published figures say of the truth they were scored against.
    """

    methods: tuple[MethodAudit, ...]
    constants: tuple[Reading, ...]
    says: str


def audit(evidence: Evidence) -> Audit:
    """Read the stored images of every classical method in two ways.

    Raises:
        InputError: several runs hold the same method.
        DataCorruptError: a run does not hold its images.
    """
    methods: list[MethodAudit] = []
    constants: tuple[Reading, ...] = ()
    for method in CLASSICAL:
        try:
            measured = evidence.of(METHOD_RUNS, method)
        except NotMeasuredError as missing:
            methods.append(MethodAudit(method, (), str(missing), ""))
            continue
        images = Images(measured.run, SCENARIO, method)
        readings = read_both_ways(images, TABLE_II[method]["rie"])
        constants = constants or read_constants(images)
        says = _consistency(method, readings)
        methods.append(MethodAudit(method, readings.all, measured.conditions, says))
    return Audit(tuple(methods), constants, _of_the_truth(constants))


def _consistency(method: str, readings: Readings) -> str:
    published, label = TABLE_II[method], method.upper()
    absolute, plain = readings.absolute.figures, readings.difference.figures
    said = [
        f"Read as absolute maps the images of {label} have CC {absolute['cc']:.2f} and PSNR "
        f"{absolute['psnr']:.1f} dB; without their background RIE {plain['rie']:.2f}, PSNR "
        f"{plain['psnr']:.2f} dB and SSIM {plain['ssim']:.2f}."
    ]
    if all(agreeing(method, plain).values()):
        said.append(_consistent(label, "of a difference image without its background"))
    elif readings.scaled is not None and readings.factor is not None:
        scaled = readings.scaled.figures
        said.append(
            f"Taken {readings.factor:.2g} times as strong they have the published RIE "
            f"{published['rie']:.2f}, which all but decides PSNR ({scaled['psnr']:.2f} dB), and "
            f"SSIM {scaled['ssim']:.2f}."
        )
        if all(agreeing(method, scaled).values()):
            what = "of such a difference image, of other strength than ours"
            said.append(_consistent(label, what))
        else:
            said.append(f"The published row of {label} is not consistent with that either.")
    return " ".join(said)


def _consistent(label: str, what: str) -> str:
    return (
        f"The published row of {label} is consistent with the score {what}; that does not exclude "
        "other explanations."
    )


def _of_the_truth(constants: tuple[Reading, ...]) -> str:
    """What RIE and PSNR together say of the images that methods were compared with."""
    levels = [implied_rms(TABLE_II[name]["rie"], TABLE_II[name]["psnr"]) for name in CLASSICAL]
    said = (
        "RIE and PSNR of one image together give the root mean square of its truth, whatever the "
        "method, and so do their means where errors are alike: "
        f"{levels[0]:.3f} of the data range by the published row of NOSER, {levels[1]:.3f} by that "
        "of TV."
    )
    if constants:
        zero, contrast = (implied_rms(1.0, reading.figures["psnr"]) for reading in constants)
        absolute = all(abs(level - zero) < abs(level - contrast) for level in levels)
        said += (
            f" Here it is {zero:.3f} for absolute maps and {contrast:.3f} for contrasts. So the "
            f"published rows are consistent with images scored against "
            f"{'absolute maps' if absolute else 'contrasts'}."
        )
    return said
