"""HDF5 files that were not closed, read as if they had been.

A file whose writer was killed says in its superblock that it is still written to. HDF5 then opens
it only as a reader beside the writer, who waits for what looks damaged to be put right: in a file
that is damaged, for ever. So such a file is read from memory, with the superblock its writer would
have left.
(HDF5 File Format Specification, version 3, section II.A: superblock version 3.)
"""

import io
from pathlib import Path

_FLAGS, _END, _CHECKSUM = 11, slice(28, 36), slice(44, 48)
_VERSION, _OPEN = 8, 0b101  # being written to, by one writer beside readers


def readable(path: Path) -> Path | io.BytesIO:
    """`path`, or the content of the file there where it was not closed.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_CHECKSUM.stop)
        if len(head) < _CHECKSUM.stop or head[_VERSION] != 3 or not head[_FLAGS] & _OPEN:
            return path
        content = bytearray(head + file.read())
    content[_FLAGS] = 0
    # What was written is as much as there is; the writer would have noted that when it closes.
    content[_END] = len(content).to_bytes(8, "little")
    content[_CHECKSUM] = _lookup3(bytes(content[: _CHECKSUM.start])).to_bytes(4, "little")
    return io.BytesIO(content)


def _lookup3(data: bytes) -> int:
    """Jenkins' hash `hashlittle` of `data` (not empty), with which HDF5 guards its metadata.

    Source: B. Jenkins, lookup3.c, public domain, 2006.
    """
    mask = 0xFFFFFFFF

    def rotated(x: int, k: int) -> int:
        return (x << k | x >> (32 - k)) & mask

    a = b = c = (0xDEADBEEF + len(data)) & mask
    blocks = [data[k : k + 12] for k in range(0, len(data), 12)]
    for block in blocks:
        whole = block.ljust(12, b"\0")
        a = (a + int.from_bytes(whole[:4], "little")) & mask
        b = (b + int.from_bytes(whole[4:8], "little")) & mask
        c = (c + int.from_bytes(whole[8:], "little")) & mask
        if block is blocks[-1]:
            break
        for k in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & mask) ^ rotated(c, k)
            c = (c + b) & mask
            a, b, c = b, c, a
    for k in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - rotated(b, k)) & mask
        a, b, c = b, c, a
    # The rounds leave the last result, c, as b.
    return b
