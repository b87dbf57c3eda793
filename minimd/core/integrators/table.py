"""The methods for atoms, by name."""

from minimd.core.integrators import hybrid_monte_carlo, respa, rows, thermostats
from minimd.core.integrators.method import methods_of

__all__ = ["SPLITTINGS", "THERMOSTATS"]

METHODS = methods_of(rows, thermostats, respa, hybrid_monte_carlo)
SPLITTINGS = {name: method for name, method in METHODS.items() if not method.is_thermostat}
THERMOSTATS = {name: method for name, method in METHODS.items() if method.is_thermostat}
