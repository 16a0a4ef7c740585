"""RecordedFrames files: the HDF5 layout, CSV and MATLAB forms."""
