"""Boards on a serial port: the port, the board on it, and what is wrong with it."""

from eitbench.hardware.serial.serial_board import SERIAL_BOARDS, SerialBoard

__all__ = ["SERIAL_BOARDS", "SerialBoard"]
