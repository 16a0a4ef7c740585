"""Pictures of the site."""

from typing import Any

from eitbench.reports.site.images import over_noise


def at(snr_db: float | str | None, psnr: float) -> Any:
    """A board of two methods at one level of noise."""
    rows = [{"label": "one", "psnr": psnr}, {"label": "other", "psnr": psnr - 1}]
    return {"snr_db": snr_db, "views": [{"rows": rows}]}


def test_figures_over_noise_need_levels_that_differ_in_noise_alone() -> None:
    levels = [at(30.0, 20.0), at("clean", 29.0), at(50.0, 27.0), at(40.0, 24.0), at(None, 22.0)]
    drawn = over_noise(levels, "one")
    assert drawn is not None
    assert b"<svg" in drawn
    assert over_noise(levels[:3], "one") is None  # two levels
    assert over_noise([*levels, at(50.0, 26.0)], "one") is None
