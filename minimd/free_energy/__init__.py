"""Free energies of finished runs, with error bars: of the work of pulling, and of umbrella windows."""

from minimd.free_energy.difference import FreeEnergyDifference, bar, jarzynski
from minimd.free_energy.profile import FreeEnergyProfile, umbrella

__all__ = ["FreeEnergyDifference", "FreeEnergyProfile", "bar", "jarzynski", "umbrella"]
