"""The run directory: plan, manifest, locked store of rows and arrays."""
