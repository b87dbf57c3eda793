"""One judge of a scene: hints before a run, faults during it, causes after it has failed. All are rows of RULES.

A rule looks at the evidence and gives a verdict, or None. Of the rules of one kind only the first that speaks counts.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from minimd.core.diagnosis.stiffness import Stiffness
from minimd.core.diagnosis.timestep import OSCILLATION, StepAdvice, advice_at
from minimd.core.engine.cell_rescaling import EVAPORATED
from minimd.core.engine.engine import Engine, Snapshot
from minimd.core.forces.contacts import OPEN_IT, Contact, contacts, thin_cell
from minimd.core.integrators.order_conditions import accurate_step, stability_limit
from minimd.core.neighbors.queries import ClosestPair, closest_pair
from minimd.core.potentials.bonded import HarmonicBond
from minimd.core.potentials.coulomb import SUMS, Coulomb
from minimd.core.potentials.pair import Nonbonded
from minimd.core.structure.bond_graph import among
from minimd.core.structure.checks import LARGEST
from minimd.core.structure.constraints import DistanceConstraints
from minimd.core.structure.observables import (
    absolute_momentum,
    largest_component,
    leaves_out_center,
    longest,
)
from minimd.core.structure.system import System, changed
from minimd.core.structure.units import ASE, BAR
from minimd.core.structure.vectors import Array

# before
# of the relaxation time of a barostat, between two strains: fluctuations are then wrong by up to a tenth
QUICK = 0.1
CRUSHING = 0.5  # eV/Å³: 80 GPa, far more than a Lennard-Jones solid is good for
# Δt·ω of 20 steps a period: velocity Verlet's energy oscillates by (Δt·ω)²/8
USUAL = (8.0 * OSCILLATION) ** 0.5
TOO_SHORT = 0.001  # of the usual step
# likewise: a step below this is no error of the unit, somebody wants atoms that stand still
MEANT = 1e-30
EMPTY = 0.25  # of the height of a cell: atoms with a wider gap, in one direction, are a slab
WIDER = 2.0  # times the second gap: layers of a small crystal are as far apart
ROUNDING = 1e-12  # of a fractional coordinate
POLAR = 0.05  # of the rms force: a smaller one, of the images of a slab, is not told
FLAT = 1e-10  # of their extent: how far from a plane atoms may lie, and move in a step, by rounding
# of Σ|mv|: a smaller total momentum is rounding, of files with six digits or in single precision
MOVING = 1e-6
TOO_LONG = 3.3  # times the recommended step: six steps in a period of that mode
# during
# growth of the energies: an unstable mode passes it within a few hundred steps, a stable run never does
RUNAWAY = 1e4
GROWTH = 2.0  # the same in a run that is known to have run away: states beyond it are not good
HALF = 0.5  # of the energies: if energy is exchanged and not created, the sum changes by much less
# after
OVERLAP = 0.8  # of σ; thermal collisions of a liquid at k_B T = ε end at 0.85 σ
# of its distance: a pair that a force moves farther in one step overlaps; for laws without a length of their own
THROWN = 0.1
# of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
HOT_STEP = 0.05
# times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
HOT_SPOT = 6.0
# of ωσ at the minimum of a pair: higher speeds are due to heat, k_B T > 3 ε; at lower ones the step is too long
FAST = 0.3
# of the longest stable step: collisions are that much stiffer than the state itself
NEAR_LIMIT = 0.5
ADVICE_SECONDS = 10.0  # at most, for the search of the stiffest mode
CHECK_STEP = "take the time step that advise_timestep recommends, and check its unit"
HALVE = "halve the timestep until the energy is conserved"


class Failure(NamedTuple):
    """How a run failed.  fault : in words.  step : in which.  constraint : atoms of one that could not be kept.
    at : (N, 3), positions at that moment, or None.  start : the earlier state that is known.
    is_first : whether no step led to it.  first_volume : when the simulation was made [length³], or None.
    is_of_barostat : whether the barostat has refused to go on."""

    fault: str
    step: int
    constraint: tuple[int, int] | None
    at: Array | None
    start: Snapshot
    is_first: bool
    first_volume: float | None = None
    is_of_barostat: bool = False


class Verdict(NamedTuple):
    """cause, advice : in words.  pair : to blame, or None."""

    cause: str
    advice: str = ""
    pair: Contact | None = None

    def __str__(self) -> str:
        return f"{self.cause}; {self.advice}"


class Rule(NamedTuple):
    """when : BEFORE, DURING or AFTER.  kind : for programs.  speaks : gives a verdict on evidence, or None."""

    when: str
    kind: str
    speaks: Callable[["Evidence"], Verdict | None]


class Evidence:
    """What is known about a scene, and about its failure if it has failed; computed when it is first asked for.
    engine : in its present state, after a failure the last good one, with energies of single atoms (PER_ATOM)."""

    def __init__(self, engine: Engine, failure: Failure | None = None) -> None:
        self.engine, self.system, self.units = engine, engine.system, engine.system.units
        self.failure: Any = failure  # None if nothing has failed
        self.timestep = abs(engine.method.timestep)
        self.shown = self.units.shown

    @cached_property
    def fastest(self) -> tuple[int, float]:
        """The fastest atom and its speed; see longest."""
        return longest(self.system.velocities)

    @cached_property
    def limit(self) -> float:
        """The largest stable Δt·ω of the method."""
        return stability_limit(self.engine.method.sequence())

    @cached_property
    def stiffness(self) -> Stiffness:
        """Of the scene."""
        return Stiffness(
            self.system, self.engine.interactions.potentials, self.engine.constraint_set
        )

    @cached_property
    def closest(self) -> ClosestPair | None:
        """The closest two atoms and their distance; None if there are no two."""
        return closest_pair(self.system)

    @cached_property
    def suspects(self) -> list[int]:
        """The atoms on which the largest force acts, the fastest one, the closest two, those without finite numbers."""
        engine = self.engine
        pair = self.closest[:2] if self.closest else ()
        is_finite = np.isfinite(engine.forces).all(axis=1) & np.isfinite(engine.sums.energies)
        known = (
            longest(engine.forces)[0],
            longest(engine.velocities)[0],
            *pair,
            *(self.failure.constraint or ()),
        )
        return [*known, *np.flatnonzero(~is_finite)[:2].tolist()]

    @cached_property
    def failed(self) -> System | None:
        """The system at the moment of the failure, if its positions are numbers."""
        at = self.failure.at
        return None if at is None or not (np.abs(at) <= LARGEST).all() else self.moved(at)

    @cached_property
    def found(self) -> list[Contact]:
        """Contacts of the suspects in the last good state, and those without a finite force when it failed."""
        later = [] if self.failed is None else self.contacts(self.failed, self.suspects)
        return self.contacts(self.system, self.suspects) + [
            one for one in later if not one.is_finite
        ]

    @cached_property
    def met(self) -> Contact | None:
        """The strongest contact of the closest pair when it failed."""
        closest = closest_pair(self.failed) if self.failed is not None else None
        return (
            None
            if self.failed is None
            else strongest(self.contacts(self.failed, [*(closest or ())[:2]]))
        )

    @cached_property
    def strongest(self) -> Contact | None:
        """The contact with the largest force."""
        return strongest(self.found)

    @cached_property
    def advice(self) -> StepAdvice | None:
        """Advice on the time step for the last good state; None if it takes too long or fails."""
        try:
            return advice_at(self.engine, ADVICE_SECONDS)
        except Exception:
            # whatever a term of the user's own raises: the failure itself must be told
            return None

    @property
    def recommended(self) -> str:
        """What advise_timestep recommends for the last good state."""
        if self.advice is None or not self.advice.frequency:
            return "take a shorter timestep, such as advise_timestep recommends"
        return f"take {self.shown(self.advice.recommended)}, as advise_timestep recommends for the last good state"

    def usual_step(self, at_rest: bool = False) -> float:
        """A time step with 20 steps in a period of harmonic bonds and of collisions of Lennard-Jones atoms, see
        Stiffness.collisions; ∞ without both [time]."""
        bond = self.stiffness.bond
        fastest = max(self.stiffness.collisions(at_rest), sqrt(bond.square) if bond else 0.0)
        return USUAL / fastest if fastest else float("inf")

    @property
    def shorter(self) -> str:
        """Advice for a time step that is too long for two atoms that meet."""
        usual = self.usual_step(at_rest=True)
        return (
            f"take {self.shown(usual)} or less, and {HALVE}"
            if usual < 0.5 * self.timestep
            else HALVE
        )

    def contacts(self, system: System, atoms: list[int]) -> list[Contact]:
        """The contacts of some atoms in some state."""
        return contacts(
            system,
            self.engine.interactions.potentials,
            self.engine.constraint_set.inverse_masses,
            atoms,
        )

    def moved(self, positions: Array) -> System:
        """A system at rest with its atoms elsewhere: the velocities of a failed run may be infinite."""
        return changed(self.system, positions=positions, velocities=None)


def strongest(found: list[Contact]) -> Contact | None:
    """The contact with the largest finite force, or None."""
    return max(
        (one for one in found if one.is_finite), key=lambda one: abs(one.force), default=None
    )


def strange_depth(evidence: Evidence) -> Verdict | None:
    """An ε in another unit."""
    depth = evidence.stiffness.strange_depth
    return None if depth is None else Verdict(*depth)


def longer_than_a_bond(evidence: Evidence) -> Verdict | None:
    """A time step longer than a harmonic bond allows. Other forces may allow still less."""
    bond = evidence.stiffness.bond
    shown = evidence.shown
    method = evidence.engine.method.name
    if bond is None or evidence.timestep <= (limit := evidence.limit / sqrt(bond.square)):
        return None
    is_longer = f"timestep {shown(evidence.timestep)} is longer than the bond of atoms {bond.i} and {bond.j} allows"
    return Verdict(
        f"{is_longer}: for this bond {method} is stable up to {shown(limit)}", CHECK_STEP
    )


def longer_than_collisions(evidence: Evidence) -> Verdict | None:
    """Collisions of Lennard-Jones atoms that are faster than the method can follow: for atoms of a liquid; the step
    told is for their heat."""
    fastest = evidence.stiffness.collisions(at_rest=True)
    method = evidence.engine.method
    shown = evidence.shown
    if not fastest * evidence.timestep > TOO_LONG * OSCILLATION**0.5:
        return None  # spares usual steps the search for what the method can do
    step = accurate_step(method.sequence(), OSCILLATION)
    # 0: of a method without kicks
    if step == 0.0 or evidence.timestep <= TOO_LONG * step / fastest:
        return None
    is_long = (
        f"timestep {shown(evidence.timestep)} is long for Lennard-Jones atoms as light as these"
    )
    recommended = shown(step / evidence.stiffness.collisions())
    return Verdict(
        f"{is_long}: in a liquid {method.name} conserves the energy with steps up to {recommended}",
        CHECK_STEP,
    )


def short_step(evidence: Evidence) -> Verdict | None:
    """A time step far shorter than the harmonic bonds and the collisions of Lennard-Jones atoms need."""
    if not all(
        isinstance(one, Nonbonded | HarmonicBond) for one in evidence.engine.interactions.potentials
    ):
        return None  # others may be stiffer
    usual = evidence.usual_step()
    shown = evidence.shown
    if not MEANT * usual < evidence.timestep < TOO_SHORT * usual:
        return None
    is_short = f"timestep {shown(evidence.timestep)} is far shorter than these atoms need"
    unit = f"check the unit of the time step{', such as 5 * md.units.fs' * (evidence.units == ASE)}"
    return Verdict(
        f"{is_short}: with {shown(usual)} the fastest motion has 20 steps per period", unit
    )


def no_pair_in_reach(evidence: Evidence) -> Verdict | None:
    """No pair interacts, as when lengths of the potential and of the positions have different units."""
    interactions = evidence.engine.interactions
    unit = evidence.units.length
    cutoffs = [
        one.cutoff
        for one in interactions.potentials
        if isinstance(one, Nonbonded) and one.cutoff < np.inf
    ]
    if not cutoffs or evidence.engine.potential_energy != 0.0 or evidence.engine.forces.any():
        return None
    if evidence.closest is None or evidence.closest.distance <= max(cutoffs):
        return None
    first, second, distance = evidence.closest[:3]
    apart = f"the closest atoms, {first} and {second}, are {distance:.3g} {unit} apart"
    cause = f"no two atoms are within the cutoff, {max(cutoffs):g} {unit}: {apart}"
    return Verdict(cause, f"check that the lengths of the potential are in {unit}")


def slow_barostat(evidence: Evidence) -> Verdict | None:
    """A barostat that acts too seldom for its relaxation time."""
    barostat = evidence.engine.barostat
    shown = evidence.shown
    every = 0.0 if barostat is None else barostat.every * evidence.engine.method.timestep
    if barostat is None or every <= QUICK * barostat.relaxation_time:
        return None
    acts = (
        f"the barostat acts every {barostat.every} steps, {shown(every)}, which is too long for its"
    )
    cause = (
        f"{acts} relaxation_time {shown(barostat.relaxation_time)}: the volume fluctuates too much"
    )
    return Verdict(
        cause, f"take a relaxation_time of at least {shown(every / QUICK)}, or a smaller every"
    )


def crushing_pressure(evidence: Evidence) -> Verdict | None:
    """A pressure in eV/Å³ that is a number in bar or so."""
    barostat = evidence.engine.barostat
    if barostat is None or evidence.units != ASE or abs(barostat.pressure) <= CRUSHING:
        return None
    p = barostat.pressure
    unit = evidence.units.pressure
    meant = f"if {p:g} bar is meant, give {p:g} * md.units.BAR, and the compressibility per BAR"
    return Verdict(f"pressure {p:g} {unit} is {p / BAR:.2g} bar", meant)


def moving_center(evidence: Evidence) -> Verdict | None:
    """A center of mass that moves, although its motion is no degree of freedom."""
    system = evidence.system
    units = evidence.units
    speed = float(np.linalg.norm(evidence.engine.drift))
    if not speed * system.masses.sum() > MOVING * absolute_momentum(
        system.velocities, system.masses
    ):
        return None
    moves = f"the center of mass moves at {speed / units.to_picosecond:.3g} {units.length}/{units.shown_time}"
    cause = f"{moves}: temperature, pressure, diffusion and viscosity leave this motion out"
    return Verdict(cause, "stop it with sim.velocities -= sim.drift")


def flat_motion(evidence: Evidence) -> Verdict | None:
    """Atoms that lie and move in one plane, or on one line: fewer degrees of freedom move than are counted."""
    engine = evidence.engine
    dt = evidence.timestep
    inverse_masses = evidence.engine.constraint_set.inverse_masses
    accelerations = engine.forces * inverse_masses[:, None]
    moves = np.array([engine.positions, dt * engine.velocities, dt * dt * accelerations])[
        :, inverse_masses > 0.0
    ]
    if moves.shape[1] < 3 or not moves[1].any() or not np.isfinite(moves).all():
        return None
    moves[0] -= moves[0, 0].copy()
    moves /= largest_component(moves)  # squares of forces of any size are finite
    n_flat = 3 - int(np.linalg.matrix_rank(moves.reshape(-1, 3), FLAT * np.linalg.norm(moves)))
    n_atoms = moves.shape[1]
    n_dof = engine.n_dof
    n_moving = n_dof - n_flat * (n_atoms - leaves_out_center(n_atoms, engine.conserves_momentum))
    if not 0 < n_moving < n_dof:
        return None
    where = ("in one plane", "on one line")[n_flat - 1]
    times = f"{n_dof / n_moving:.4g} times"
    cause = f"all atoms lie and move {where}: {n_moving} of the {n_dof} degrees of freedom that are counted move"
    return Verdict(
        cause,
        f"their temperature is {times} the one shown; velocities in all directions have all of them",
    )


def polar_slab(evidence: Evidence) -> Verdict | None:
    """A slab with a dipole, whose periodic images make a field in it: E = 4π k_e |Σ q z| / V (tin-foil)."""
    engine = evidence.engine
    system = evidence.system
    cell = evidence.system.cell
    has_sum = any(
        isinstance(one, Coulomb) and one.method in SUMS for one in engine.interactions.potentials
    )
    if not has_sum or cell.volume is None or system.net_charge:
        return None
    inverse = np.linalg.inv(cell.vectors)
    fractions = np.sort(system.positions @ inverse % 1.0, axis=0)
    gaps = np.diff(fractions, axis=0, append=fractions[:1] + 1.0)
    second, widest = np.sort(gaps, axis=0)[-2:]
    is_open = widest > np.maximum(EMPTY, WIDER * second)
    if is_open.sum() != 1:
        return None
    axis = int(np.argmax(is_open))
    first = fractions[np.argmax(gaps[:, axis]) - len(system) + 1, axis]  # the atom above the gap
    heights = (
        (system.positions @ inverse[:, axis] - first + ROUNDING)
        % 1.0
        / np.linalg.norm(inverse[:, axis])
    )
    dipole = abs(float(system.charges @ heights))
    field = 4.0 * pi * evidence.units.coulomb * dipole / cell.volume
    if field * np.linalg.norm(system.charges) <= POLAR * np.linalg.norm(engine.forces):
        return None
    normal = f"the normal of the slab, across {'abc'[axis]}"
    cause = f"the atoms are a slab with a dipole of {dipole:.3g} e {evidence.units.length} along {normal}"
    share = f"its periodic images make a field of {field:.3g} {evidence.units.energy}/(e {evidence.units.length}) in it"
    return Verdict(
        f"{cause}: {share}",
        "give the slab two like faces, or a second slab, turned over, in the same cell",
    )


def own_images(evidence: Evidence) -> Verdict | None:
    """Atoms that are pushed by their own images, as in a cell of two dimensions that is left periodic."""
    cause = thin_cell(evidence.system, evidence.engine.interactions.potentials)
    return Verdict(cause, OPEN_IT) if cause else None


def not_numbers(evidence: Evidence) -> Verdict | None:
    """Positions or velocities that are not finite."""
    system = evidence.system
    for name, array, (_, length) in (
        ("positions", system.positions, longest(system.positions)),
        ("velocities", system.velocities, evidence.fastest),
    ):
        if not length <= LARGEST:
            bad = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
            if bad.size:
                which = f"(atom {bad[0]}{' ...' if bad.size > 1 else ''})"
                return Verdict(
                    f"{name} of {bad.size} atoms are not finite, or larger than {LARGEST:g} {which}"
                )
    return None


def past_neighbors(evidence: Evidence) -> Verdict | None:
    """An atom that moves farther than the largest cutoff in one step has passed its neighbors unseen."""
    atom, speed = evidence.fastest
    distance = speed * evidence.timestep
    cutoff = evidence.engine.interactions.largest_cutoff
    if not distance > cutoff:
        return None
    moves = f"atom {atom} moves {distance:.3g} {evidence.units.length} in one step"
    return Verdict(f"{moves}, past every neighbor (cutoff {cutoff:g})")


def thrown_at_start(evidence: Evidence) -> Verdict | None:
    """Accelerations that are not finite or throw atoms across the scene in the first step."""
    engine = evidence.engine
    sizes = np.sqrt(np.einsum("ij,ij->i", engine.forces, engine.forces))
    # |F|/m, without a warning of an overflow
    accelerations = np.einsum("i,i->i", engine.constraint_set.inverse_masses, sizes)
    atom = int(np.argmax(accelerations))
    distance = float(accelerations[atom]) * evidence.timestep**2
    if not (np.isfinite(distance) and np.isfinite(engine.potential_energy)):
        return Verdict("forces or energies are not finite")
    if distance <= engine.interactions.largest_cutoff:
        return None
    return Verdict(
        f"the force on atom {atom} would move it by {distance:.3g} {evidence.units.length} in one step"
    )


def law_without_number(evidence: Evidence) -> Verdict | None:
    """A law of the user's, or a table, that is not finite at some distance."""
    for one in evidence.found:
        if not one.is_finite and not is_overlap(one) and (one.is_users or one.is_bond):
            return Verdict(one.without_number(evidence.units.length), one.cure, one)
    return None


