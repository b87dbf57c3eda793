"""Benchmarks: run time against error, compared with other engines,
and as a function of ingredients and size of a scene."""
