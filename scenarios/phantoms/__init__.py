"""Phantoms: their families, how they are drawn and rasterised, and contacts found in images."""

from eitbench.scenarios.phantoms.contacts import Contacts, locate
from eitbench.scenarios.phantoms.families import FAMILIES, Family, family
from eitbench.scenarios.phantoms.phantom import Phantom, draw, rasterise

__all__ = [
    "FAMILIES",
    "Contacts",
    "Family",
    "Phantom",
    "draw",
    "family",
    "locate",
    "rasterise",
]