def overlap_at_start(evidence: Evidence) -> Verdict | None:
    """The closest pair of a state to which no step led, if its atoms are on top of each other."""
    step = evidence.failure.start.step
    start = evidence.moved(evidence.failure.start.positions)
    closest = closest_pair(start) if evidence.failure.is_first else None
    # these are close by right
    joined = [
        start.bonds,
        *(one.pairs for one in start.constraints if isinstance(one, DistanceConstraints)),
    ]
    if closest is None or among(np.array([closest[:2]]), np.concatenate(joined)).any():
        return None
    found = evidence.contacts(start, list(closest[:2]))
    over = [
        one for one in found if not one.is_bond and (is_overlap(one) or is_thrown(one, evidence))
    ]
    if not over:
        return None
    worst = min(over, key=lambda one: one.distance)
    at = f"step {step}" if step else "the start"
    cause = f"{worst.atoms} overlap at {at}, {worst.apart(evidence.units.length)}"
    return Verdict(
        cause, "move the atoms apart with minimize, or start from a state with less energy", worst
    )


def one_place(evidence: Evidence) -> Verdict | None:
    """Two atoms, bonded ones among them, at the same place: no law gives a direction there."""
    pair = evidence.closest
    if (
        pair is None
        or pair.distance > 0.0
        or np.isfinite(evidence.engine.forces[list(pair[:2])]).all()
    ):
        return None
    cause = f"atoms {pair.first} and {pair.second} are at the same place, where the force between them is not defined"
    return Verdict(cause, "move them apart with minimize, or remove one of them")


