"""Parquet files of run directories: what is read is what was written."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.rundir.tables import read_parquet, write_parquet


@pytest.mark.slow
def test_a_flipped_bit_is_refused_or_changes_no_value(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    names = rng.choice(["noser", "tv", "greit"], 200)
    table = pd.DataFrame({"method": names, "ssim": rng.random(200), "sample": np.arange(200)})
    whole, flipped = tmp_path / "whole.parquet", tmp_path / "flipped.parquet"
    write_parquet(table, whole)
    pd.testing.assert_frame_equal(read_parquet(whole), pd.read_parquet(whole))
    content = whole.read_bytes()
    refused = 0
    for bit in rng.choice(8 * len(content), 400, replace=False).tolist():
        spoilt = bytearray(content)
        spoilt[bit // 8] ^= 1 << bit % 8
        flipped.write_bytes(spoilt)
        try:
            read = read_parquet(flipped)
        except Exception:
            refused += 1
            continue
        assert read.to_numpy().tolist() == table.to_numpy().tolist(), bit
    assert refused > 200
