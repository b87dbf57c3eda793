"""Run time beside other engines: the same scene, in turn, in one process."""

from minimd.bench.lj import Options, run_lj

__all__ = ["Options", "run_lj"]
