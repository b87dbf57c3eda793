"""Benchmarks: run time against error, against other engines, against what a scene holds and how large it is."""
