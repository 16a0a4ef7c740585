"""The table of networks that are fitted to each frame."""

import pandas as pd
from docs.tables.record import STUDIES, printed

_HEADS = ["data", "method", "samples", "SSIM", "CC", "RIE", "PSNR [dB]", "ms a frame"]


def _figures() -> str:
    """Return the figures of the suite, the best PSNR of each scenario first."""
    stored = pd.read_csv(STUDIES / "per-frame" / "figures.csv")
    rows = [
        [
            scenario.removeprefix("per-frame-").replace("db", " dB"),
            f"`{row.method}`",
            str(row.samples),
            f"{row.ssim:.3f}",
            f"{row.cc:.3f}",
            f"{row.rie:.4f}",
            f"{row.psnr:.2f}",
            f"{row.frame_ms:,.0f}" if row.frame_ms >= 10 else f"{row.frame_ms:.1f}",
        ]
        for scenario, cells in stored.groupby("scenario", sort=False)
        for row in cells.sort_values("psnr", ascending=False).itertuples()
    ]
    return printed(_HEADS, rows, [False, False, *[True] * 6])


TABLES = {"fitted to each frame": _figures}