def barostat(evidence: Evidence) -> Verdict | None:
    """A barostat that cannot go on, or that has made a gas of what was dense."""
    bath = evidence.engine.barostat
    volume = evidence.system.volume
    before = evidence.failure.first_volume
    if bath is None or not volume or not before:
        return None
    at = f"at pressure {bath.pressure:.3g} {evidence.units.pressure}"
    unit = evidence.units.volume
    if volume > EVAPORATED * before:
        cause = f"the cell has grown from {before:.4g} to {volume:.4g} {unit} {at}: the atoms have evaporated"
        return Verdict(cause, "take a higher pressure, or a lower temperature")
    if not evidence.failure.is_of_barostat:
        return None
    was = f"its volume is {volume:.4g} {unit}, and was {before:.4g} {unit} when the simulation was made"
    first = "equilibrate at constant volume first, take a longer relaxation_time, or check the unit of the pressure"
    return Verdict(f"{at} the barostat strains the cell too fast: {was}", first)


def broken_constraint(evidence: Evidence) -> Verdict | None:
    """A constraint that the solver could not keep."""
    if evidence.failure.constraint is None:
        return None
    i, j = evidence.failure.constraint
    far = f"atoms {i} and {j} move too far for the constraint between them"
    advice = "reduce the timestep, or check whether the constraints contradict each other"
    return Verdict(
        f"in one step of {evidence.shown(evidence.timestep)} {far}", advice, evidence.strongest
    )


