"""Run time beside other engines: the same scene, in turn, in one process."""

from minimd.bench.melt import run_melt

__all__ = ["run_melt"]
