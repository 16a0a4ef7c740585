"""Public recorded sets: a descriptor and a reader each; `potentials` is shared by two."""