def unstable_bond(evidence: Evidence) -> Verdict | None:
    """A bond whose Δt·ω is beyond the limit of the method."""
    bonds = [
        (one.frequency * evidence.timestep, one)
        for one in evidence.found
        if one.is_bond and one.frequency
    ]
    x, stiffest = max(bonds, key=lambda bond: bond[0], default=(0.0, None))
    if stiffest is None or x <= evidence.limit:
        return None
    beyond = f"Δt·ω = {x:.3g} (stable up to {evidence.limit:.3g})"
    cause = f"timestep {evidence.shown(evidence.timestep)} too large for the bond of {stiffest.atoms}: {beyond}"
    return Verdict(cause, f"{evidence.recommended}; or hold the bond rigid", stiffest)


def bottomless_law(evidence: Evidence) -> Verdict | None:
    """A law that attracts ever more strongly the closer two atoms come."""
    pair = evidence.strongest
    units = evidence.units
    if pair is None or not pair.sinks:
        return None
    fall = f"u = {pair.energy:.3g} {units.energy}, and less at shorter distances: the atoms fall into each other"
    cause = f"the law of {pair.law} attracts {pair.atoms}, {pair.apart(units.length)}; {fall}"
    return Verdict(cause, "give the law a repulsive core; a shorter timestep does not help", pair)


