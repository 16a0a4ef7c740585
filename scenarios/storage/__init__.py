"""Files and folders: the cache, whole-file writes, arrays with a digest, limits for reading."""
