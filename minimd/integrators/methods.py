"""The tables of methods, by name: all public classes of the integrator modules that have an attribute `name`."""

from types import ModuleType
from typing import Any

from minimd.console.display import Displayed, Rows
from minimd.integrators.method import Method
from minimd.integrators.ode import bdf, runge_kutta
from minimd.integrators.splitting import rows, thermostats

__all__ = ["METHODS", "SPLITTINGS", "THERMOSTATS"]


class MethodTable(Displayed, dict[str, type[Method]]):
    """Methods by name, displayed as a table of their properties."""

    def display_rows(self) -> Rows:
        """See Displayed."""
        kinds = "class", "order", "stages", "symmetric", "symplectic", "explicit", "source"
        rows: list[tuple[str, ...]] = [("name", *kinds)]
        for method in self.values():
            answers = (method.is_symmetric, method.is_symplectic, method.is_explicit)
            known = ("yes" if answer else "no" for answer in answers)
            rows.append((method.name, method.__name__, str(method.order), str(method.stages), *known, method.source))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [(row[0], "  ".join(map(str.ljust, row[1:], widths[1:])).rstrip()) for row in rows]

    def __repr__(self) -> str:
        return str(self)


def _methods_of(*modules: ModuleType) -> dict[str, Any]:
    """The methods that these modules define, in the order in which they stand there."""
    classes = [value for module in modules for name, value in vars(module).items() if name in module.__all__]
    return {method.name: method for method in classes if hasattr(method, "name")}


SPLITTINGS = _methods_of(rows)
THERMOSTATS = _methods_of(thermostats)
IMPLICIT = _methods_of(runge_kutta, bdf)
METHODS = MethodTable({**SPLITTINGS, **THERMOSTATS, **IMPLICIT})
