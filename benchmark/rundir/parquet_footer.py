"""What a Parquet file claims of its size and codecs, read before Arrow reads the file.

Asked for the columns of a damaged file, pyarrow ends the process ("terminate called
after throwing an instance of 'parquet::ParquetException'"), and Arrow's reader decompresses
whatever is claimed. So the codecs are read here from the footer itself, and the sizes from the
headers of the pages, by which Arrow allots its memory.

Source: https://parquet.apache.org/docs/file-format/metadata/; Apache Thrift, compact protocol.
"""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import Any, BinaryIO

_MAGIC = b"PAR1"
_CODECS = ("UNCOMPRESSED", "SNAPPY", "GZIP", "LZO", "BROTLI", "LZ4", "ZSTD", "LZ4_RAW")
_DEEPEST = 16
# Numbers of the fields in Parquet's FileMetaData, RowGroup and ColumnChunk,
_ROW_GROUPS, _COLUMNS, _META_DATA = 4, 1, 3
# in ColumnMetaData,
_CODEC, _VALUES, _CHUNK_BYTES, _DATA_PAGES, _DICTIONARY_PAGE = 4, 5, 7, 9, 11
# and in PageHeader.
_UNPACKED, _PACKED = 2, 3
# Types of Thrift's compact protocol.
_STOP, _TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _STRUCT = 0, 1, 2, 3, 7, 8, 12
_INTEGERS, _LISTS = (4, 5, 6), (9, 10)


def codecs(path: Path) -> set[str]:
    """Return the names of the codecs of the columns of the Parquet file at `path`.

    Raises:
        ValueError: its footer is damaged.
    """
    with path.open("rb") as file, _damage():
        return {_CODECS[chunk[_CODEC]] for chunk in _chunks(file)}


def unpacked_bytes(path: Path) -> int:
    """Return the bytes that all pages of the Parquet file at `path` claim to take, unpacked.

    Raises:
        ValueError: its footer, or the header of a page, is damaged.
    """
    claimed = 0
    with path.open("rb") as file, _damage():
        for chunk in _chunks(file):
            if chunk[_VALUES] == 0:  # there Arrow reads no page, and writes none of data
                continue
            place = min(chunk[_DATA_PAGES], chunk.get(_DICTIONARY_PAGE) or chunk[_DATA_PAGES])
            end = place + chunk[_CHUNK_BYTES]
            while place < end:
                file.seek(place)
                header = _structure(file, 0)
                # What is negative would make room for what is not.
                if min(header[_PACKED], header[_UNPACKED]) < 0:
                    raise IndexError
                claimed += header[_UNPACKED]
                place = file.tell() + header[_PACKED]
    return claimed


@contextmanager
def _damage() -> Iterator[None]:
    try:
        yield
    except (IndexError, KeyError, OSError, OverflowError, TypeError) as error:
        raise ValueError("its footer, or the header of a page, is damaged") from error


def _chunks(file: BinaryIO) -> list[dict[int, Any]]:
    """Return the ColumnMetaData of all columns of all groups of rows."""
    size = file.seek(0, SEEK_END)
    file.seek(max(size - 8, 0))
    end = file.read()
    if size < 12 or end[-4:] != _MAGIC:
        raise ValueError("it does not end as a Parquet file does")
    (length,) = struct.unpack("<I", end[:4])
    if length > size - 12:
        raise ValueError("its footer is longer than the file")
    file.seek(size - 8 - length)
    groups = _structure(BytesIO(file.read(length)), 0)[_ROW_GROUPS]
    return [chunk[_META_DATA] for group in groups for chunk in group[_COLUMNS]]


# Each function reads a value of Thrift's compact protocol; IndexError where the content ends early.


def _structure(content: BinaryIO, depth: int) -> dict[int, Any]:
    """Fields of a structure by their numbers."""
    fields: dict[int, Any] = {}
    number = 0
    while (head := _take(content, 1)[0]) != _STOP:
        number = number + (head >> 4) if head >> 4 else _integer(content)
        kind = head & 0x0F
        flag = kind in (_TRUE, _FALSE)  # whose kind is its value
        fields[number] = kind == _TRUE if flag else _value(content, kind, depth)
    return fields


def _value(content: BinaryIO, kind: int, depth: int) -> Any:
    if depth > _DEEPEST:
        raise IndexError
    if kind in _INTEGERS:
        return _integer(content)
    if kind == _BINARY:
        return _take(content, _unsigned(content))
    if kind in _LISTS:
        head = _take(content, 1)[0]
        count = head >> 4 if head >> 4 != 15 else _unsigned(content)
        # Each takes a byte at least: a count beyond that ends with the content.
        return [_value(content, head & 0x0F, depth + 1) for _ in range(count)]
    if kind == _STRUCT:
        return _structure(content, depth + 1)
    if kind in (_TRUE, _FALSE, _BYTE):  # an element of a list takes a byte
        return _take(content, 1)
    if kind == _DOUBLE:
        return _take(content, 8)
    raise IndexError  # maps are not part of Parquet's metadata


def _integer(content: BinaryIO) -> int:
    folded = _unsigned(content)
    return folded >> 1 ^ -(folded & 1)


def _unsigned(content: BinaryIO) -> int:
    number = shift = 0
    while shift <= 63:
        byte = _take(content, 1)[0]
        number |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return number
    raise IndexError


def _take(content: BinaryIO, count: int) -> bytes:
    taken = content.read(count)
    if len(taken) < count:
        raise IndexError
    return taken
