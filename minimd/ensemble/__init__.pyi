"""Many runs: the members of an ensemble are run by any executor, each with its own file;
a table holds their averages."""

from minimd.ensemble.member import Member as Member
from minimd.ensemble.running import ensemble as ensemble
from minimd.ensemble.table import EnsembleTable as EnsembleTable
