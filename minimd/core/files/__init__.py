"""Trajectories: H5MD in float64 with a restart, other formats by suffix, the file that a failed run leaves."""
