"""Valid files, spoilt: what accident or malice may hand to a reader. All draws come from a seed."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from random import Random
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io

from eitbench.scenarios.recordings.files.recording_file import _lookup3

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1,
           2**64 - 1)  # fmt: skip
"""Lengths and counts that make a careless reader overflow or ask for too much memory."""

WORDS = (
    "", "0", "-1", "1e999", "-0.0", "nan", "inf", "NaN", "Infinity", "null", "true", "[]", "{}",
    '""', "1" * 400, "1" * 5000, "0x7fffffffffffffff", "99999999999999999999", "1979-05-27", "'",
    '"', "\\", "[" * 1500, '{"a":' * 1500, "[[", "]]", "a.b.c", "../../etc/passwd", "\u202e",
    "\ufeff", "\0", ",", "x" * 3000, "<script>", "=", "1_000", "1e-320",
)  # fmt: skip
"""Pieces of text that parsers trip over."""

Mutation = Callable[[Random, bytes], bytes]


def bytes_of(draws: Random, data: bytes, reach: int | None = None) -> bytes:
    """Bits flipped, bytes and length fields set, blocks cut out, repeated, moved or cut off.

    Most changes are at the first or last `reach` bytes, where files keep what steers a reader.
    """
    out = bytearray(data)
    for _ in range(draws.choice((1, 1, 1, 2, 4, 16))):
        if not out:
            break
        near = min(len(out), draws.choice((64, 512, reach or len(out), len(out))))
        place = draws.randrange(near)
        if draws.random() < 0.4:
            place = len(out) - 1 - place
        kind = draws.randrange(8)
        size = draws.choice((1, 2, 4, 8, 64, 700))
        if kind == 0:
            out[place] ^= 1 << draws.randrange(8)
        elif kind == 1:
            out[place] = draws.randrange(256)
        elif kind in (2, 3):
            width = draws.choice((1, 2, 4, 8))
            order: Any = draws.choice(("little", "little", "big"))
            old = int.from_bytes(out[place : place + width], order)
            new = draws.choice((*NUMBERS, old + 1, old - 1, old * 2, old * 1000))
            out[place : place + width] = (new % 256**width).to_bytes(width, order)
        elif kind == 4:
            del out[place : place + size]
        elif kind == 5:
            out[place:place] = out[place : place + size] * draws.choice((1, 2, 50))
        elif kind == 6:
            start = draws.randrange(len(out))
            out[place : place + size] = out[start : start + size]
        elif draws.random() < 0.3:
            del out[place:]
    return bytes(out)


def text(draws: Random, data: bytes) -> bytes:
    """Tokens replaced, lines dropped, repeated, swapped or cut; now and then single bytes."""
    if draws.random() < 0.15:
        return bytes_of(draws, data)
    content = data.decode()
    for _ in range(draws.choice((1, 1, 2, 5))):
        tokens = re.findall(r"\w+|\s+|[^\w\s]", content)
        lines = content.splitlines(keepends=True)
        if not tokens or not lines:
            break
        k, kind = draws.randrange(len(tokens)), draws.randrange(7)
        if kind <= 2:
            other = draws.choice(tokens) if kind == 0 else draws.choice(WORDS)
            content = "".join((*tokens[:k], other, *tokens[k + 1 :]))
        elif kind == 3:
            del tokens[k : k + draws.choice((1, 3, 20))]
            content = "".join(tokens)
        else:
            i, j = draws.randrange(len(lines)), draws.randrange(len(lines))
            if kind == 4:
                del lines[i]
            elif kind == 5:
                lines[i:i] = [lines[j]] * draws.choice((1, 2, 30))
            else:
                lines[i], lines[j] = lines[j], lines[i]
            content = "".join(lines)
    return content.encode("utf-8", "replace")


def json_text(draws: Random, data: bytes) -> bytes:
    """Values of a JSON document replaced, removed or doubled; or its text spoilt."""
    if draws.random() < 0.3:
        return text(draws, data)
    content = json.loads(data)
    for _ in range(draws.choice((1, 1, 2, 4))):
        content = _replaced(draws, content)
    return json.dumps(content).encode()


def _replaced(draws: Random, value: Any) -> Any:
    """`value` with one thing inside it changed."""
    if isinstance(value, dict | list) and value and draws.random() < 0.9:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = draws.choice(keys)
        if draws.random() < 0.1:
            del value[key]
        elif isinstance(value, list) and draws.random() < 0.1:
            value.append(value[key])
        else:
            value[key] = _replaced(draws, value[key])
        return value
    return draws.choice(
        (
            None,
            True,
            0,
            -1,
            1.5,
            10**30,
            1e308,
            float("nan"),
            float("inf"),
            "",
            "x",
            "../..",
            "\0",
            "[" * 2000,
            [],
            {},
            [[]],
            {"a": 1},
            [1, 2, 3],
            [None] * 50,
            "é" * 200,
        )
    )


def npz(draws: Random, data: bytes) -> bytes:
    """An archive of arrays: its bytes, the headers of its arrays, what its directory says."""
    kind = draws.randrange(4)
    if kind == 0:
        return bytes_of(draws, data, 600)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = draws.choice(list(members))
    if kind == 1:
        members[name] = bytes_of(draws, members[name], 128)
    elif kind == 2:
        head = text(draws, members[name][10:128].replace(b"\0", b" "))
        members[name] = members[name][:8] + struct.pack("<H", len(head) % 65536) + head
        members[name] += draws.randbytes(64)
    elif draws.random() < 0.5:
        members[draws.choice((name, "../../up.npy", "/up.npy", "new.npy", "."))] = members.pop(name)
    else:
        members[name] = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': ("
        members[name] += b"400000,), }".ljust(71) + bytes(3_200_000)
    out = io.BytesIO()
    way = draws.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(out, "w", way) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    whole = out.getvalue()
    return bytes_of(draws, whole, 80) if draws.random() < 0.2 else whole


def hdf5(draws: Random, data: bytes) -> bytes:
    """Its bytes, with or without the checksums put right, or its groups, datasets, attributes."""
    kind = draws.randrange(3)
    if kind == 2:
        return _other_parts(draws, data)
    spoilt = bytearray(bytes_of(draws, data, 4000))
    if kind == 1:
        headers = [match.start() for match in re.finditer(b"OHDR", data)]
        for _ in range(draws.choice((1, 1, 3))):
            if headers:
                place = draws.choice(headers) + draws.randrange(6, 200)
                if place < len(spoilt):
                    spoilt[place] = draws.choice((0, 1, 0xFF, draws.randrange(256)))
        _seal(spoilt)
    return bytes(spoilt)


def _seal(data: bytearray) -> None:
    """Put the checksums of superblock and object headers right (HDF5 specification, IV.A.1.b)."""
    if len(data) >= 48 and data[8] in (2, 3):
        data[44:48] = _lookup3(bytes(data[:44])).to_bytes(4, "little")
    for found in re.finditer(b"OHDR", bytes(data)):
        start = found.start()
        if start + 6 > len(data):
            continue
        flags = data[start + 5]
        place = start + 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0)
        width = 1 << (flags & 3)
        end = place + width + int.from_bytes(data[place : place + width], "little")
        if end + 4 <= len(data) and end - start < 5000:
            data[end : end + 4] = _lookup3(bytes(data[start:end])).to_bytes(4, "little")


def _other_parts(draws: Random, data: bytes) -> bytes:
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        for _ in range(draws.choice((1, 1, 2))):
            # What the first change has left may not bear a second one.
            with suppress(KeyError, TypeError, ValueError, RuntimeError, OSError):
                _other_part(draws, file, draws.choice(names))
    return buffer.getvalue()


def _other_part(draws: Random, file: h5py.File, name: str) -> None:
    owner = file if draws.random() < 0.5 or name not in file else file[name]
    if draws.random() < 0.3 and len(owner.attrs):
        owner.attrs[draws.choice(list(owner.attrs))] = draws.choice(
            (
                -1,
                1e308,
                float("nan"),
                "x" * 500,
                b"\xff\xfe",
                [1, 2, 3],
                [b"a"],
                np.zeros((3, 3)),
                h5py.Empty("f8"),
            )
        )
        return
    old = file.get(name)
    if old is not None:
        del file[name]
    shape = old.shape if isinstance(old, h5py.Dataset) else (4,)
    kinds: Any = (
        lambda: None,
        lambda: file.create_dataset(name, shape, draws.choice(("i1", "<f4", ">f8", "c16", "S3"))),
        lambda: file.create_dataset(
            name, data=draws.choice((0, -1.0, b"", "x", [[1.0]], [np.nan]))
        ),
        lambda: file.create_dataset(name, (10**12, *shape[1:]), "<f8", chunks=True),
        lambda: file.create_dataset(name, (3 * 10**7,), "<f8", chunks=True, fillvalue=1.0),
        lambda: file.create_dataset(name, (0, 0), "<f8"),
        lambda: file.create_dataset(name, shape, "<f8", external=[("/etc/passwd", 0, 2**20)]),
        lambda: file.create_dataset(name, data=["text", "more"], dtype=h5py.string_dtype()),
        lambda: file.create_dataset(name, shape, h5py.vlen_dtype("i4")),
        lambda: file.create_dataset(name, shape, h5py.ref_dtype),
        lambda: file.create_dataset(name, data=h5py.Empty("f8")),
        lambda: file.create_group(name),
        lambda: file.__setitem__(name, h5py.SoftLink("/" + name)),
        lambda: file.__setitem__(name, h5py.ExternalLink("/etc/passwd", "/x")),
        lambda: file.__setitem__(name, np.dtype("f8")),
        lambda: file.create_dataset(
            name, data=np.zeros((400_000, *[1] * (len(shape) - 1))), compression="gzip"
        ),
        lambda: file.create_virtual_dataset(name, h5py.VirtualLayout((10**7,), "<f8")),
    )
    draws.choice(kinds)()


def parquet(draws: Random, data: bytes) -> bytes:
    """Its bytes, above all those of its footer, or its columns."""
    if draws.random() < 0.6:
        return bytes_of(draws, data, 3000)
    table = pd.read_parquet(io.BytesIO(data))
    for _ in range(draws.choice((1, 1, 2))):
        name = draws.choice(list(table.columns))
        kind = draws.randrange(8)
        if kind == 0:
            table = table.drop(columns=name)
        elif kind == 1:
            table[name] = [draws.choice(WORDS) for _ in range(len(table))]
        elif kind == 2:
            table[name] = draws.choice((None, -1, 1e308, float("nan"), True, 2**62, b"x"))
        elif kind == 3:
            table[name] = [[1, 2]] * len(table)
        elif kind == 4:
            table = table.iloc[
                draws.choice((slice(0), slice(1), slice(None, None, -1), slice(1, 3)))
            ]
        elif kind == 5:
            table = pd.concat([table] * draws.choice((2, 5)))
        elif kind == 6:
            table[name] = table[draws.choice(list(table.columns))].to_numpy()
        else:
            table[name] = pd.Timestamp("2026-01-01")
        if not len(table.columns):
            break
    out = io.BytesIO()
    table.to_parquet(out, index=draws.random() < 0.1)
    return out.getvalue()


def safetensors(draws: Random, data: bytes) -> bytes:
    """Its bytes, or its header with a length that is right."""
    if draws.random() < 0.4:
        return bytes_of(draws, data, 900)
    size = int.from_bytes(data[:8], "little")
    head = json_text(draws, data[8 : 8 + size])
    return len(head).to_bytes(8, "little") + head + data[8 + size :]


def mat(draws: Random, data: bytes) -> bytes:
    """Its bytes, or those of a variable before it is compressed."""
    if draws.random() < 0.4:
        return bytes_of(draws, data, 300)
    out, place = [data[:128]], 128
    elements = []
    while place + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, place)
        elements.append((kind, data[place + 8 : place + 8 + size]))
        place += 8 + size
    target = draws.randrange(len(elements))
    for k, (kind, content) in enumerate(elements):
        if k == target:
            plain = zlib.decompress(content) if kind == 15 else content
            plain = bytes_of(draws, plain, 120)
            if draws.random() < 0.1:
                plain = _zeros_of_mat()
            content = zlib.compress(plain)
        out += [struct.pack("<II", 15, len(content)), content]
    return b"".join(out)


def _zeros_of_mat() -> bytes:
    """The variable `values` with 400 000 zeros, which compress to almost nothing."""
    buffer: Any = io.BytesIO()
    scipy.io.savemat(buffer, {"values": np.zeros((1000, 400))})
    content: bytes = buffer.getvalue()
    return content[128:]


def pick(draws: Random, originals: Sequence[bytes], mutation: Mutation) -> bytes:
    """One of the `originals`, spoilt; now and then spliced with another."""
    data = draws.choice(originals)
    if len(originals) > 1 and draws.random() < 0.05:
        other = draws.choice(originals)
        return data[: draws.randrange(len(data))] + other[draws.randrange(len(other)) :]
    return mutation(draws, data)