def law_on_a_constraint(evidence: Evidence) -> Verdict | None:
    """A pair law that acts most strongly between two atoms whose distance is held."""
    pair = evidence.strongest
    bonds = evidence.engine.constraint_set.bonds
    if pair is None or pair.is_bond or bonds is None:
        return None
    is_held = among(np.array([[pair.first, pair.second]]), bonds.pairs).any()
    if not is_held or not (is_overlap(pair) or is_thrown(pair, evidence)):
        return None
    cause = f"{pair.law} acts between {pair.atoms}, although a constraint holds their distance"
    advice = (
        "give bonds=... to the system and bonded_scale=(0, 1, 1) to the potential, or exclusions"
    )
    return Verdict(f"{cause}, {pair.apart(evidence.units.length)}", advice, pair)


def too_hot(evidence: Evidence) -> Verdict | None:
    """Atoms, all or one of them, that were too fast before anything had gone wrong."""
    pairs = [one for one in evidence.found if one.ratio and not one.is_bond]
    if not pairs:
        return None
    engine = evidence.engine
    dt = evidence.timestep
    units = evidence.units
    velocities = evidence.failure.start.velocities
    sigma = min(one.distance / one.ratio for one in pairs if one.ratio)
    fast = sigma * max(HOT_STEP / dt, FAST * max(one.rest_frequency or 0.0 for one in pairs))
    squares = np.einsum("ij,ij->i", velocities, velocities)
    atom = int(np.argmax(squares))
    n_moving = len(squares) - engine.constraint_set.n_fixed
    total = squares.sum()
    n_others = max(1, n_moving - 1)
    speed, mean, others = np.sqrt(
        [squares[atom], total / n_moving, (total - squares[atom]) / n_others]
    )
    passes = f"atom {atom} moves {speed * dt / sigma:.2g} σ in a step"
    if mean > fast and speed <= HOT_SPOT * others:
        hot = engine.constraint_set.temperature(
            velocities, evidence.system, engine.conserves_momentum
        )
        passes = f"at {hot:.3g} {units.temperature} {passes}"
    elif speed > max(fast, HOT_SPOT * others):
        passes += (
            f", {speed / others:.2g} times as fast as the others"
            if others > 0.0
            else ", the only one in motion"
        )
    else:
        return None
    cause = f"atoms too hot, or timestep {evidence.shown(dt)} too large: {passes}"
    advice = "start at a lower temperature, or reduce the timestep in proportion to the speed"
    return Verdict(cause, advice, evidence.strongest)


