"""Footers of Parquet files as Arrow writes them, and damaged ones."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eitbench.benchmark.rundir.parquet_footer import codecs, unpacked_bytes
from eitbench.benchmark.rundir.tables import read_parquet


@pytest.fixture
def table() -> pa.Table:
    return pa.table({"number": np.arange(40), "text": [f"row {k}" for k in range(40)]})


@pytest.mark.parametrize("rows", [40, 3])
@pytest.mark.parametrize(
    "codec", ["none", "snappy", "gzip", "brotli", "lz4", {"number": "zstd", "text": "snappy"}]
)
def test_codecs_are_those_that_arrow_sees(
    codec: str | dict[str, str], rows: int, table: pa.Table, tmp_path: Path
) -> None:
    pq.write_table(table, tmp_path / "a.parquet", compression=codec, row_group_size=rows)
    about = pq.read_metadata(tmp_path / "a.parquet")
    seen = {
        about.row_group(k).column(c).compression
        for k in range(about.num_row_groups)
        for c in range(about.num_columns)
    }
    assert {name.removesuffix("_RAW") for name in codecs(tmp_path / "a.parquet")} == seen


@pytest.mark.parametrize("codec", ["none", "snappy", "brotli"])
def test_pages_claim_what_their_values_take(codec: str, tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    texts = [f"a text of some length, {k}" for k in range(1000)]
    table = pa.table({"number": np.arange(1000.0), "text": texts, "same": ["s"] * 1000})
    pq.write_table(table, path, compression=codec, row_group_size=300, use_dictionary=["same"])
    about = pq.read_metadata(path)
    groups = [about.row_group(k) for k in range(about.num_row_groups)]
    with_headers = sum(group.total_byte_size for group in groups)
    values = 8 * 1000 + sum(4 + len(text) for text in texts)
    assert values <= unpacked_bytes(path) <= with_headers
    assert with_headers - values < 1000


def test_a_table_without_rows_takes_nothing(table: pa.Table, tmp_path: Path) -> None:
    pq.write_table(table[:0], tmp_path / "a.parquet")
    assert unpacked_bytes(tmp_path / "a.parquet") == 0
    assert read_parquet(tmp_path / "a.parquet").shape == (0, 2)


def test_a_page_that_claims_too_much_is_never_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    table = pa.table({"text": ["x" * 20_000_000] * 10})
    pq.write_table(table, path, compression="brotli", use_dictionary=False)
    assert 200_000_000 < unpacked_bytes(path) < 200_001_000
    assert path.stat().st_size < 300_000
    with pytest.raises(ValueError, match="claims to be much larger"):
        read_parquet(path)


def test_a_page_of_negative_size_makes_no_room_for_another(table: pa.Table, tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(table, path, use_dictionary=False)
    content = bytearray(path.read_bytes())
    place = pq.read_metadata(path).row_group(0).column(0).data_page_offset
    assert content[place] == content[place + 2] == 0x15  # both integers, the second is the size
    content[place + 3] |= 1  # the sign of an integer in Thrift's compact protocol
    path.write_bytes(content)
    with pytest.raises(ValueError, match="header of a page, is damaged"):
        unpacked_bytes(path)


def test_what_is_no_footer_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    deep = b"\x1c" * 40
    loop = b"\x19\xfc\xff\xff\xff\xff\x0f"  # a list of four thousand million structures
    for footer in (b"", b"\x00", b"\xff" * 30, deep, loop, b"\x15" + b"\x80" * 30):
        path.write_bytes(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
        with pytest.raises(ValueError, match="damaged"):
            codecs(path)
    for content in (b"", b"PAR1", b"PAR1" + b"\xff\xff\xff\xffPAR1", b"\0" * 100):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"does not end|longer"):
            codecs(path)


SPOIL = """
import random, sys
from pathlib import Path
from eitbench.benchmark.rundir.tables import read_parquet
path = Path(sys.argv[1])
good, chance = path.read_bytes(), random.Random(0)
footer = int.from_bytes(good[-8:-4], "little")
for place in range(len(good) - 8 - footer, len(good) - 8):
    path.write_bytes(good[:place] + bytes([chance.randrange(256)]) + good[place + 1 :])
    try:
        read_parquet(path)
    except Exception:
        pass
"""


@pytest.mark.slow
def test_no_damaged_footer_ends_the_process(table: pa.Table, tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pq.write_table(table, path)
    assert read_parquet(path).shape == (40, 2)
    done = subprocess.run([sys.executable, "-c", SPOIL, str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]
