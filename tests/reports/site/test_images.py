"""Pictures of the site."""

from typing import Any

import pytest

from eitbench.reports.site import images
from eitbench.reports.site.images import over_noise


def at(snr_db: float | str | None, psnr: float) -> Any:
    """A board of two methods at one level of noise."""
    about = {"scenario": "none", "data_hash": "", "data_n": 3}
    rows = [{"label": name, "psnr": psnr - k, **about} for k, name in enumerate(("one", "other"))]
    return {"snr_db": snr_db, "views": [{"rows": rows}]}


def test_figures_over_noise_need_levels_that_differ_in_noise_alone() -> None:
    levels = [at(30.0, 20.0), at("clean", 29.0), at(50.0, 27.0), at(40.0, 24.0), at(None, 22.0)]
    drawn = over_noise(levels, "one")
    assert drawn is not None
    assert b"<svg" in drawn
    assert over_noise(levels[:3], "one") is None  # two levels
    assert over_noise([*levels, at(50.0, 26.0)], "one") is None


def test_the_ceiling_is_drawn_where_it_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    levels = [at(30.0, 20.0), at(40.0, 24.0), at(50.0, 27.0)]
    without = over_noise(levels, "one")
    monkeypatch.setattr(images, "ceiling_rows", lambda rows: [{"psnr": rows[0]["psnr"] + 5}])
    drawn = over_noise(levels, "one")
    assert without is not None
    assert drawn is not None
    assert drawn.count(b"stroke-dasharray") > without.count(b"stroke-dasharray")
