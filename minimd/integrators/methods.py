"""The tables of methods, by name."""

from minimd.integrators.method import Method
from minimd.integrators.ode.bdf import BDF1, BDF2, BDF3, BDF4, BDF5
from minimd.integrators.ode.runge_kutta import (
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    RadauIIA2,
    RadauIIA3,
)
from minimd.integrators.splitting.compositions import (
    PEFRL,
    BlanesMoan4,
    CandyRozmus4,
    KahanLi6,
    KahanLi8,
    McLachlanAtela4,
    Ruth3,
    Suzuki4,
    Yoshida6,
)
from minimd.integrators.splitting.splitting import Splitting
from minimd.integrators.splitting.thermostats import THERMOSTATS
from minimd.integrators.splitting.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet

SPLITTINGS: dict[str, type[Splitting]] = {
    method.name: method
    for method in (
        VelocityVerlet,
        PositionVerlet,
        Leapfrog,
        SE1,
        SE2,
        Ruth3,
        CandyRozmus4,
        Suzuki4,
        McLachlanAtela4,
        PEFRL,
        BlanesMoan4,
        Yoshida6,
        KahanLi6,
        KahanLi8,
    )
}

IMPLICIT: dict[str, type[Method]] = {
    method.name: method
    for method in (
        GaussLegendre1,
        GaussLegendre2,
        GaussLegendre3,
        GaussLegendre4,
        ImplicitEuler,
        RadauIIA2,
        RadauIIA3,
        BDF1,
        BDF2,
        BDF3,
        BDF4,
        BDF5,
    )
}


class MethodTable(dict[str, type[Method]]):
    """Methods by name; print it to read what each of them is."""

    def __str__(self) -> str:
        rows = [("name", "order", "stages", "symmetric", "symplectic", "explicit", "source"), *map(_entries, self.values())]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join("  ".join(entry.ljust(width) for entry, width in zip(row, widths, strict=True)).rstrip() for row in rows)


def _entries(method: type[Method]) -> tuple[str, ...]:
    """What the table says of a method."""
    answers = (method.is_symmetric, method.is_symplectic, method.is_explicit)
    return (method.name, str(method.order), str(method.stages), *("yes" if answer else "no" for answer in answers), method.source)


METHODS = MethodTable({**SPLITTINGS, **THERMOSTATS, **IMPLICIT})
