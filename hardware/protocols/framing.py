"""Finding frames in a stream of bytes that may hold anything else."""

import re
from collections.abc import Callable

FrameMatcher = Callable[[bytearray, int], int | None]
"""Length of the frame at a place in the buffer; 0 if there is none, None if more bytes decide."""

_CHUNK = 1 << 16  # a large feed costs no more than many small ones


class Scanner:
    """A scanner that cuts frames out of a stream; a false start hides no frame behind it.

    A frame may begin wherever `start` matches (at most 4 bytes), and `match` decides whether it
    does. The longest frame bounds the size of the buffer. While a place is undecided, later places
    are tried nevertheless, so that neither a frame that was cut short nor a false length makes a
    good frame wait. Behind a place without a frame the search goes on one byte further, never
    behind the length that was claimed there.

    Attributes:
        skipped: bytes so far that belong to no frame.
        false_starts: places so far that looked like the start of a frame and were none.
    """

    def __init__(self, start: re.Pattern[bytes], match: FrameMatcher) -> None:
        self._start = start
        self._match = match
        self._buffer = bytearray()
        self.skipped = 0
        self.false_starts = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that `data` completes."""
        frames = []
        for begin in range(0, len(data), _CHUNK):
            self._buffer += data[begin : begin + _CHUNK]
            frames += self._scan()
        return frames

    def _scan(self) -> list[bytes]:
        buffer, frames = self._buffer, []
        settled = at = 0
        undecided: int | None = None
        while found := self._start.search(buffer, at):
            at = found.start()
            length = self._match(buffer, at)
            if length is None and undecided is None:
                undecided = at
            if not length:
                at += 1
                continue
            self._skip(settled, at)
            frames.append(bytes(memoryview(buffer)[at : at + length]))
            settled = at = at + length
            undecided = None
        if undecided is None:
            # A frame may begin in the last bytes without being seen yet.
            undecided = max(settled, len(buffer) - 3)
        self._skip(settled, undecided)
        del buffer[:undecided]
        return frames

    def _skip(self, begin: int, end: int) -> None:
        self.skipped += end - begin
        if end > begin:
            self.false_starts += len(self._start.findall(self._buffer, begin, end))
