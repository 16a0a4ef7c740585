"""Differences between a real sensor and its nominal model: noise, imperfections, calibration."""
