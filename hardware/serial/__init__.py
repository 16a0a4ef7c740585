"""Boards on a serial port: the port, the board on it, and what is wrong with it."""
