"""Tables of the page on published claims."""

import json

from docs.tables.record import STUDIES, printed, recorded


def _claims() -> str:
    stored = json.loads((STUDIES / "claims" / "claims.json").read_text())
    rows = []
    for claim in stored["claims"]:
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
