"""A user's field: u(x, y, z, t), its force and its change with time, which are checked before they are trusted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.potentials.declared import Array, atoms, declared, own_law, own_parameters
from minimd.potentials.fields import FieldTerm, OnAtoms
from minimd.potentials.law import ACCURACY, agree, evaluate_law
from minimd.potentials.term import Term
from minimd.structure.system import System

TRIED = 5  # atoms at which a law is tried
TIMES = (0.0, 0.37, 1.9)  # at which it is tried
TIMED = 5  # numbers that a law returns if its u depends on time
STEP = 1e-5  # of a central difference, of the units of length and time


class Field(OnAtoms):
    """A user's field, u(x, y, z, t).

        def trap(x, y, z, t, k):
            return 0.5 * k * (x * x + y * y), -k * x, -k * y, 0.0

        md.Field(trap, (2.0,))

    Parameters
    ----------
    law : function law(x, y, z, t, *parameters) of the position of an atom, which is never wrapped [length], and the
        time [time]. It returns u [energy] and the force, three numbers [energy/length]; and, if u depends on t, ∂u/∂t
        [energy/time] as a fifth number, from which the work is counted. Plain Python, or compiled by numba.njit.
    parameters : one entry for each parameter of the law: a number for all atoms, or an array with one number for each.
    atoms : indices of the atoms on which it acts; all if not given.

    Raises
    ------
    TypeError : for a law that is not a function, or does not return such numbers.  ValueError : for parameters that are
        not finite or do not fit, and, when it is bound to a system, for a force that is not −∇u,
        or a u that changes with time where ∂u/∂t is not returned.
    """

    law: Callable = declared(own_law)
    parameters: Sequence[ArrayLike] = declared(own_parameters, default=())
    atoms: ArrayLike | None = declared(atoms, default=None)

    def bind(self, system: System) -> Term:
        """The term of this field in a system.  Raises ValueError, TypeError as the class says."""
        acting = self.atoms_in(system)
        columns = self.columns("atoms", len(acting))
        law: Any = self.law
        some = np.unique(np.linspace(0, len(acting) - 1, TRIED).astype(int)) if len(acting) else ()
        tried = [_Tried(law, system.positions[acting[k]], tuple(one[k].item() for one in columns)) for k in some]
        faults = [fault for one in tried for time in TIMES for fault in one.wrong(time)]
        for k, sentence in faults:
            if 2 * sum(other == k for other, _ in faults) > len(tried) * len(TIMES):
                raise ValueError(sentence)
        warning = next((words for one in tried if (words := one.repeats(system))), "")
        term = FieldTerm(acting, law, columns, warning=warning)
        term.depends_on_time = any(one.is_timed for one in tried)
        term.fits_grid = not term.depends_on_time  # its work is no whole number of steps
        return term


class _Tried:
    """A user's law at the position of an atom."""

    def __init__(self, law: tuple, place: Array, numbers: tuple[float, ...]) -> None:
        self.law, self.place, self.numbers = law, place, numbers
        self.is_timed = len(self.at(TIMES[0])) == TIMED

    def at(self, time: float, shift: Array | float = 0.0) -> tuple[float, ...]:
        """What the law returns.  Raises TypeError unless that is four or five numbers."""
        name = type(self.law).python.__name__  # type: ignore[attr-defined]
        x, y, z = (self.place + shift).tolist()
        wanted = "u, three forces, and ∂u/∂t if it depends on t"
        try:
            found = tuple(float(one) for one in evaluate_law(self.law, x, (y, z, time, *self.numbers)))
        except ArithmeticError:
            return (nan,) * 4
        except Exception as error:  # whatever a law of the user's raises
            taken = f"x, y, z, t and {len(self.numbers)} parameters"
            raise TypeError(f"the law {name} must take {taken}, and return {wanted}: {error}") from None
        if len(found) not in (4, TIMED):
            raise TypeError(f"the law {name} must return {wanted}; it returns {len(found)} numbers")
        return found

    def slopes(self, time: float) -> Array:
        """−∇u and ∂u/∂t by central differences, (4,)."""
        steps = [(h, 0.0) for h in STEP * np.eye(3)] + [(np.zeros(3), STEP)]
        return np.array([(self.at(time - dt, h)[0] - self.at(time + dt, -h)[0]) / (-2.0 * STEP) for h, dt in steps])

    def wrong(self, time: float) -> Iterator[tuple[int, str]]:
        """What is wrong: the index of a wrong number among those after u, and a sentence."""
        u, *told = self.at(time)
        for k, (said, slope) in enumerate(zip((*told, 0.0)[:4], self.slopes(time).tolist(), strict=True)):
            if isfinite(said) and isfinite(slope) and not agree(said, slope, u):
                at = f"at ({', '.join(f'{c:.4g}' for c in self.place)}), t = {time:g}"
                what = f"-∂u/∂{'xyz'[k]}" if k < len("xyz") else "∂u/∂t"
                if k == len(told):
                    fifth = "the law must return ∂u/∂t as its fifth number, because u depends on t"
                    yield k, f"{fifth}; {at} it is {slope:.6g}"
                else:
                    wanted = "the law must return u, -∇u and ∂u/∂t"
                    yield k, f"{wanted}; {at} it returns {said:.6g} where {what} is {slope:.6g}"

    def repeats(self, system: System) -> str:
        """A warning if the force is another one lattice vector away; empty if not."""
        here = np.array(self.at(TIMES[0])[1:4])
        for k in np.flatnonzero(system.cell.pbc):
            there = self.at(TIMES[0], system.cell.vectors[k])[1:4]
            if not np.allclose(here, there, rtol=ACCURACY, atol=ACCURACY * np.abs(here).max()):
                where = f"the cell is periodic along {'abc'[k]}, but the field is not"
                return f"{where}: an atom and its image feel different forces"
        return ""
