"""The commands of `eitbench`, by subject."""
