"""The methods for atoms, by name: all public classes of rows and thermostats that have an attribute `name`."""

from types import ModuleType
from typing import Any

from minimd.core.integrators import rows, thermostats

__all__ = ["SPLITTINGS", "THERMOSTATS"]


def methods_of(*modules: ModuleType) -> dict[str, Any]:
    """The methods that these modules define, in the order in which they stand there."""
    classes = [value for module in modules for name, value in vars(module).items() if name in module.__all__]
    return {method.name: method for method in classes if hasattr(method, "name")}


SPLITTINGS, THERMOSTATS = methods_of(rows), methods_of(thermostats)
METHODS = {**SPLITTINGS, **THERMOSTATS}
