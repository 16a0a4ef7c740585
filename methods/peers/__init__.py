"""Reconstruction by other software, run through its own code: pyEIT, EIDORS in Octave."""

from eitbench.methods.peers.peer import Peer

__all__ = ["Peer"]
