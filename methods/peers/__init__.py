"""Reconstruction by other software, run through its own code: pyEIT, EIDORS in Octave."""
