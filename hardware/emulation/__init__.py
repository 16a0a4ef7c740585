"""Boards without hardware: an emulated sensor, a replayed recording."""

from eitbench.hardware.emulation.emulator import Emulator
from eitbench.hardware.emulation.replay import Replay

__all__ = ["Emulator", "Replay"]
