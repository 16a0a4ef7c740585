"""Wiring of a board: which electrodes each value of a frame was driven and measured with."""
