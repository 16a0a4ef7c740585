"""Tables of the page on published claims."""

from functools import cache

from docs.tables.record import STUDIES, newest, printed, recorded

from eitbench.benchmark.studies.training_study import paper_curves
from eitbench.reports.claims.ledger import Ledger, claim_ledger


@cache
def ledger() -> Ledger:
    """What the newest records and the stored studies say of every claim."""
    suites = ("paper", "operators", "noise", "shapes", "presses", "objects")
    studies = [STUDIES / name for name in ("physics", "beta")]
    return claim_ledger([newest(suite) for suite in suites], studies, paper_curves())


def _claims() -> str:
    rows = []
    for claim in ledger()["claims"]:
        says = claim["claim"].removesuffix(".")
        rows.append([f"**{claim['verdict']}**", says, claim["source"], str(claim["n"] or "–")])
    return printed(["verdict", "claim", "in", "samples"], rows, [False] * 3 + [True])


def _objects() -> str:
    columns = {
        "group": ("Ties", ""), "score": ("S", ".2f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
        "rie": ("RIE", ".3f"), "psnr": ("PSNR [dB]", ".1f"),
        "localisation_mm": ("Localisation [mm]", ".1f"), "iou": ("IoU", ".2f"),
        "edge": ("Edge", ".2f"), "artefacts": ("Artefacts", ".2f"),
    }  # fmt: skip
    rows = [
        [f"`{row['method']}`", *(format(row[name], form) for name, (_, form) in columns.items())]
        for row in recorded("objects")
    ]
    return printed(["", *(heading for heading, _ in columns.values())], rows)


TABLES = {
    "claims": _claims,
    "objects": _objects,
}
