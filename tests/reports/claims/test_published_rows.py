"""Readings of the published rows."""

from pathlib import Path

import pandas as pd
import pytest

from eitbench.benchmark.studies.readings import write_readings
from eitbench.reports.claims.published_rows import read_rows
from eitbench.scenarios.errors import DataCorruptError


def test_the_readings_of_a_row_say_what_they_reproduce(tmp_path: Path) -> None:
    plain = {
        "method": "noser", "frames": "as they are", "axes": "as they are", "background": True,
        "sign": 1, "strength": 1.0, "ssim": 0.6, "cc": 0.84, "rie": 0.06, "psnr": 24.0,
    }  # fmt: skip
    fitted = plain | {"strength": 8.0, "ssim": -0.01, "cc": 0.12, "rie": 1.213, "psnr": -1.5}
    exchanged = plain | {"axes": "exchanged", "cc": 0.125}
    rows = [plain, exchanged, fitted]
    table = pd.DataFrame(rows + [row | {"method": "tv"} for row in rows])
    write_readings(table, 600, tmp_path)
    noser, tv = read_rows(tmp_path)
    assert [reading["name"] for reading in noser["readings"]] == [
        "absolute maps, as scored here", "8 times as strong (fitted to RIE)", "axes exchanged",
    ]  # fmt: skip
    assert [reading["reproduced"] for reading in noser["readings"]] == [
        [], ["ssim", "cc", "psnr"], ["cc"],
    ]  # fmt: skip
    assert "the best reproduce 3 of the four" in noser["says"]
    assert "None reproduces its RIE" in noser["says"]
    assert "the best reproduce 0" in tv["says"]
    (tmp_path / "readings.json").write_text('{"rows": [{}]}')
    with pytest.raises(DataCorruptError, match="damaged"):
        read_rows(tmp_path)
