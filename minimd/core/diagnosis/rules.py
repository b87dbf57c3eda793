"""The rules of the judge: hints before a run, faults at its start and during it, causes after it has failed.

Each generator yields verdicts in the order in which they count: the most certain one comes first.
"""

from collections.abc import Iterator
from math import pi, sqrt

import numpy as np

from minimd.core.diagnosis.contacts import OPEN_IT, thin_cell
from minimd.core.diagnosis.evidence import USUAL, Evidence, Verdict, is_overlap, strongest
from minimd.core.diagnosis.timestep import OSCILLATION
from minimd.core.engine.cell_rescaling import EVAPORATED
from minimd.core.integrators.order_conditions import accurate_step
from minimd.core.integrators.substeps import outer_substeps
from minimd.core.neighbors.queries import closest_pair
from minimd.core.potentials.bonded import HarmonicBond
from minimd.core.potentials.coulomb import SUMS, Coulomb, spaces
from minimd.core.potentials.embedded import EmbeddedAtom
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
from minimd.core.structure.units import ASE, BAR

Verdicts = Iterator[Verdict]

# before
# of the relaxation time of a barostat, between two strains: fluctuations are then wrong by up to a tenth
QUICK = 0.1
CRUSHING = 0.5  # eV/Å³: 80 GPa, far more than a Lennard-Jones solid is good for
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
FEW = 10  # atoms, planets say: with fewer, nobody asks for means that leave out the center of mass
TOO_LONG = 3.3  # times the recommended step: six steps in a period of that mode
CHECK_STEP = "take the time step that advise_timestep recommends, and check its unit"
# after
# of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
HOT_STEP = 0.05
# times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
HOT_SPOT = 6.0
# of ωσ at the minimum of a pair: higher speeds are due to heat, k_B T > 3 ε; at lower ones the step is too long
FAST = 0.3
# of the longest stable step: in a run bonds come that close to their limit; velocity Verlet: 5 steps in a period
CLOSE = 0.6
# likewise: collisions are that much stiffer than the state itself
NEAR_LIMIT = 0.5


def before(evidence: Evidence) -> Verdicts:
    """Hints before a run; the forces must be current."""
    long_step = next(long_steps(evidence), None)
    if long_step:
        yield long_step
    else:
        yield from _short_step(evidence)
    yield from _no_pair_in_reach(evidence)
    yield from _settings_of_barostat(evidence)
    yield from _moving_center(evidence)
    yield from _flat_motion(evidence)
    yield from _polar_slab(evidence)
    # atoms that are pushed by their own images, as in a cell of two dimensions that is left periodic
    cause = thin_cell(evidence.system, evidence.potentials)
    if cause:
        yield Verdict("thin", cause, OPEN_IT)


def long_steps(evidence: Evidence) -> Verdicts:
    """An ε in another unit; a time step that is too long for the harmonic bonds and angles, or for collisions of
    Lennard-Jones atoms in a liquid. Other forces may allow still less."""
    stiffness = evidence.stiffness
    dt = evidence.stride
    method = evidence.engine.method
    shown = evidence.units.shown
    depth = evidence.strange_depth
    if depth:
        yield depth
    close = CLOSE * evidence.limit
    # the bound spares usual steps the search for the stiffest mode
    if dt * sqrt(stiffness.bound) > close and evidence.phase_of_bonds > close:
        yield Verdict(
            "long step",
            f"timestep {evidence.step} is long: {evidence.stability_of_bonds}; {evidence.recommended}",
            "check the unit of the time step",
        )
    fastest = stiffness.collisions(at_rest=True)
    is_usual = method.is_dynamics and not method.is_overdamped
    if not is_usual or not fastest * dt > TOO_LONG * OSCILLATION**0.5:
        return  # spares usual steps the search for what the method can do
    step = accurate_step(
        outer_substeps(method.sequence()), OSCILLATION
    )  # 0 of a method without kicks
    if step != 0.0 and dt > TOO_LONG * step / fastest:
        longest_stride = step / stiffness.collisions()  # for the heat of these atoms
        recommended = shown(method.timestep_of(longest_stride))
        yield Verdict(
            "long step",
            f"timestep {evidence.step} is long for Lennard-Jones atoms of these masses: "
            f"in a liquid {method.name} conserves the energy with steps up to {recommended}",
            CHECK_STEP,
        )


