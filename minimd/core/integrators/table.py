"""The methods for atoms, by name."""

from minimd.core.integrators import rows, thermostats
from minimd.core.integrators.method import methods_of

__all__ = ["SPLITTINGS", "THERMOSTATS"]

SPLITTINGS = methods_of(rows)
THERMOSTATS = methods_of(thermostats)
METHODS = {**SPLITTINGS, **THERMOSTATS}
