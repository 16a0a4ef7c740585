"""Differences between a real sensor and its nominal model: noise, imperfections, calibration."""

from eitbench.scenarios.imperfections.imperfections import TYPICAL, Imperfections
from eitbench.scenarios.imperfections.noise import Noise, add_noise

__all__ = ["TYPICAL", "Imperfections", "Noise", "add_noise"]
