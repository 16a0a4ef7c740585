"""The table of networks that are fitted to each frame."""

from docs.tables.record import printed, recorded

_HEADS = ["data", "method", "samples", "SSIM", "CC", "RIE", "PSNR [dB]", "ms a frame"]


def _time(ms: float | None) -> str:
    """Empty where the machine was busy."""
    return "" if ms is None else f"{ms:,.0f}" if ms >= 10 else f"{ms:.1f}"


def _figures() -> str:
    """Return the figures of the suite, the best PSNR of each scenario first."""
    rows = recorded("per-frame")
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    rows.sort(key=lambda row: (scenarios.index(row["scenario"]), -row["psnr"]))
    body = [
        [
            row["scenario"].removeprefix("per-frame-").replace("db", " dB"),
            f"`{row['method']}`",
            str(row["n"]),
            f"{row['ssim']:.3f}",
            f"{row['cc']:.3f}",
            f"{row['rie']:.4f}",
            f"{row['psnr']:.2f}",
            _time(row["frame_ms_p50"]),
        ]
        for row in rows
    ]
    return printed(_HEADS, body, [False, False, *[True] * 6])


TABLES = {"fitted to each frame": _figures}