def collision_in_a_step(evidence: Evidence) -> Verdict | None:
    """Two atoms that the step that failed has brought together, where before it no pair was stiff."""
    met = evidence.met
    limit = evidence.limit
    dt = evidence.timestep
    before = max((one.frequency or 0.0 for one in evidence.found), default=0.0)
    if met is None or before * dt > NEAR_LIMIT * limit or not (met.frequency or 0.0) * dt > limit:
        return None
    there = f"{met.apart(evidence.units.length)}{met.stiffness(dt)}"
    drives = f"step {evidence.failure.step} drives {met.atoms} into each other, {there}"
    return Verdict(f"timestep {evidence.shown(dt)} too large: {drives}", evidence.shorter, met)


def unstable_mode(evidence: Evidence) -> Verdict | None:
    """A time step near the limit of the stiffest mode, where no pair is known."""
    advice = evidence.advice if evidence.strongest is None else None
    dt = evidence.timestep
    shown = evidence.shown
    if advice is None or not advice.frequency or dt <= NEAR_LIMIT * advice.limit:
        return None
    where = f"{advice.method} is stable up to {shown(advice.limit)} for the stiffest mode of the last good state"
    closer = "; if atoms come closer, only shorter steps are stable" if dt <= advice.limit else ""
    return Verdict(f"timestep {shown(dt)} too large: {where}{closer}", evidence.recommended)


