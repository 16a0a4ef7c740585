"""Numbers and text of MATLAB files of version 5 to 7, read without trusting their claims.

SciPy's reader takes types and sizes of a damaged file on trust: it can crash the process, and
unpacks whatever a few bytes claim. A process of its own with a limit of memory would need more code
than this, and there is no such limit on all systems.
Source: MATLAB, MAT-File Format, R2024a, "Level 5 MAT-Files".
"""

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, UnreadableError
from eitbench.scenarios.storage.limits import most_bytes

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
            13: "u8"}  # fmt: skip
_TEXTS = {1: "ascii", 2: "ascii", 4: "utf-16-le", 16: "utf-8", 17: "utf-16-le", 18: "utf-32-le"}
_CHAR, _COMPLEX = 4, 0x800
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8",
            15: "u8"}  # fmt: skip

Variable = NDArray[Any] | str


def variables(path: Path, names: Collection[str] | None = None) -> dict[str, Variable]:
    """Read the variables of the file at `path` that are arrays of numbers or text.

    Args:
        path: of the file.
        names: of those to be read; by default all.

    Raises:
        UnreadableError, DataCorruptError: as for `all_variables`.
    """
    found = all_variables(path, names)
    return {name: value for name, value in found.items() if value is not None}


def all_variables(path: Path, names: Collection[str] | None = None) -> dict[str, Variable | None]:
    """As `variables`, with None for structs, cell arrays and all else that is not read.

    Raises:
        UnreadableError: the file cannot be read.
        DataCorruptError: it is damaged, or of another kind.
    """
    try:
        return _variables(path, names)
    except OSError as error:
        raise UnreadableError(f"Cannot read {path}: {error.strerror}.") from error
    except Exception as error:
        raise DataCorruptError(
            f"{path} is not a readable MATLAB file ({error}): save it with -v7, or again."
        ) from error


def read_arrays(path: Path, *names: str) -> dict[str, NDArray[np.float64]]:
    """Read the numeric arrays `names` of the MATLAB file at `path` of a public set."""
    found = variables(path, names)
    return {name: np.asarray(found[name], dtype=np.float64) for name in names}


def _variables(path: Path, names: Collection[str] | None) -> dict[str, Variable | None]:
    content = path.read_bytes()
    if content[124:_HEADER] != b"\x00\x01IM":  # little-endian, as every MATLAB of today writes
        raise ValueError("it is not of version 5 to 7")
    found: dict[str, Variable | None] = {}
    place = _HEADER
    while place < len(content):
        kind, size = struct.unpack_from("<II", content, place)
        place += 8
        data = content[place : place + size]
        if len(data) < size:
            raise ValueError("it was cut short")
        place += size
        if kind == _COMPRESSED:
            kind, data = next(_elements(_unpacked(data, most_bytes(path))))
        if kind == _MATRIX and data:
            name, value = _variable(data)
            if names is None or name in names:
                found[name] = value
    return found


def _unpacked(data: bytes, most: int) -> bytes:
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(data, most)
    if not unpacker.eof:
        raise ValueError("a variable was cut short or is much larger than the file")
    return content


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of the elements that follow each other in `data`."""
    place = 0
    while place < len(data):
        (word,) = struct.unpack_from("<I", data, place)
        if word >> 16:  # up to four bytes stand in the tag itself
            kind, size, place = word & 0xFFFF, word >> 16, place + 4
            after = place + 4
        else:
            kind, (size,), place = word, struct.unpack_from("<I", data, place + 4), place + 8
            after = place + size + -size % 8
        if place + size > min(after, len(data)):
            raise ValueError("an element is longer than what holds it")
        yield kind, data[place : place + size]
        place = after


def _variable(data: bytes) -> tuple[str, Variable | None]:
    """Name and value of a matrix; None for one that is neither numbers nor text."""
    elements = _elements(data)
    (_, flags), (_, shape), (_, name) = next(elements), next(elements), next(elements)
    (kind,) = struct.unpack_from("<I", flags)
    called = name.decode("ascii")
    if kind & 0xFF != _CHAR and kind & 0xFF not in _CLASSES:
        return called, None
    stored, values = next(elements, (1, b""))
    sizes = np.frombuffer(shape, "<i4").tolist()
    if kind & 0xFF == _CHAR:
        return called, text_lines(values.decode(_TEXTS[stored]), sizes)
    array = _array(stored, values, sizes, _CLASSES[kind & 0xFF])
    if kind & _COMPLEX:
        return called, array + 1j * _array(*next(elements), sizes, _CLASSES[kind & 0xFF])
    return called, array


def text_lines(text: str, sizes: list[int]) -> Variable | None:
    """A text, or the lines (n,) of a matrix of characters; None where these are not told apart."""
    if len(sizes) != 2 or sizes[0] < 2:
        return text
    if sizes[0] * sizes[1] != len(text):
        return None
    return np.array([text[k :: sizes[0]].rstrip() for k in range(sizes[0])], dtype=np.str_)


def _array(stored: int, values: bytes, sizes: list[int], kind: str) -> NDArray[Any]:
    array = np.frombuffer(values, f"<{_NUMBERS[stored]}")
    if min(sizes, default=-1) < 0 or math.prod(sizes) != array.size:
        raise ValueError("an array has not as many values as it claims")
    return array.astype(kind).reshape(sizes, order="F")
