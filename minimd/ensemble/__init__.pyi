"""Many runs: the members of an ensemble are run by any executor, each with its own file;
a table holds their averages."""

from minimd.ensemble.exchange import exchange as exchange
from minimd.ensemble.ladder import Ladder as Ladder
from minimd.ensemble.member import Member as Member
from minimd.ensemble.running import ensemble as ensemble
from minimd.ensemble.table import EnsembleTable as EnsembleTable
