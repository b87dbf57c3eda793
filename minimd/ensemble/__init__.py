"""Many runs: members of an ensemble, made by any executor, each in a file of its own, with a table of their averages."""

from minimd.ensemble.member import Member
from minimd.ensemble.running import ensemble
from minimd.ensemble.table import EnsembleTable

__all__ = ["EnsembleTable", "Member", "ensemble"]
