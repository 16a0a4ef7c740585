"""What a Parquet file says of itself, before Arrow is trusted with it.

Asked for the columns of a damaged file, pyarrow ends the process ("terminate called
after throwing an instance of 'parquet::ParquetException'"), and Arrow's reader decompresses
whatever is claimed. So the codecs are read here, from the footer itself.

Source: https://parquet.apache.org/docs/file-format/metadata/; Apache Thrift, compact protocol.
"""

import struct
from pathlib import Path
from typing import Any

_MAGIC = b"PAR1"
_CODECS = ("UNCOMPRESSED", "SNAPPY", "GZIP", "LZO", "BROTLI", "LZ4", "ZSTD", "LZ4_RAW")
_DEEPEST = 16
# Where the numbers of the fields are those of Parquet's FileMetaData, RowGroup, ColumnChunk and
# ColumnMetaData.
_ROW_GROUPS, _COLUMNS, _META_DATA, _CODEC = 4, 1, 3, 4
# Types of Thrift's compact protocol.
_STOP, _TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _STRUCT = 0, 1, 2, 3, 7, 8, 12
_INTEGERS, _LISTS = (4, 5, 6), (9, 10)


def codecs(path: Path) -> set[str]:
    """How the columns of the Parquet file at `path` are compressed.

    Raises:
        ValueError: its footer is damaged.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - 8, 0))
        end = file.read()
        if size < 12 or end[-4:] != _MAGIC:
            raise ValueError("it does not end as a Parquet file does")
        (length,) = struct.unpack("<I", end[:4])
        if length > size - 12:
            raise ValueError("its footer is longer than the file")
        file.seek(size - 8 - length)
        footer = file.read(length)
    try:
        groups = _Reader(footer).structure()[_ROW_GROUPS]
        chunks = [chunk for group in groups for chunk in group[_COLUMNS]]
        return {_CODECS[_natural(chunk[_META_DATA][_CODEC])] for chunk in chunks}
    except (IndexError, KeyError, TypeError) as error:
        raise ValueError("its footer is damaged") from error


def _natural(number: int) -> int:
    if number < 0:
        raise IndexError
    return number


class _Reader:
    """Values of Thrift's compact protocol, one after another; IndexError where they end early."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._at = 0

    def structure(self, depth: int = 0) -> dict[int, Any]:
        """The fields of a structure by their numbers."""
        if depth > _DEEPEST:
            raise IndexError
        fields: dict[int, Any] = {}
        number = 0
        while (head := self._byte()) != _STOP:
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 0x0F
            fields[number] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in _INTEGERS:
            return self._integer()
        if kind == _BINARY:
            return self._bytes(self._unsigned())
        if kind in _LISTS:
            return self._list(depth + 1)
        if kind == _STRUCT:
            return self.structure(depth + 1)
        if kind in (_TRUE, _FALSE, _BYTE):  # an element of a list takes a byte
            return self._byte()
        if kind == _DOUBLE:
            return self._bytes(8)
        raise IndexError  # maps are not part of Parquet's metadata

    def _list(self, depth: int) -> list[Any]:
        if depth > _DEEPEST:
            raise IndexError
        head = self._byte()
        count = head >> 4 if head >> 4 != 15 else self._unsigned()
        # Each takes a byte at least: a count beyond that ends with the content.
        return [self._value(head & 0x0F, depth) for _ in range(count)]

    def _integer(self) -> int:
        folded = self._unsigned()
        return folded >> 1 ^ -(folded & 1)

    def _unsigned(self) -> int:
        number = shift = 0
        while True:
            byte = self._byte()
            number |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return number
            if shift > 63:
                raise IndexError

    def _byte(self) -> int:
        byte = self._content[self._at]
        self._at += 1
        return byte

    def _bytes(self, count: int) -> bytes:
        if count > len(self._content) - self._at:
            raise IndexError
        self._at += count
        return self._content[self._at - count : self._at]
