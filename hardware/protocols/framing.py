"""Finding frames in a stream of bytes that may hold anything else."""

import re
from collections.abc import Callable

Judge = Callable[[bytearray, int], int | None]

_PIECE = 1 << 16  # a large feed costs no more than many small ones


class Scanner:
    """Cuts frames out of a stream; what only looks like a frame hides none that follows.

    A frame may begin wherever `start` matches (at most 4 bytes). `judge(buffer, at)` gives the
    length of what is there, 0 if it is no frame, or None if more bytes must decide; what it waits
    for bounds what is kept. While a place is undecided, later ones are judged nevertheless, so that
    the beginning of a frame that was cut short, or a length that lies, never makes a good frame
    wait. Behind a place that is no frame the search goes on one byte further, never behind the
    length that was claimed there.

    Attributes:
        skipped: bytes so far that belong to no frame.
        false_starts: places so far where a frame began that was none.
    """

    def __init__(self, start: re.Pattern[bytes], judge: Judge) -> None:
        self._start = start
        self._judge = judge
        self._buffer = bytearray()
        self.skipped = 0
        self.false_starts = 0

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that `data` completes."""
        frames = []
        for begin in range(0, len(data), _PIECE):
            self._buffer += data[begin : begin + _PIECE]
            frames += self._scan()
        return frames

    def _scan(self) -> list[bytes]:
        buffer, frames = self._buffer, []
        settled = at = 0
        undecided: int | None = None
        while found := self._start.search(buffer, at):
            at = found.start()
            length = self._judge(buffer, at)
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
