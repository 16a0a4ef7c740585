"""Sensors: outlines, electrodes, drive patterns, sensor files."""
