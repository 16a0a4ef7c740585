"""Files of own recordings: the HDF5 layout, CSV and MATLAB forms."""
