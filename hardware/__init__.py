"""Boards that measure frames, on a serial port or emulated; recording them, and a live view."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
    from eitbench.hardware.registry import boards, make_board

__all__ = ["Board", "BoardError", "BoardLostError", "Frame", "boards", "make_board"]

__getattr__, __dir__ = lazy_names(
    __name__,
    dict.fromkeys(__all__, "board") | dict.fromkeys(("boards", "make_board"), "registry"),
)
