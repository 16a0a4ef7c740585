"""Protocols of boards, one a module."""

from eitbench.hardware.protocols.eit_kit import EitKit
from eitbench.hardware.protocols.openeit import OpenEit
from eitbench.hardware.protocols.protocol import Device, Protocol
from eitbench.hardware.protocols.sciospec import Sciospec
from eitbench.hardware.protocols.teensy import Teensy

PROTOCOLS: dict[str, type[Protocol]] = {
    protocol.name: protocol for protocol in (Teensy, EitKit, OpenEit, Sciospec)
}
"""Every protocol by name."""

__all__ = ["PROTOCOLS", "Device", "Protocol"]
