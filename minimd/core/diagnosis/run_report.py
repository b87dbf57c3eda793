"""The report of a run that a guard has made, and its lines beside the conservation laws.

They are about jumps at the cutoff, the number of steps that a list lasts, velocities along rigid bonds, and a barostat.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isnan, nan
from typing import Any, NamedTuple

import numpy as np

from minimd.core.compiled.machine import peak_memory
from minimd.core.diagnosis.judge import too_long_a_step
from minimd.core.diagnosis.report import Cost, Line, Report, conservation_report, swelling
from minimd.core.diagnosis.reversibility import Reversibility
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.cell_rescaling import EVAPORATED
from minimd.core.engine.engine import Engine
from minimd.core.engine.record import Record
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.hybrid_monte_carlo import CHECKED, MADE, HybridMonteCarlo
from minimd.core.integrators.ramp import level_at
from minimd.core.integrators.thermostats import Thermostat
from minimd.core.potentials.law import law_at
from minimd.core.potentials.pair import Nonbonded
from minimd.core.structure.arrays import Array
from minimd.core.structure.observables import leaves_out_center, longest
from minimd.core.structure.statistics import (
    correlation_times,
    mean_and_error,
    short_run,
    with_error,
)
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE, GRAM_PER_CM3

CONTINUOUS = 1e-9  # of the law at INSIDE r_c: a smaller jump is rounding
# of these, the first at which the law has a value: a table may begin late
INSIDE = (0.9, 0.99, 0.999)
FEW_STEPS = 3.0  # a list that lasts no longer is rebuilt so often that a wider skin is cheaper
ROOM = 0.99  # of the widest skin: beyond this it cannot be made wider
TURNING = 1e-8  # of the speed, along a rigid bond
ENOUGH = 20  # frames, for a mean that is judged
FAR_WEIGHT = 5.0  # standard errors of a mean of weights, whose distribution has a long tail
FEW_ACCEPTED = 0.3
FAR = 3.0  # standard errors within which a mean counts as that of the barostat


def report_of(guard: RunGuard, record: Record, reversibility: Reversibility | None) -> Report:
    """See Simulation.report."""
    engine = guard.engine
    engine.enter()
    interactions = engine.interactions
    bonds = engine.constraint_set.bonds
    is_free = engine.conserves_momentum
    solvers = f"{bonds.summary}; at most {bonds.iterations} iterations in a drift" if bonds else ""
    picoseconds = guard.n_steps * abs(engine.method.duration) * engine.system.units.to_picosecond
    cost = Cost(
        n_atoms=len(engine.system),
        n_steps=guard.n_steps,
        seconds=guard.seconds,
        list_builds=interactions.n_builds,
        n_evaluations=interactions.n_evaluations,
        pair_search=interactions.pair_search,
        skipped=interactions.skipped(),
        constraints=solvers,
        peak_memory=peak_memory(),
        observing=guard.observing,
        nanoseconds=0.0 if engine.system.units.is_reduced else picoseconds / 1000.0,
    )
    angular = is_free and not engine.system.cell.is_periodic
    lines = static_checks(engine, reversibility)
    if isinstance(engine.method, HybridMonteCarlo):
        lines.append(proposals_line(engine.method))
    changes = bath_changes(guard)
    mass = float(engine.system.masses.sum())
    lines += pressure_lines(record, mass, engine.barostat, is_free, is_ramp=bool(changes))
    advice = too_long_a_step(engine) or ""
    report = conservation_report(record, angular, cost, is_free, lines, engine.n_dof, advice)
    changed = f"the {' and '.join(changes)} of the bath changed during the run" if changes else ""
    is_smooth = not any(line.is_rough for line in lines)
    uncounted = uncounted_work(engine)
    return replace(
        report, bath=bath_of(engine), changed=changed, uncounted=uncounted, is_smooth=is_smooth
    )


def proposals_line(method: HybridMonteCarlo) -> Line:
    """What has become of the proposals since the last equilibration."""
    n_made = int(method.memory[MADE])
    n_checked = int(method.memory[CHECKED])
    if n_made < 2:
        return Line("proposals", "fewer than two", "not judged", True)
    mean, error = method.mean_weight
    summary = (
        f"accepted {method.acceptance:.3f} of {n_made}; <exp(-dH/kT)> {mean:.4f} +- {error:.4f}, 1 in theory; "
        f"{n_checked} checked"
    )
    verdict = "as theory says"
    is_good = method.acceptance >= FEW_ACCEPTED
    if not is_good:
        verdict = "few are accepted: take a shorter time step, or fewer steps"
    elif abs(mean - 1.0) > FAR_WEIGHT * error:
        verdict = (
            "NOT AS THEORY SAYS: equilibrate first; or a force is no function of the positions"
        )
        is_good = False
    return Line("proposals", summary, verdict, is_good)


def uncounted_work(engine: Engine) -> str:
    """A clause about forces from outside whose energy nobody has checked; empty without such."""
    names = ", ".join(engine.interactions.unchecked)
    return (
        f"the work of {names} is not counted, a force from outside without energy" if names else ""
    )


def bath_changes(guard: RunGuard) -> list[str]:
    """Which of temperature and pressure of the baths observers have changed during a run."""
    settings = zip(
        ("temperature", "pressure"), zip(*guard.bath_settings, strict=True), strict=False
    )
    return [name for name, values in settings if len(set(values)) > 1]


def bath_of(engine: Engine) -> tuple[float, float] | None:
    """Temperature of the thermostat, and how far below it that of the velocities is expected, NaN if that is not known;
    None without one.

        T − T_kin = c² Δt² Σ m a² / (n_dof k_B)

    Velocities are in equilibrium with the bath before the last kick, of duration c Δt. After it they do not correlate
    with the acceleration a, because forward and backward are alike. For harmonic forces the mean is T (ωΔt)² c².
    The sum is that of the present state."""
    method = engine.method
    constraint_set = engine.constraint_set
    if not isinstance(method, Thermostat):
        return None
    if isnan(method.last_kick):
        return method.temperature_at(engine.step), nan
    if method.last_kick:
        engine.evaluate()
    inverse_masses = constraint_set.inverse_masses[:, None]
    kicks = method.last_kick * method.stride * engine.forces * inverse_masses
    constraint_set.project(kicks, engine.positions)
    deficit = constraint_set.temperature(kicks, engine.system, engine.conserves_momentum)
    return method.temperature_at(engine.step), deficit


def static_checks(engine: Engine, reversibility: Reversibility | None) -> list[Line]:
    """All lines that apply to an engine as it stands."""
    interactions = engine.interactions
    lines = [*cutoff_lines(engine.system, interactions.potentials, engine.has_bath)]
    stride = longest(engine.velocities)[1] * abs(engine.method.stride)
    unit = engine.system.units.length
    for skin, widest in zip(interactions.skins, interactions.widest_skins, strict=True):
        steps = 0.5 * skin / stride if stride > 0.0 else np.inf
        valid = f"valid until an atom has moved by {0.5 * skin:.3g} {unit}, half the skin"
        fastest = f"the fastest needs {steps:.3g} steps for this"
        verdict = "always rebuilt before"
        is_good = steps >= FEW_STEPS
        if not is_good:
            cure = "a shorter cutoff (the cell has no room for a wider skin)"
            if skin < ROOM * widest:
                cure = "a wider skin"
            verdict += f", but at nearly every step; {cure} or a shorter time step is cheaper"
        lines.append(Line("neighbor list", f"{valid}; {fastest}", verdict, is_good))
    bonds = engine.constraint_set.bonds
    if bonds is not None:
        turning = float(bonds.velocity_violation(engine.positions, engine.velocities).max())
        is_good = turning < TURNING
        verdict = "obeyed" if is_good else "NOT OBEYED"
        summary = f"velocities along them {turning:.1e} of the speed"
        lines.append(Line("rigid bonds", summary, verdict, is_good))
    if reversibility is not None:
        summary, _, verdict = str(reversibility).rpartition(": ")
        is_good = reversibility.is_reversible is not False
        lines.append(Line("reversibility", summary, verdict, is_good))
    return lines


class Jump(NamedTuple):
    """What is cut off at cutoff [length].
    energy, force : |u|, |u′| there.
    size : of |u|, with which it is compared; that of |u′| is size/cutoff."""

    cutoff: float
    energy: float
    force: float
    size: float


def cutoff_lines(
    system: System, potentials: Sequence[Any], has_bath: bool = False
) -> Iterator[Line]:
    """The jumps of energy and force at the cutoff of each pair potential, the worst of all pairs of species."""
    units = system.units
    for potential in potentials:
        if not isinstance(potential, Nonbonded) or not np.isfinite(potential.cutoff):
            continue
        table = potential.table(system.species_names)
        rows = table.reshape(-1, table.shape[-1]).tolist()
        jumps = [_jump(potential.law, row[0], *potential.alone, *row[1:]) for row in rows]
        energy, at = max((jump.energy, jump.cutoff) for jump in jumps)
        force, there = max((jump.force, jump.cutoff) for jump in jumps)
        energy_jumps = any(jump.energy > CONTINUOUS * jump.size for jump in jumps)
        force_jumps = any(jump.force > CONTINUOUS * (jump.size / jump.cutoff) for jump in jumps)
        verdict = "energy and force are continuous"
        if energy_jumps and has_bath:
            verdict = "the energy jumps, and E - reservoir with it; the atoms move as if it were shifted to 0"
        elif energy_jumps:
            verdict = "THE ENERGY JUMPS, so that it is not conserved; shift or smooth the potential"
        elif force_jumps:
            verdict = "the energy is continuous, the force jumps; smooth the force for methods of order above 2"
        where = "" if at == there or energy == 0.0 else f" at {at:g} {units.length}"
        summary = (
            f"energy {energy:.1e} {units.energy}{where}, "
            f"force {force:.1e} {units.energy}/{units.length} at {there:g} {units.length}"
        )
        is_rough = energy_jumps or force_jumps
        yield Line("cutoff jump", summary, verdict, not energy_jumps, is_rough=is_rough)


def _jump(law: tuple, cutoff2: float, *numbers: float) -> Jump:
    """The jump of a law with the numbers of a pair of species."""
    cutoff = cutoff2**0.5
    u, f = np.abs(law_at(law, cutoff, numbers))
    size = u
    for inside in INSIDE:
        u_inside, f_inside = np.abs(law_at(law, inside * cutoff, numbers))
        if np.isfinite([u_inside, f_inside]).all():
            size = u_inside + f_inside * inside * cutoff * cutoff
            break
    return Jump(cutoff, float(u), float(f) * cutoff, float(size))


def densities(record: Record, mass: float) -> tuple[Array, str]:
    """The densities of a record with volumes, (T,), and their unit: g/cm³ in ASE's units, else atoms per volume.
    mass : of all atoms."""
    if record.units == ASE:
        return mass / GRAM_PER_CM3 / record.volume, "g/cm³"
    return record.n_atoms / record.volume, f"atoms/{record.units.volume}"


def pressure_lines(
    record: Record,
    mass: float,
    barostat: StochasticCellRescaling | None,
    is_free: bool,
    is_ramp: bool = False,
) -> Iterator[Line]:
    """Lines with the means of volume and density, and, unless only some lengths of the cell change, the mean pressure
    compared with the target of the barostat; none without a barostat.
    mass : of all atoms.
    is_ramp : whether the baths have changed; there are no means then."""
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
    if is_ramp:
        return
    change = swelling(record.volume)
    deviation = f"standard deviation {record.volume.std():.2g}"
    if change:
        deviation = f"NOT REACHED: it changed by {100.0 * change:+.2g} % from the first to the last fifth of the run"
    mean_volume = f"{record.volume.mean():.6g} {units.volume} on average"
    yield Line("volume", mean_volume, deviation, not change, misses_pressure=bool(change))
    density, unit = densities(record, mass)
    yield Line(
        "density",
        f"{with_error(*mean_and_error(density))} {unit} on average",
        f"standard deviation {density.std():.2g}{_unless_long(density, 'density')}",
        True,
    )
    if barostat.coupling not in ("isotropic", "triclinic", "xyz"):
        return
    missing = 0.0
    if leaves_out_center(record.n_atoms, is_free):
        missing = units.k_B * record.temperature / record.volume
    factor = units.to_shown_pressure
    wanted = factor * level_at(barostat.pressure, int(record.step[-1]))
    pressure = factor * (record.pressure + missing)
    mean, error = mean_and_error(pressure)
    is_there = abs(mean - wanted) <= FAR * error
    verdict = "NOT REACHED; equilibrate longer"
    if is_there:
        verdict = "consistent with it, within three standard errors"
    yield Line(
        "pressure",
        f"{with_error(mean, error)} {units.shown_pressure} on average, {wanted:.4g} wanted",
        f"{verdict}{_unless_long(pressure, 'pressure')}",
        is_there,
        not is_there,
    )


def _unless_long(series: Array, of: str) -> str:
    """What short_run says of a series, behind a semicolon."""
    error = mean_and_error(series)[1]
    short = short_run(float(correlation_times(series.var(), error)), of)
    return f"; {short}" if short else ""
