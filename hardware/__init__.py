"""Boards that measure frames, on a serial port or emulated; recording them, and a live view."""
