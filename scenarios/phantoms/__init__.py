"""Phantoms: their families, how they are drawn and rasterised, and contacts found in images."""