def _short_step(evidence: Evidence) -> Verdicts:
    """A time step far shorter than the harmonic bonds and the collisions of Lennard-Jones atoms need."""
    fastest = max(evidence.stiffness.collisions(), sqrt(evidence.stiffness.bound))
    usual = USUAL / fastest if fastest else np.inf
    is_short = MEANT * usual < evidence.stride < TOO_SHORT * usual
    # other laws may be stiffer
    laws = evidence.potentials
    is_known = all(isinstance(law, Nonbonded | HarmonicBond) for law in laws)
    if is_short and is_known and not any(isinstance(law, EmbeddedAtom) for law in laws):
        example = ", such as 5 * md.units.fs" if not evidence.units.is_reduced else ""
        yield Verdict(
            "short step",
            f"timestep {evidence.step} is far shorter than the 20 steps in a period that atoms need",
            f"{evidence.recommended}, and check the unit of the time step{example}",
        )


def _no_pair_in_reach(evidence: Evidence) -> Verdicts:
    """No pair interacts, as when lengths of the potential and of the positions have different units."""
    engine = evidence.engine
    length = evidence.units.length
    laws = [law for law in evidence.potentials if isinstance(law, Nonbonded)]
    cutoff = max((law.cutoff for law in laws if law.cutoff < np.inf), default=np.inf)
    has_forces = engine.potential_energy != 0.0 or engine.forces.any()
    closest = evidence.closest
    if closest and closest.distance > cutoff and not has_forces:
        i, j, distance = closest
        yield Verdict(
            "reach",
            f"no two atoms are within the cutoff, {cutoff:g} {length}: "
            f"the closest atoms, {i} and {j}, are {distance:.3g} {length} apart",
            f"check that the lengths of the potential are in {length}",
        )


def _settings_of_barostat(evidence: Evidence) -> Verdicts:
    """A barostat that acts too seldom for its relaxation time; a pressure in eV/Å³ that is a number in bar or so."""
    barostat = evidence.engine.barostat
    units = evidence.units
    shown = units.shown
    if barostat is None:
        return
    interval = barostat.every * evidence.engine.method.duration
    relaxation_time = barostat.relaxation_time
    if interval > QUICK * relaxation_time:
        yield Verdict(
            "barostat",
            f"the barostat acts every {barostat.every} steps, {shown(interval)}, which is too long for its "
            f"relaxation_time {shown(relaxation_time)}: the volume fluctuates too much",
            f"take a relaxation_time of at least {shown(interval / QUICK)}, or a smaller every",
        )
    _, p = evidence.engine.bath_settings
    if units == ASE and p is not None and abs(p) > CRUSHING:
        yield Verdict(
            "pressure",
            f"pressure {p:g} {units.pressure} is {p / BAR:.2g} bar",
            f"if {p:g} bar is meant, give {p:g} * md.units.BAR, and the compressibility per BAR",
        )


def _moving_center(evidence: Evidence) -> Verdicts:
    """A center of mass that moves, although its motion is no degree of freedom."""
    system = evidence.system
    units = evidence.units
    if len(system) < FEW:
        return
    speed = float(np.linalg.norm(evidence.engine.drift))
    momenta = absolute_momentum(system.velocities, system.masses)
    if speed * system.masses.sum() > MOVING * momenta:
        pace = f"{speed / units.to_picosecond:.3g} {units.length}/{units.shown_time}"
        yield Verdict(
            "center",
            f"the center of mass moves at {pace}: temperature, pressure, diffusion and viscosity leave this motion out",
            "stop it with sim.velocities -= sim.drift",
        )


def _flat_motion(evidence: Evidence) -> Verdicts:
    """Atoms that lie and move in one plane, or on one line: fewer degrees of freedom move than are counted."""
    engine = evidence.engine
    dt = evidence.stride
    inverse_masses = evidence.inverse_masses
    accelerations = engine.forces * inverse_masses[:, None]
    moves = np.array([engine.positions, dt * engine.velocities, dt * dt * accelerations])
    moves = moves[:, inverse_masses > 0.0]
    n_atoms = moves.shape[1]
    is_plane = evidence.system.dimensions == 2
    if is_plane or n_atoms < 3 or not moves[1].any() or not np.isfinite(moves).all():
        return
    moves[0] -= moves[0, 0].copy()
    moves /= largest_component(moves)  # squares of forces of any size are finite
    n_flat = 3 - int(np.linalg.matrix_rank(moves.reshape(-1, 3), FLAT * np.linalg.norm(moves)))
    n_dof = engine.n_dof
    n_moving = n_dof - n_flat * (n_atoms - leaves_out_center(n_atoms, engine.conserves_momentum))
    if 0 < n_moving < n_dof:
        where = ("in one plane", "on one line")[n_flat - 1]
        in_space = "give velocities in all directions"
        cures = (f"make a System with planar=True, or {in_space}", in_space)
        yield Verdict(
            "plane",
            f"all atoms lie and move {where}: {n_moving} of the {n_dof} degrees of freedom that are counted move",
            f"their temperature is {n_dof / n_moving:.4g} times the one shown; {cures[n_flat - 1]}",
        )


