"""RecordedFrames frames into files: free, guided, exported, imported."""
