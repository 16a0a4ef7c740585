"""Sensors: outline, electrodes, drive pattern, symmetries; sensors declared in files."""
