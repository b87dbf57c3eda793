"""The report of a run that a guard has made, and its lines beside the conservation laws.

They are about jumps at the cutoff, the number of steps that a list lasts, velocities along rigid bonds, and a barostat.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from minimd.core.compiled.machine import peak_memory
from minimd.core.diagnosis.judge import too_long_a_step
from minimd.core.diagnosis.report import Cost, Line, Report, conservation_report
from minimd.core.diagnosis.reversibility import Reversibility
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.cell_rescaling import EVAPORATED
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Record
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.thermostats import Thermostat
from minimd.core.potentials.law import law_at
from minimd.core.potentials.pair import Nonbonded
from minimd.core.structure.observables import leaves_out_center, longest
from minimd.core.structure.statistics import mean_and_error, with_error
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE, GRAM_PER_CM3

CONTINUOUS = 1e-9  # of the law at INSIDE r_c: a smaller jump is rounding
# of these, the first at which the law has a value: a table may begin late
INSIDE = (0.9, 0.99, 0.999)
FEW_STEPS = 3.0  # a list that lasts no longer is rebuilt so often that a wider skin is cheaper
ROOM = 0.99  # of the widest skin: beyond this it cannot be made wider
TURNING = 1e-8  # of the speed, along a rigid bond
ENOUGH = 20  # frames, for a mean that is judged
FAR = 3.0  # standard errors within which a mean counts as that of the barostat


def report_of(guard: RunGuard, record: Record, reversibility: Reversibility | None) -> Report:
    """See Simulation.report."""
    engine = guard.engine
    engine.enter()
    interactions = engine.interactions
    bonds = engine.constraint_set.bonds
    is_free = engine.conserves_momentum
    solvers = f"{bonds.summary}; at most {bonds.iterations} iterations in a drift" if bonds else ""
    made = (interactions.n_builds, interactions.n_evaluations)
    what = (interactions.pair_search, interactions.skipped())
    cost = Cost(guard.n_steps, guard.seconds, *made, *what, solvers, peak_memory(), guard.observing)
    angular = is_free and not engine.system.cell.is_periodic
    lines = static_checks(engine, reversibility)
    lines += pressure_lines(record, float(engine.system.masses.sum()), engine.barostat, is_free)
    report = conservation_report(
        record, angular, cost, is_free, lines, engine.n_dof, too_long_a_step(engine) or ""
    )
    return replace(report, bath=bath_of(engine))


def bath_of(engine: Engine) -> tuple[float, float] | None:
    """Temperature of the thermostat, and how far below it that of the velocities is expected; None without one.

        T − T_kin = c² Δt² Σ m a² / (n_dof k_B)

    Velocities are in equilibrium with the bath before the last kick, of duration c Δt. After it they do not correlate
    with the acceleration a, because forward and backward are alike. For harmonic forces the mean is T (ωΔt)² c².
    The sum is that of the present state."""
    method = engine.method
    constraint_set = engine.constraint_set
    if not isinstance(method, Thermostat):
        return None
    if method.last_kick:
        engine.evaluate()
    kicks = (
        method.last_kick * method.timestep * engine.forces * constraint_set.inverse_masses[:, None]
    )
    constraint_set.project(kicks, engine.positions)
    return method.temperature, constraint_set.temperature(
        kicks, engine.system, engine.conserves_momentum
    )


def static_checks(engine: Engine, reversibility: Reversibility | None) -> list[Line]:
    """All lines that apply to an engine as it stands."""
    lines = [*cutoff_lines(engine.system, engine.interactions.potentials, engine.has_bath)]
    stride = longest(engine.velocities)[1] * abs(engine.method.timestep)
    unit = engine.system.units.length
    for skin, widest in zip(
        engine.interactions.skins, engine.interactions.widest_skins, strict=True
    ):
        steps = 0.5 * skin / stride if stride > 0.0 else np.inf
        words = f"skin/2 {0.5 * skin:.3g} {unit}, fastest atom {stride:.2g} {unit} a step: list lasts {steps:.3g} steps"
        cure = (
            "a wider skin"
            if skin < ROOM * widest
            else "a shorter cutoff (the cell has no room for a wider skin)"
        )
        often = (
            f", but at nearly every step; {cure} or a shorter time step is cheaper"
            if steps < FEW_STEPS
            else ""
        )
        lines.append(Line("list margin", words, f"rebuilt in time{often}", not often))
    if engine.constraint_set.bonds is not None:
        turning = float(
            engine.constraint_set.bonds.velocity_violation(
                engine.positions, engine.velocities
            ).max()
        )
        good = turning < TURNING
        words = f"velocities along them {turning:.1e} of the speed"
        lines.append(Line("rigid bonds", words, "obeyed" if good else "NOT OBEYED", good))
    if reversibility is not None:
        words, _, verdict = str(reversibility).rpartition(": ")
        lines.append(
            Line("reversibility", words, verdict, reversibility.is_reversible is not False)
        )
    return lines


def cutoff_lines(
    system: System, potentials: Sequence[Any], has_bath: bool = False
) -> Iterator[Line]:
    """The jumps of energy and force at the cutoff of each pair potential, the worst of all pairs of species."""
    units = system.units
    for potential in potentials:
        if not isinstance(potential, Nonbonded) or not np.isfinite(potential.cutoff):
            continue
        table = potential.table(system.species_names)
        rows = table.reshape(-1, table.shape[-1])
        jumps = [
            _jumps(potential.law, float(row[0]) ** 0.5, tuple(row[1:].tolist())) for row in rows
        ]
        cutoffs = [float(row[0]) ** 0.5 for row in rows]
        (energy, at), (force, there) = (
            max((j[k], r) for j, r in zip(jumps, cutoffs, strict=True)) for k in (0, 1)
        )
        energy_jumps, force_jumps = (
            any(jump[k] > CONTINUOUS * jump[k + 2] for jump in jumps) for k in (0, 1)
        )
        verdict = "energy and force are continuous"
        if energy_jumps and has_bath:
            verdict = "the energy jumps; the bath compensates for this"
        elif energy_jumps:
            verdict = "THE ENERGY JUMPS, so that it is not conserved; shift or smooth the potential"
        elif force_jumps:
            verdict = "the energy is continuous, the force jumps; smooth the force for methods of order above 2"
        where = "" if at == there or energy == 0.0 else f" at {at:g} {units.length}"
        pull = f"force {force:.1e} {units.energy}/{units.length} at {there:g} {units.length}"
        yield Line(
            "cutoff jump",
            f"energy {energy:.1e} {units.energy}{where}, {pull}",
            verdict,
            not energy_jumps,
        )


def _jumps(
    law: tuple, cutoff: float, numbers: tuple[float, ...]
) -> tuple[float, float, float, float]:
    """|u|, |u′| at the cutoff, and the sizes with which they are compared."""
    u, f = np.abs(law_at(law, cutoff, numbers))
    known = ((inside, np.abs(law_at(law, inside * cutoff, numbers))) for inside in INSIDE)
    inside, (u_inside, f_inside) = next(
        (one for one in known if np.isfinite(one[1]).all()), (0.0, (u, f))
    )
    size = u_inside + f_inside * inside * cutoff * cutoff
    return float(u), float(f) * cutoff, float(size), float(size) / cutoff


def pressure_lines(
    record: Record, mass: float, barostat: StochasticCellRescaling | None, is_free: bool
) -> Iterator[Line]:
    """Lines with the means of volume and density, and the mean pressure compared with the target of the barostat; none
    without a barostat.  mass : of all atoms."""
    if barostat is None or len(record) < ENOUGH or not np.isfinite(record.pressure).all():
        return
    first = float(record.volume[0])
    last = float(record.volume[-1])
    units = record.units
    if last > EVAPORATED * first:
        grown = f"from {first:.4g} to {last:.4g} {units.volume}"
        verdict = "EVAPORATED: at this pressure and temperature the atoms are a gas; for a liquid raise the pressure"
        yield Line("volume", grown, verdict, False)
        return
    words = f"{record.volume.mean():.6g} {units.volume} on average"
    spread = f"{record.volume.std():.2g}"
    yield Line("volume", words, f"standard deviation {spread}", True)
    amount, unit = (
        (mass / GRAM_PER_CM3, "g/cm³")
        if units == ASE
        else (record.n_atoms, f"atoms/{units.volume}")
    )
    density = amount / record.volume
    words = f"{with_error(*mean_and_error(density))} {unit} on average"
    yield Line("density", words, f"standard deviation {density.std():.2g}", True)
    if barostat.coupling not in ("isotropic", "triclinic"):
        return
    missing = 0.0
    if leaves_out_center(record.n_atoms, is_free):
        missing = units.k_B * record.temperature / record.volume
    mean, error = mean_and_error(record.pressure + missing)
    is_there = abs(mean - barostat.pressure) <= FAR * error
    words = f"{with_error(mean, error)} {units.pressure} on average, {barostat.pressure:.4g} wanted"
    yield Line(
        "pressure",
        words,
        "reached" if is_there else "NOT REACHED; equilibrate longer",
        is_there,
        not is_there,
    )
