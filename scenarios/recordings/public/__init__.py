"""Public recorded sets: descriptors and readers, a module for each source."""