def _polar_slab(evidence: Evidence) -> Verdicts:
    """A slab with a dipole, whose periodic images make a field in it: E = 4π k_e |Σ q z| / V (tin-foil)."""
    engine = evidence.engine
    system = evidence.system
    units = evidence.units
    cell = system.cell
    laws = [law for law in evidence.potentials if isinstance(law, Coulomb)]
    has_sum = any(law.method in SUMS and law.slab == "none" for law in laws)
    if not has_sum or cell.volume is None or system.net_charge:
        return
    inverse, fractions, gaps = spaces(system)
    second, widest = np.sort(gaps, axis=0)[-2:]
    is_open = widest > np.maximum(EMPTY, WIDER * second)
    if is_open.sum() != 1:
        return
    axis = int(np.argmax(is_open))
    normal = inverse[:, axis]
    first = fractions[np.argmax(gaps[:, axis]) - len(system) + 1, axis]  # the atom above the gap
    heights = (system.positions @ normal - first + ROUNDING) % 1.0 / np.linalg.norm(normal)
    dipole = abs(float(system.charges @ heights))
    field = 4.0 * pi * units.coulomb * dipole / cell.volume
    if field * np.linalg.norm(system.charges) > POLAR * np.linalg.norm(engine.forces):
        yield Verdict(
            "slab",
            f"the atoms are a slab with a dipole of {dipole:.3g} e {units.length} "
            f"along the normal of the slab, across {'abc'[axis]}: "
            f"its periodic images make a field of {field:.3g} {units.energy}/(e {units.length}) in it",
            f'Coulomb(..., slab="{"xyz"[axis]}") is without this field',
        )


def at_start(evidence: Evidence) -> Verdicts:
    """Accelerations that are not finite or throw atoms across the scene in the first step."""
    engine = evidence.engine
    interactions = engine.interactions
    sizes = np.sqrt(np.einsum("ij,ij->i", engine.forces, engine.forces))
    # |F|/m, without a warning of an overflow
    accelerations = np.einsum("i,i->i", evidence.inverse_masses, sizes)
    atom = int(np.argmax(accelerations))
    distance = float(accelerations[atom]) * evidence.stride**2
    way = f"{distance:.3g} {evidence.units.length}"
    if not np.isfinite([distance, engine.potential_energy]).all():
        yield Verdict("start", "forces or energies are not finite")
    elif distance > interactions.largest_cutoff:
        yield Verdict("start", f"the force on atom {atom} would move it by {way} in one step")


def not_finite(evidence: Evidence) -> Verdicts:
    """Positions or velocities that are not finite."""
    for name in ("positions", "velocities"):
        array = getattr(evidence.system, name)
        if longest(array)[1] <= LARGEST:
            continue
        bad = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
        more = " ..." if bad.size > 1 else ""
        if bad.size:
            yield Verdict(
                "number",
                f"{name} of {bad.size} atoms are not finite, or larger than {LARGEST:g} (atom {bad[0]}{more})",
            )


def during(evidence: Evidence) -> Verdicts:
    """Positions or velocities that are not finite; an atom that has moved farther than the largest cutoff in one step,
    and has passed its neighbors unseen."""
    yield from not_finite(evidence)
    atom, length = longest(evidence.system.velocities)
    distance = length * evidence.stride  # of the fastest atom
    cutoff = evidence.engine.interactions.largest_cutoff
    if distance > cutoff:
        way = f"{distance:.3g} {evidence.units.length}"
        yield Verdict(
            "neighbors",
            f"atom {atom} moves {way} in one step, past every neighbor (cutoff {cutoff:g})",
        )


def after(evidence: Evidence) -> Verdicts:
    """Causes of a failure."""
    yield from _laws_without_number(evidence)
    yield from _overlap_at_start(evidence)
    yield from _one_place(evidence)
    yield from _barostat(evidence)
    yield from _constraints(evidence)
    yield from _bonds_and_attraction(evidence)
    yield from _too_hot(evidence)
    yield from _collision_in_a_step(evidence)
    yield from _other_forces(evidence)
    pair = evidence.strongest
    if pair:  # what is left: the pair with the largest force
        kind = "bond" if pair.is_bond else "pair"
        where = f"{evidence.apart(pair)}{pair.stiffness(evidence.stride)}"
        yield Verdict(
            "pair",
            f"timestep {evidence.step} too large for the {kind} of {pair.atoms}, {where}",
            evidence.shorter,
            pair,
        )


