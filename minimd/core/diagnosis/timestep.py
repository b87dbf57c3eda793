"""Advice on the time step: the stiffest mode of a state and collisions of its atoms, and what they allow."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, nan, pi
from timeit import repeat

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.words import shown
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.diagnosis.contacts import why_not_finite
from minimd.core.diagnosis.stiffness import ACCURACY, COLDEST, Curvature, Stiffness
from minimd.core.engine.engine import Engine
from minimd.core.forces.forces import Forces, Potential
from minimd.core.integrators.order_conditions import accurate_step, stability_limit
from minimd.core.integrators.rows import VelocityVerlet
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.substeps import outer_substeps
from minimd.core.potentials.bonded import Bond
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.errors import NonFiniteError
from minimd.core.structure.system import AnySystem, System
from minimd.core.structure.units import UnitSystem

# of the energy of the stiffest mode at the recommended step: 20 velocity Verlet steps a period
OSCILLATION = 1.0 / 80.0
EVALUATIONS = 200  # of the forces: as many mostly suffice to find the stiffest mode of many atoms
# the same with a residual of ROUGH: ω is then right to a hundredth
FEW_EVALUATIONS = 100
ROUGH = 0.03
SHOWN_ATOMS = 4  # of the stiffest mode, at most
HALF = 0.5  # of a mode: a bond is named if its stretching makes up more
SHOWN_SHARE = 0.05  # of its kinetic energy, at least


@dataclass(frozen=True)
class StepAdvice(Displayed):
    """Advice on the time step from the stiffest mode of a state, and from collisions of Lennard-Jones atoms; print it.

    Attributes
    ----------
    frequency : ω of the stiffest mode [1/time], angular; 0 if nothing oscillates.
    period : 2π/ω [time].
    limit : the longest stable step of the method [time].
    harmonic : the step at which the energy of this mode oscillates by ±1/80 of its mean, at most half the limit [time].
    collision : the same for Lennard-Jones atoms that collide in a liquid [time]; infinite without such atoms.
    recommended : the smaller of the two [time].
    temperature : of the velocities, for which it holds; 0 at rest [temperature].
    method : name of the method.
    timestep : of the method, if it has one [time].
    atoms, shares : the atoms that move most in the mode, and the fraction of its kinetic energy that each of them has.
    n_moving : over how many atoms the mode is spread, 1/Σ share².
    bond : (i, j), if the mode is the stretching of one bond.
    n_evaluations : of the forces.
    units : of the system.
    """

    frequency: float
    period: float
    limit: float
    harmonic: float
    collision: float
    recommended: float
    temperature: float
    method: str
    timestep: float | None
    atoms: tuple[int, ...]
    shares: tuple[float, ...]
    n_moving: float
    bond: tuple[int, int] | None
    n_evaluations: int
    units: UnitSystem

    def display_rows(self) -> Rows:
        """See Displayed."""
        units = self.units
        shown = units.shown
        none = "none: nothing oscillates in this state"
        if self.frequency == 0.0 and self.recommended == inf:
            return [("stiffest mode", f"{none}, so it sets no limit to the time step")]
        recommended = shown(self.recommended)
        by_heat = "collisions of Lennard-Jones atoms"
        of_limit = ""
        if self.frequency:
            of_limit = f": {abs(self.timestep or 0) / self.limit:.3g} of the limit"
            omega = f"{self.frequency / units.to_picosecond:.4g} / {units.shown_time}"
            blow_up = (
                "longer steps blow up; with hot atoms, somewhat shorter steps may blow up, too"
            )
            per_period = f"{self.period / self.recommended:.3g} steps a period"
            rows = [
                ("stiffest mode", f"ω = {omega}, period {shown(self.period)}"),
                ("", self._motion),
                ("limit", f"{shown(self.limit)} for {self.method}: {blow_up}"),
                ("recommended", f"{recommended}: {per_period}"),
            ]
            if self.collision < self.harmonic:
                heat = f"{self.temperature:.3g} {units.temperature}" if self.temperature else "rest"
                hotter = f"or at the temperature of the velocities if that is higher (now: {heat})"
                limits = f"{by_heat} in a liquid at k_B T up to {COLDEST:.2g} ε, {hotter}"
                alone = f"the stiffest mode of this state alone would allow {shown(self.harmonic)}"
                rows += [("decided by", limits), ("", alone)]
            else:
                rows.append(("decided by", "the stiffest mode"))
        else:
            rows = [("stiffest mode", none), ("recommended", f"{recommended}: set by {by_heat}")]
        if self.timestep is not None:
            rows.append(("given", f"{shown(self.timestep)}{of_limit}"))
        return rows

    @property
    def _motion(self) -> str:
        """Which atoms move in the stiffest mode."""
        each = zip(self.atoms, self.shares, strict=True)
        shares = ", ".join(f"{atom} ({100.0 * share:.0f} %)" for atom, share in each)
        if self.bond is not None:
            i, j = self.bond
            return f"the bond of atoms {i} and {j}: {shares} of the kinetic energy"
        mostly = f"mostly of atoms {shares}, " if shares else ""
        return f"{mostly}spread over some {self.n_moving:.3g} atoms"


def advise_timestep(
    system: AnySystem,
    potentials: Potential | Sequence[Potential],
    constraints: Constraint | Sequence[Constraint] | None = None,
    method: Splitting | type[Splitting] = VelocityVerlet,
) -> StepAdvice:
    """How long a time step may be: by the highest frequency of the weighted Hessian M^−1/2 H M^−1/2 of this state.

        limit = h_max/ω, h_max = 2 for velocity Verlet; recommended = h/ω with (E_max − E_min)/(E_max + E_min) = 1/80
        for the mode, which velocity Verlet has at h²/8 ≈ 1/80, 20 steps a period; order_conditions has other methods.

    The Hessian is never built: Lanczos iterations need only its products with vectors, central differences of the
    forces. With constraints the modes are those of the allowed directions, and their curvature counts too.

    In a run at a finite temperature, atoms come closer to each other than in a crystal or at a minimum, and the forces
    are stiffer there. For Lennard-Jones atoms the recommended step therefore is at most h/ω′ of atoms that collide in a
    liquid, at the temperature of the velocities of the state, or k_B T = 0.84 ε if they are colder.
    For other laws ask again with a state from the run.

    Forces that jump at the cutoff ("truncated", "shifted") have no Hessian there; the jumps are left out
    unless the distance of a pair agrees with the cutoff to six digits.

    Parameters
    ----------
    system : the state, System or ase.Atoms.
    potentials : one or several.
    constraints : as for Simulation; those of the system if not given.
    method : a splitting, such as VelocityVerlet; or one with its time step, which is then compared with the advice.

    Raises
    ------
    NonFiniteError : if the forces are not finite.
    TypeError, ValueError : as Simulation.
    """
    kind: type = method if isinstance(method, type) else type(method)
    if not issubclass(kind, Splitting):
        wanted = "a splitting, such as VelocityVerlet or VelocityVerlet(0.005)"
        raise TypeError(f"method must be {wanted}; got {shown(method)}")
    system = system.copy() if isinstance(system, System) else System.from_ase(system)
    if constraints is None:
        constraints = system.constraints
    constraint_set = ConstraintSet(system, constraints)
    forces = Forces(system, potentials)
    forces.warn_of_potentials()
    return _advice(forces, constraint_set, method)


def advice_at(
    engine: Engine, potentials: Sequence[Potential], seconds: float, at_rest: bool, is_rough: bool
) -> StepAdvice | None:
    """advise_timestep for the present state of an engine, which is left as it is; None if that would take longer.
    potentials : all of the engine, or some.
    seconds : it may take at most, some.
    is_rough : whether ω may be off by a hundredth.
    at_rest : whether velocities are left out: those of a failed run are no temperature.
    Raises NonFiniteError as advise_timestep, and whatever a potential raises."""
    system = engine.system.copy()
    forces = Forces(system, potentials, engine.interactions.options)
    forces.compute()  # compiles
    pace = min(repeat(forces.compute, number=1, repeat=3))
    accuracy, n_evaluations = (ROUGH, FEW_EVALUATIONS) if is_rough else (ACCURACY, EVALUATIONS)
    if pace * min(2 * system.positions.size, n_evaluations) > seconds:
        return None
    if at_rest:
        system.velocities[:] = 0.0
    return _advice(forces, ConstraintSet(system, engine.constraints), engine.method, accuracy)


def _advice(
    forces: Forces,
    constraint_set: ConstraintSet,
    method: Splitting | type[Splitting],
    accuracy: float = ACCURACY,
) -> StepAdvice:
    system = forces.system
    stiffness = Stiffness(system, forces.potentials, constraint_set)
    curvature = Curvature(forces, constraint_set)
    square = nan
    if curvature.is_finite:
        square, mode = curvature.stiffest(curvature.guess(stiffness.stiffest_bond), accuracy)
    if not np.isfinite(square):
        why = why_not_finite(system, forces.potentials)
        raise NonFiniteError(f"the forces around this state are not finite: {why}")
    if not square > curvature.rounding:
        square = 0.0
        mode = np.zeros_like(mode)
    frequency = square**0.5
    row = method.sequence()
    shares = np.einsum("ij,ij->i", mode, mode)
    leading = np.argsort(-shares, kind="stable")[:SHOWN_ATOMS]
    atoms = leading[shares[leading] >= SHOWN_SHARE]
    collides = len(system) > 1 and (frequency > 0.0 or system.velocities.any())
    colliding = stiffness.collisions() if collides else 0.0
    timestep_of = method.timestep_of if isinstance(method, Splitting) else float
    harmonic = timestep_of(accurate_step(row, OSCILLATION) / frequency) if frequency else inf
    step = accurate_step(outer_substeps(row), OSCILLATION)
    collision = timestep_of(step / colliding) if colliding else inf
    # the bond whose stretching by itself makes up more than half of the mode
    bonds = [law.groups_in(system) for law in forces.potentials if isinstance(law, Bond)]
    pairs = np.concatenate([system.bonds, *bonds])
    near = pairs[np.isin(pairs, np.argsort(-shares)[:SHOWN_ATOMS]).all(axis=1)]
    parts = np.einsum("bij,ij->b", curvature.stretching(near), mode) ** 2
    bond = tuple(near[np.argmax(parts)].tolist()) if parts.max(initial=0.0) > HALF else None
    return StepAdvice(
        frequency=frequency,
        period=2.0 * pi / frequency if frequency else inf,
        limit=timestep_of(stability_limit(row) / frequency) if frequency else inf,
        harmonic=harmonic,
        collision=collision,
        recommended=min(harmonic, collision),
        temperature=stiffness.temperature,
        method=method.name,
        timestep=method.timestep if isinstance(method, Splitting) else None,
        atoms=tuple(atoms.tolist()),
        shares=tuple(shares[atoms].tolist()),
        n_moving=float(1.0 / (shares**2).sum()) if shares.any() else nan,
        bond=bond,
        n_evaluations=forces.n_evaluations,
        units=system.units,
    )
