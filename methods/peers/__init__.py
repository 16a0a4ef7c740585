"""Reconstruction by other software, run through its own code: pyEIT, EIDORS in Octave."""

from eitbench.methods.peers.eidors import EidorsGreit, EidorsNoser, EidorsTvPdipm
from eitbench.methods.peers.peer import Peer
from eitbench.methods.peers.pyeit_methods import PyEitBp, PyEitGreit, PyEitJac

__all__ = [
    "EidorsGreit",
    "EidorsNoser",
    "EidorsTvPdipm",
    "Peer",
    "PyEitBp",
    "PyEitGreit",
    "PyEitJac",
]