def _laws_without_number(evidence: Evidence) -> Verdicts:
    """A law of the user's, or a table, that is not finite at some distance."""
    for pair in evidence.contacts:
        is_checked = pair.is_users or pair.is_bond
        if is_checked and not pair.is_finite and not is_overlap(pair):
            yield Verdict("law", pair.without_number(evidence.units.length), pair.cure, pair)


def _overlap_at_start(evidence: Evidence) -> Verdicts:
    """The closest pair of a state to which no step led, if its atoms are on top of each other."""
    failure = evidence.failure
    start = evidence.moved(failure.start.positions)
    closest = closest_pair(start) if failure.is_first else None
    if not closest:
        return
    atoms = list(closest[:2])
    held = [law.pairs for law in start.constraints if isinstance(law, DistanceConstraints)]
    if among(np.array([atoms]), np.concatenate([start.bonds, *held])).any():
        return  # these are close by right
    near = evidence.contacts_in(start, atoms)
    over = [pair for pair in near if not pair.is_bond and evidence.overlap(pair)]
    for pair in sorted(over, key=lambda pair: pair.distance):
        at = f"step {failure.start.step}" if failure.start.step else "the start"
        yield Verdict(
            "overlap",
            f"{pair.atoms} overlap at {at}, {evidence.apart(pair)}",
            "move the atoms apart with minimize, or start from a state with less energy",
            pair,
        )


def _one_place(evidence: Evidence) -> Verdicts:
    """Two atoms, bonded ones among them, at the same place: no law gives a direction there."""
    i, j, distance = evidence.closest or (0, 0, np.inf)
    if distance <= 0.0 and not np.isfinite(evidence.engine.forces[[i, j]]).all():
        yield Verdict(
            "overlap",
            f"atoms {i} and {j} are at the same place, where the force between them is not defined",
            "move them apart with minimize, or remove one of them",
        )


def _barostat(evidence: Evidence) -> Verdicts:
    """A barostat that cannot go on, or that has made a gas of what was dense."""
    bath = evidence.engine.barostat
    volume = evidence.system.volume
    first = evidence.failure.first_volume
    if bath is None or not volume or not first:
        return
    unit = evidence.units.volume
    at = f"at pressure {bath.pressure:.3g} {evidence.units.pressure}"
    if volume > EVAPORATED * first:
        yield Verdict(
            "barostat",
            f"the cell has grown from {first:.4g} to {volume:.4g} {unit} {at}: the atoms have evaporated",
            "take a higher pressure, or a lower temperature",
        )
    elif evidence.failure.is_of_barostat:
        yield Verdict(
            "barostat",
            f"{at} the barostat strains the cell too fast: its volume is {volume:.4g} {unit}, "
            f"and was {first:.4g} {unit} when the simulation was made",
            "equilibrate at constant volume first, take a longer relaxation_time, "
            "or check the unit of the pressure",
        )


def _constraints(evidence: Evidence) -> Verdicts:
    """A pair law that acts most strongly between two atoms whose distance is held; a constraint that was not kept."""
    pair = evidence.strongest
    bonds = evidence.engine.constraint_set.bonds
    if pair and bonds is not None and not pair.is_bond and evidence.overlap(pair):
        held = among(np.array([[pair.first, pair.second]]), bonds.pairs)
        if held.any():
            yield Verdict(
                "law",
                f"{pair.law} acts between {pair.atoms}, "
                f"although a constraint holds their distance, {evidence.apart(pair)}",
                "give bonds=... to the system and bonded_scale=(0, 1, 1) to the potential, or exclusions",
                pair,
            )
    if evidence.failure.constraint is not None:
        i, j = evidence.failure.constraint
        yield Verdict(
            "constraint",
            f"in one step of {evidence.step} atoms {i} and {j} move too far for the constraint between them",
            "reduce the timestep, or check whether the constraints contradict each other",
            pair,
        )


