"""Tables of the page on fair comparison: the suite `traps`, and readings of published rows."""

import json
from collections.abc import Callable, Mapping

import pandas as pd
from docs.tables.record import STUDIES, printed

from eitbench.reports.claims.rules import LABELS
from eitbench.reports.tables.published import TABLE_II


def _trap(run: str, scenario: str, columns: Mapping[str, tuple[str, str]]) -> Callable[[], str]:
    """Return the table of a scenario of `traps.csv`; columns by name with heading and format."""

    def made() -> str:
        of = _traps().loc[run, scenario].reset_index().sort_values("ssim", ascending=False)
        rows = [
            [
                f"`{row['method']}`",
                *(format(row[name], form) for name, (_, form) in columns.items()),
            ]
            for row in of.to_dict("records")
        ]
        return printed(["", *(heading for heading, _ in columns.values())], rows)

    return made


def _traps() -> pd.DataFrame:
    stored = pd.read_csv(STUDIES / "traps" / "traps.csv")
    return stored.set_index(["run", "scenario", "method"]).sort_index()


def _untuned_and_tuned() -> str:
    stored = _traps()
    rows = []
    for method in ("noser", "tv"):
        both = (stored.loc[run, "finer-mesh", method] for run in ("untuned", "tuned"))
        rows.append([f"`{method}`", *(f"{r['score']:.2f} ({r['psnr']:.1f} dB)" for r in both)])
    return printed(["S on `finer-mesh`", "as it comes", "tuned"], rows)


def _meshes_and_noise() -> str:
    psnr = _traps().loc["tuned"]["psnr"]
    names = {"same-mesh": "same mesh", "finer-mesh": "finer mesh", "finer-mesh-40db": "and 40 dB"}
    rows = [
        [f"`{method}`", *(f"{psnr[name, method]:.2f}" for name in names)]
        for method in ("tv", "noser", "back-projection", "nothing")
    ]
    return printed(["PSNR [dB]", *names.values()], rows)


_READ = (
    # frames, axes, background
    ("absolute maps", "as they are", "as they are", True),
    ("without their background", "as they are", "as they are", False),
    ("the same, axes exchanged", "as they are", "exchanged", False),
    ("frames of offset 4 taken for offset 3, without background",
     "offset 4, taken for offset 3", "as they are", False),
    ("electrodes numbered the other way, without background",
     "electrodes numbered the other way", "as they are", False),
)  # fmt: skip


def _readings() -> str:
    stored = pd.DataFrame(json.loads((STUDIES / "readings" / "readings.json").read_text())["rows"])
    plain = stored[(stored["sign"] == 1) & (stored["strength"] == 1)]
    by = plain.set_index(["method", "frames", "axes", "background"])
    rows = []
    for method in ("noser", "tv"):
        rows.append([LABELS[method], "published", *_four(TABLE_II[method])])
        rows += [["", title, *_four(by.loc[(method, *reading)])] for title, *reading in _READ]
    return printed(["", "read as", "SSIM", "CC", "RIE", "PSNR"], rows, [False] * 2 + [True] * 4)


def _four(row: Mapping[str, float]) -> list[str]:
    return [
        f"{row['ssim']:.3f}", f"{row['cc']:.2f}", f"{row['rie']:.2f}", f"{row['psnr']:.1f} dB",
    ]  # fmt: skip


TABLES = {
    "nothing": _trap(
        "untuned",
        "finer-mesh-40db",
        {
            "ssim": ("SSIM", ".3f"),
            "rie": ("RIE", ".3f"),
            "psnr": ("PSNR [dB]", ".1f"),
            "cc": ("CC", ".3f"),
            "iou": ("IoU", ".3f"),
            "score": ("S", ".2f"),
            "bounded": ("B", ".3f"),
        },
    ),
    "untuned and tuned": _untuned_and_tuned,
    "meshes and noise": _meshes_and_noise,
    "readings": _readings,
}
