"""Other people's reconstruction software, run through its own code: pyEIT, EIDORS in Octave."""