def _bonds_and_attraction(evidence: Evidence) -> Verdicts:
    """Bonds whose Δt·ω, of one or of all together, is beyond the limit of the method, or close to it if a bond pushes
    most strongly; a law that attracts the more the closer two atoms come."""
    limit = evidence.limit
    pair = evidence.strongest
    bonds = [contact for contact in evidence.contacts if contact.is_bond]
    bond = max(bonds, key=evidence.phase, default=None)
    phase = evidence.phase(bond) if bond else 0.0
    is_pushed = pair is not None and pair.is_bond
    if evidence.phase_of_bonds > (CLOSE if is_pushed else 1.0) * limit:
        alone = f"; Δt·ω of the bond of {bond.atoms} alone is {phase:.4g}" if bond else ""
        yield Verdict(
            "bond",
            f"timestep {evidence.step} too large: {evidence.stability_of_bonds}{alone}",
            f"{evidence.recommended}; or hold bonds rigid",
            bond,
        )
    elif bond and phase > limit:
        yield Verdict(
            "bond",
            f"timestep {evidence.step} too large for the bond of {bond.atoms}: "
            f"Δt·ω = {phase:.3g} (stable up to {limit:.3g})",
            f"{evidence.recommended}; or hold the bond rigid",
            bond,
        )
    if pair and pair.sinks:
        depth = f"{pair.energy:.3g} {evidence.units.energy}"
        yield Verdict(
            "law",
            f"the law of {pair.law} attracts {pair.atoms}, {evidence.apart(pair)}; "
            f"u = {depth}, and less at shorter distances: the atoms fall into each other",
            "give the law a repulsive core; a shorter timestep does not help",
            pair,
        )


def _too_hot(evidence: Evidence) -> Verdicts:
    """Atoms, all or one of them, that were too fast before anything had gone wrong."""
    engine = evidence.engine
    constraint_set = engine.constraint_set
    dt = evidence.stride
    velocities = evidence.failure.start.velocities
    pairs = [pair for pair in evidence.contacts if pair.ratio and not pair.is_bond]
    if not pairs:
        return
    sigma = min(pair.distance / pair.ratio for pair in pairs if pair.ratio)
    frequency = max(pair.rest_frequency or 0.0 for pair in pairs)
    fast = sigma * max(HOT_STEP / dt, FAST * frequency)
    squares = np.einsum("ij,ij->i", velocities, velocities)
    atom = int(np.argmax(squares))
    n_moving = len(squares) - constraint_set.n_fixed
    total = squares.sum()
    rest = (total - squares[atom]) / max(1, n_moving - 1)
    speed, mean, others = np.sqrt([squares[atom], total / n_moving, rest])
    passes = f"atom {atom} moves {speed * dt / sigma:.2g} σ in a step"
    if mean > fast and speed <= HOT_SPOT * others:
        heat = constraint_set.temperature(velocities, evidence.system, engine.conserves_momentum)
        passes = f"at {heat:.3g} {evidence.units.temperature} {passes}"
    elif not speed > max(fast, HOT_SPOT * others):
        return
    elif others > 0.0:
        passes = f"{passes}, {speed / others:.2g} times as fast as the others"
    else:
        passes = f"{passes}, the only one in motion"
    yield Verdict(
        "hot",
        f"atoms too hot, or timestep {evidence.step} too large: {passes}",
        "start at a lower temperature, or reduce the timestep in proportion to the speed",
        evidence.strongest,
    )


def _collision_in_a_step(evidence: Evidence) -> Verdicts:
    """Two atoms that the step that failed has brought together, where before it no pair was stiff."""
    failed = evidence.failed
    stiffest = max(map(evidence.phase, evidence.contacts), default=0.0)
    if failed is None or stiffest > NEAR_LIMIT * evidence.limit:
        return
    closest = closest_pair(failed)
    atoms = list(closest[:2]) if closest else []
    pair = strongest(evidence.contacts_in(failed, atoms))
    if pair and evidence.phase(pair) > evidence.limit:
        where = f"{evidence.apart(pair)}{pair.stiffness(evidence.stride)}"
        step = evidence.failure.step
        yield Verdict(
            "pair",
            f"timestep {evidence.step} too large: step {step} drives {pair.atoms} into each other, {where}",
            evidence.shorter,
            pair,
        )


def _other_forces(evidence: Evidence) -> Verdicts:
    """No pair with a known law pushes the atoms: a time step near the limit of the stiffest mode, or other forces."""
    if evidence.strongest is not None:
        return
    advice = evidence.advice
    dt = evidence.timestep
    if advice and advice.frequency and dt > NEAR_LIMIT * advice.limit:
        limit = evidence.units.shown(advice.limit)
        closer = "; if atoms come closer, only shorter steps are stable"
        yield Verdict(
            "step",
            f"timestep {evidence.step} too large: {advice.method} is stable up to {limit} "
            f"for the stiffest mode of the last good state{closer * (dt <= advice.limit)}",
            evidence.recommended,
        )
    yield Verdict(
        "law",
        "atoms fly apart although no pair with a known law pushes them: the forces come from another potential",
        "examine the forces of each potential in the last good state",
    )
