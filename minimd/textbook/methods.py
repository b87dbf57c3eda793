"""The tables of methods, by name: all public classes of the integrator modules that have an attribute `name`."""

from minimd.core.console.display import Displayed, Rows
from minimd.core.integrators.method import Method, methods_of
from minimd.core.integrators.table import SPLITTINGS, THERMOSTATS
from minimd.textbook.ode import bdf, runge_kutta

__all__ = ["METHODS"]


HEADER = ("name", "class", "order", "stages", "symmetric", "symplectic", "explicit", "source")


class MethodTable(Displayed, dict[str, type[Method]]):
    """Methods by name, displayed as a table of their properties."""

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows: list[tuple[str, ...]] = [HEADER]
        for method in self.values():
            properties = (method.is_symmetric, method.is_symplectic, method.is_explicit)
            answers = ("yes" if holds else "no" for holds in properties)
            numbers = (str(method.order), str(method.stages))
            rows.append((method.name, method.__name__, *numbers, *answers, method.source))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [(row[0], "  ".join(map(str.ljust, row[1:], widths[1:])).rstrip()) for row in rows]

    def __repr__(self) -> str:
        return str(self)


IMPLICIT = methods_of(runge_kutta, bdf)
METHODS = MethodTable({**SPLITTINGS, **THERMOSTATS, **IMPLICIT})