def unknown_forces(evidence: Evidence) -> Verdict | None:
    """No pair with a known law pushes the atoms."""
    if evidence.strongest is not None:
        return None
    cause = "atoms fly apart although no pair with a known law pushes them: the forces come from another potential"
    return Verdict(cause, "examine the forces of each potential in the last good state")


def long_step(evidence: Evidence) -> Verdict | None:
    """What is left: the pair with the largest force."""
    pair = evidence.strongest
    dt = evidence.timestep
    if pair is None:
        return None
    what = f"{'bond' if pair.is_bond else 'pair'} of {pair.atoms}"
    where = f"{pair.apart(evidence.units.length)}{pair.stiffness(dt)}"
    return Verdict(
        f"timestep {evidence.shown(dt)} too large for the {what}, {where}", evidence.shorter, pair
    )


BEFORE = "before"
DURING = "during"
START = "start"
AFTER = "after"
RULES = (
    Rule(BEFORE, "long step", strange_depth),
    Rule(BEFORE, "long step", longer_than_a_bond),
    Rule(BEFORE, "long step", longer_than_collisions),
    Rule(BEFORE, "short step", short_step),
    Rule(BEFORE, "reach", no_pair_in_reach),
    Rule(BEFORE, "barostat", slow_barostat),
    Rule(BEFORE, "pressure", crushing_pressure),
    Rule(BEFORE, "center", moving_center),
    Rule(BEFORE, "plane", flat_motion),
    Rule(BEFORE, "slab", polar_slab),
    Rule(BEFORE, "thin", own_images),
    Rule(START, "start", thrown_at_start),
    Rule(DURING, "number", not_numbers),
    Rule(DURING, "neighbors", past_neighbors),
    Rule(AFTER, "law", law_without_number),
    Rule(AFTER, "overlap", overlap_at_start),
    Rule(AFTER, "overlap", one_place),
    Rule(AFTER, "barostat", barostat),
    Rule(AFTER, "law", law_on_a_constraint),
    Rule(AFTER, "constraint", broken_constraint),
    Rule(AFTER, "bond", unstable_bond),
    Rule(AFTER, "law", bottomless_law),
    Rule(AFTER, "hot", too_hot),
    Rule(AFTER, "pair", collision_in_a_step),
    Rule(AFTER, "step", unstable_mode),
    Rule(AFTER, "law", unknown_forces),
    Rule(AFTER, "pair", long_step),
)


