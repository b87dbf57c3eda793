"""Lines of the report that need no run: jumps at the cutoff, the number of steps that a list lasts, velocities along rigid bonds."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from minimd.diagnosis.report import Line
from minimd.diagnosis.reversibility import Reversibility
from minimd.engine.engine import Engine
from minimd.potentials.law import law_at
from minimd.potentials.pair import PairPotential
from minimd.structure.observables import longest
from minimd.structure.system import System

CONTINUOUS = 1e-9  # of the law at INSIDE r_c: a smaller jump is rounding
INSIDE = (0.9, 0.99, 0.999)  # of these, the first at which the law has a value: a table may begin late
FEW_STEPS = 3.0  # a list that lasts no longer is rebuilt so often that a wider skin is cheaper
ROOM = 0.99  # of the widest skin: beyond this it cannot be made wider
TURNING = 1e-8  # of the speed, along a rigid bond


def static_checks(engine: Engine, reversibility: Reversibility | None) -> list[Line]:
    """All lines that apply to an engine as it stands."""
    lines = [*cutoff_lines(engine.system, engine.interactions.potentials), *list_lines(engine), *constraint_lines(engine)]
    if reversibility is not None:
        words, _, verdict = str(reversibility).rpartition(": ")
        lines.append(Line("reversibility", words, verdict, reversibility.is_reversible is not False))
    return lines


def cutoff_lines(system: System, potentials: Sequence[Any]) -> Iterator[Line]:
    """The jumps of energy and force at the cutoff of each pair potential, the worst of all pairs of species."""
    units = system.units
    for potential in potentials:
        if not isinstance(potential, PairPotential) or not np.isfinite(potential.cutoff):
            continue
        rows = potential.table(system.species_names).reshape(-1, potential.table(system.species_names).shape[-1])
        jumps = [_jumps(potential.law, float(row[0]) ** 0.5, tuple(row[1:].tolist())) for row in rows]
        (energy, at), (force, there) = (max((jump[k], float(row[0]) ** 0.5) for jump, row in zip(jumps, rows, strict=True)) for k in (0, 1))
        energy_jumps, force_jumps = (any(jump[k] > CONTINUOUS * jump[k + 2] for jump in jumps) for k in (0, 1))
        verdict = "energy and force are continuous"
        if energy_jumps:
            verdict = "THE ENERGY JUMPS, so that it is not conserved; shift or smooth it"
        elif force_jumps:
            verdict = "the energy is continuous, the force jumps; smooth it for methods of order above 2"
        where = "" if at == there or energy == 0.0 else f" at {at:g} {units.length}"
        words = f"energy {energy:.1e} {units.energy}{where}, force {force:.1e} {units.energy}/{units.length} at {there:g} {units.length}"
        yield Line("cutoff jump", words, verdict, not energy_jumps)


def _jumps(law: tuple, cutoff: float, numbers: tuple[float, ...]) -> tuple[float, float, float, float]:
    """|u|, |u′| at the cutoff, and the sizes with which they are compared."""
    u, f = np.abs(law_at(law, cutoff, numbers))
    known = ((inside, np.abs(law_at(law, inside * cutoff, numbers))) for inside in INSIDE)
    inside, (u_inside, f_inside) = next((one for one in known if np.isfinite(one[1]).all()), (0.0, (u, f)))
    size = u_inside + f_inside * inside * cutoff * cutoff
    return float(u), float(f) * cutoff, float(size), float(size) / cutoff


def list_lines(engine: Engine) -> Iterator[Line]:
    """How many steps of the fastest atom each list with a skin lasts."""
    stride, length = longest(engine.velocities)[1] * abs(engine.method.timestep), engine.system.units.length
    for skin, widest in zip(engine.interactions.skins, engine.interactions.widest_skins, strict=True):
        steps = 0.5 * skin / stride if stride > 0.0 else np.inf
        words = f"skin/2 {0.5 * skin:.3g} {length}, fastest atom {stride:.2g} {length} a step: lasts {steps:.3g} steps"
        often = steps < FEW_STEPS
        cure = "a wider skin" if skin < ROOM * widest else "the cell has no room for a wider skin: a shorter cutoff"
        verdict = "rebuilt in time" + (f", but at nearly every step; {cure} or a shorter time step is cheaper" if often else "")
        yield Line("list margin", words, verdict, not often)


def constraint_lines(engine: Engine) -> Iterator[Line]:
    """One line on how well the present velocities obey the distance constraints; no line if there are none."""
    if engine.constraint_set.bonds is not None:
        turning = float(engine.constraint_set.bonds.velocity_violation(engine.positions, engine.velocities).max())
        good = turning < TURNING
        yield Line("rigid bonds", f"velocities along them {turning:.1e} of the speed", "obeyed" if good else "NOT OBEYED", good)
