"""Parquet files of run directories: read if they hold what was written, in bounded memory."""

from collections.abc import Iterable
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from eitbench.benchmark.rundir.parquet_footer import codecs, unpacked_bytes
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.storage.limits import SPARE, most_bytes

MOST_COLUMNS = 500
BYTES_A_ROW = 2**14
"""Texts of a row take some 100 bytes, those of a cell some kB."""
CODECS = ("SNAPPY", "BROTLI", "UNCOMPRESSED")
"""Those that we write, in runs and in records, and in pages of small files."""


def write_parquet(table: pd.DataFrame, path: Path) -> None:
    """Write `table` to the new file `path`, with a checksum for each of its pages."""
    table.to_parquet(path, index=False, write_page_checksum=True)


def read_parquet(path: Path, most_rows: int | None = None) -> pd.DataFrame:
    """Read the table at `path`, which has no more than `most_rows` if that is known.

    Raises:
        Exception: whatever the damage leads to, with its reason.
    """
    most = most_bytes(path)
    with pq.ParquetFile(path) as file:
        about, schema = file.metadata, file.schema_arrow
        if most_rows is not None and about.num_rows > most_rows:
            raise ValueError(f"it has {about.num_rows:,} rows, and its run {most_rows:,}")
        if about.num_columns > MOST_COLUMNS:
            raise ValueError(f"it has more than {MOST_COLUMNS} columns")
        for field in schema:
            if pa.types.is_nested(field.type):
                raise ValueError(f"column {field.name!r} holds neither numbers nor text")
        used = codecs(path)
        if not used <= set(CODECS):
            raise ValueError(f"it is compressed with {', '.join(sorted(used))}")
        if max(about.num_rows * about.num_columns * 8, unpacked_bytes(path)) > most:
            raise ValueError("it claims to be much larger than the file")
    texts = [field.name for field in schema if _is_text(field.type)]
    # As a dictionary a text that is repeated a million times takes its memory once.
    table = pq.read_table(path, columns=texts, read_dictionary=texts)
    table.validate(full=True)  # it is UTF-8
    if sum(map(_length, table.columns)) > min(most, about.num_rows * BYTES_A_ROW + SPARE):
        raise ValueError("its texts are longer than those of a run")
    # Without its checksums a flipped bit would be another figure.
    return pd.read_parquet(path, page_checksum_verification=True)


def columns_of(path: Path) -> set[str]:
    """Return the names of all columns in the file at `path`, those that pandas takes as index too.

    Raises:
        DataCorruptError: it cannot be read.
    """
    return set(_footer(path).schema.names)


def metadata_of(path: Path) -> set[bytes]:
    """Return the names of what the file at `path` holds beside its columns.

    Raises:
        DataCorruptError: it cannot be read.
    """
    return set(_footer(path).metadata or {})


def _footer(path: Path) -> pq.FileMetaData:
    try:
        return pq.read_metadata(path)
    except (OSError, ValueError) as error:  # pyarrow's own errors are of these kinds
        raise DataCorruptError(f"{path} cannot be read: run the suite again.") from error


def _is_text(kind: pa.DataType) -> bool:
    known = (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary,
             pa.types.is_large_binary)  # fmt: skip
    return any(of(kind) for of in known)


def _length(column: pa.ChunkedArray) -> int:
    """Number of bytes that the texts of a column take when each is written out."""
    found = 0
    for chunk in column.chunks:
        if isinstance(chunk, pa.DictionaryArray):
            lengths = pc.binary_length(chunk.dictionary).cast(pa.int64())
            found += pc.sum(lengths.take(chunk.indices)).as_py() or 0
        else:
            found += chunk.nbytes
    return found


def wrong_kind(table: pd.DataFrame, texts: Iterable[str], numbers: Iterable[str]) -> str | None:
    """Return the first column that holds something else; None if all that are there are right."""
    for names, right in (
        (texts, pd.api.types.is_string_dtype),
        (numbers, pd.api.types.is_numeric_dtype),
    ):
        for name in names:
            if name in table and not (right(table[name]) or table[name].isna().all()):
                return name
    return None