def verdicts(evidence: Evidence, *when: str) -> Iterator[tuple[str, Verdict]]:
    """The verdicts of the rules of some times, each with its kind, in the order of RULES."""
    for rule in RULES:
        if rule.when in when and (verdict := rule.speaks(evidence)) is not None:
            yield rule.kind, verdict


def hints(engine: Engine) -> Iterator[str]:
    """Sentences about energies, time step and lengths; none if there is nothing to say. The forces must be current."""
    told: set[str] = set()
    for kind, verdict in verdicts(Evidence(engine), BEFORE):
        if kind not in told and not (kind == "short step" and "long step" in told):
            yield str(verdict)
        told.add(kind)


def too_long_a_step(engine: Engine) -> str | None:
    """A clause if the time step is longer than a harmonic bond allows, or far longer than suits Lennard-Jones atoms;
    of ε if that is in another unit. None if neither."""
    evidence = Evidence(engine)
    found = next((one for kind, one in verdicts(evidence, BEFORE) if kind == "long step"), None)
    # the hint has said the rest
    is_told = found and (found.advice == CHECK_STEP or found == strange_depth(evidence))
    return found and (found.cause if is_told else str(found))


def fault_of(engine: Engine, *when: str) -> str | None:
    """What is impossible about positions and velocities; None if they are possible.
    when : START to ask for the first step, too."""
    return next((verdict.cause for _, verdict in verdicts(Evidence(engine), DURING, *when)), None)


def runaway(
    engine: Engine,
    first: Mapping[str, float],
    growth: float = RUNAWAY,
    since: str = "the run began",
) -> str | None:
    """That energies have grown without bound, as they do beyond the stability limit of a method; None if they have not.

        K + |U| > growth (K₀ + |U₀| + R)   and   |E − E₀| > (K + |U|) / 2,   R = Σ m (ulp(r)/Δt)²

    first : observables of an earlier frame.  since : when that was, for the sentence.
    E is the total energy minus the reservoir energy and work, R the energy [energy] that the rounding of positions can
    make in a step."""
    system = engine.system
    kinetic = engine.kinetic_energy
    potential = engine.potential_energy
    with np.errstate(over="ignore"):  # infinite for time steps that nobody needs
        pace = np.spacing(largest_component(system.positions)) / engine.method.timestep
        rounding = system.masses.sum() * np.square(pace)
    name = "conserved_energy" if engine.has_bath else "total_energy"
    energy = (
        kinetic + potential - engine.work - (engine.reservoir_energy if engine.has_bath else 0.0)
    )
    start = first[name] - (0.0 if engine.has_bath else first.get("work", 0.0))
    before = first["kinetic_energy"] + abs(first["potential_energy"])
    now = kinetic + abs(potential)
    if not (now > growth * (before + rounding) and abs(energy - start) > HALF * now):
        return None
    what = name.replace("_", " ")
    return (
        f"the {what} has gone from {start:.3g} to {energy:.3g} {system.units.energy} since {since}"
    )


def is_overlap(contact: Contact) -> bool:
    """Whether two atoms are closer than any collision takes them."""
    return contact.distance == 0.0 or (
        contact.ratio is not None and not contact.is_bond and contact.ratio < OVERLAP
    )


def is_thrown(contact: Contact, evidence: Evidence) -> bool:
    """Whether a law without a length of its own throws a pair apart within one step."""
    inverse_mass = float(
        evidence.engine.constraint_set.inverse_masses[[contact.first, contact.second]].sum()
    )
    return (
        contact.ratio is None
        and contact.force * inverse_mass * evidence.timestep**2 > THROWN * contact.distance
    )
