"""The HDF5 log: its layout, writing it while running, reading it back."""
