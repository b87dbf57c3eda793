"""The tables of methods, by name: all public classes of the integrator modules that have an attribute `name`."""

from types import ModuleType
from typing import Any

from minimd.integrators.method import Method
from minimd.integrators.ode import bdf, runge_kutta
from minimd.integrators.splitting import rows, thermostats

__all__ = ["METHODS", "SPLITTINGS", "THERMOSTATS"]


class MethodTable(dict[str, type[Method]]):
    """Methods by name; printing it shows the properties of each."""

    def __str__(self) -> str:
        rows: list[tuple[str, ...]] = [("name", "order", "stages", "symmetric", "symplectic", "explicit", "source")]
        for method in self.values():
            answers = (method.is_symmetric, method.is_symplectic, method.is_explicit)
            known = ("yes" if answer else "no" for answer in answers)
            rows.append((method.name, str(method.order), str(method.stages), *known, method.source))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _methods_of(*modules: ModuleType) -> dict[str, Any]:
    """The methods that these modules define, in the order in which they stand there."""
    classes = [value for module in modules for name, value in vars(module).items() if name in module.__all__]
    return {method.name: method for method in classes if hasattr(method, "name")}


SPLITTINGS = _methods_of(rows)
THERMOSTATS = _methods_of(thermostats)
IMPLICIT = _methods_of(runge_kutta, bdf)
METHODS = MethodTable({**SPLITTINGS, **THERMOSTATS, **IMPLICIT})
