"""The rules of the judge: hints before a run, faults at its start and during it, causes after it has failed.

Each generator yields (kind, verdict), kind being for programs, in the order in which they count: the most certain
verdict comes first.
"""

from collections.abc import Iterator
from math import pi, sqrt

import numpy as np

from minimd.core.diagnosis.evidence import Evidence, Verdict, is_overlap, strongest
from minimd.core.diagnosis.timestep import OSCILLATION
from minimd.core.engine.cell_rescaling import EVAPORATED
from minimd.core.forces.contacts import OPEN_IT, thin_cell
from minimd.core.integrators.order_conditions import accurate_step
from minimd.core.neighbors.queries import closest_pair
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
from minimd.core.structure.units import ASE, BAR

Verdicts = Iterator[tuple[str, Verdict]]

# before
QUICK = 0.1  # of the relaxation time of a barostat, between two strains: fluctuations are then wrong by up to a tenth
CRUSHING = 0.5  # eV/Å³: 80 GPa, far more than a Lennard-Jones solid is good for
TOO_SHORT = 0.001  # of the usual step
MEANT = 1e-30  # likewise: a step below this is no error of the unit, somebody wants atoms that stand still
EMPTY = 0.25  # of the height of a cell: atoms with a wider gap, in one direction, are a slab
WIDER = 2.0  # times the second gap: layers of a small crystal are as far apart
ROUNDING = 1e-12  # of a fractional coordinate
POLAR = 0.05  # of the rms force: a smaller one, of the images of a slab, is not told
FLAT = 1e-10  # of their extent: how far from a plane atoms may lie, and move in a step, by rounding
MOVING = 1e-6  # of Σ|mv|: a smaller total momentum is rounding, of files with six digits or in single precision
TOO_LONG = 3.3  # times the recommended step: six steps in a period of that mode
CHECK_STEP = "take the time step that advise_timestep recommends, and check its unit"
# after
HOT_STEP = 0.05  # of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
HOT_SPOT = (
    6.0  # times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
)
# of ωσ at the minimum of a pair: higher speeds are due to heat, k_B T > 3 ε; at lower ones the step is too long
FAST = 0.3
NEAR_LIMIT = (
    0.5  # of the longest stable step: collisions are that much stiffer than the state itself
)


def before(evidence: Evidence) -> Verdicts:
    """Hints before a run; the forces must be current."""
    yield from time_steps(evidence)
    yield from _no_pair_in_reach(evidence)
    yield from _settings_of_barostat(evidence)
    yield from _moving_center(evidence)
    yield from _flat_motion(evidence)
    yield from _polar_slab(evidence)
    # atoms that are pushed by their own images, as in a cell of two dimensions that is left periodic
    cause = thin_cell(evidence.system, evidence.engine.interactions.potentials)
    if cause:
        yield "thin", Verdict(cause, OPEN_IT)


def time_steps(evidence: Evidence) -> Verdicts:
    """A time step that is too long for a bond or for collisions, or far too short; or an ε in another unit."""
    stiffness = evidence.stiffness
    method = evidence.engine.method
    shown = evidence.units.shown
    dt = evidence.timestep
    timestep = shown(dt)
    depth = evidence.strange_depth
    if depth is not None:
        yield "long step", depth
    bond = stiffness.bond
    limit = evidence.limit / sqrt(bond.square) if bond else np.inf
    if bond and dt > limit:  # other forces may allow still less
        is_long = (
            f"timestep {timestep} is longer than the bond of atoms {bond.i} and {bond.j} allows"
        )
        able = f"for this bond {method.name} is stable up to {shown(limit)}"
        yield "long step", Verdict(f"{is_long}: {able}", CHECK_STEP)
    fastest = stiffness.collisions(at_rest=True)
    if (
        fastest * dt > TOO_LONG * OSCILLATION**0.5
    ):  # spares usual steps the search for what the method can do
        step = accurate_step(method.sequence(), OSCILLATION)  # 0: of a method without kicks
        if step != 0.0 and dt > TOO_LONG * step / fastest:
            is_long = f"timestep {timestep} is long for Lennard-Jones atoms as light as these"
            recommended = shown(step / stiffness.collisions())  # for the heat of the atoms
            able = f"in a liquid {method.name} conserves the energy with steps up to {recommended}"
            yield "long step", Verdict(f"{is_long}: {able}", CHECK_STEP)
    potentials = evidence.engine.interactions.potentials
    is_known = all(
        isinstance(law, Nonbonded | HarmonicBond) for law in potentials
    )  # others may be stiffer
    usual = evidence.usual_step()
    if is_known and MEANT * usual < dt < TOO_SHORT * usual:
        is_short = f"timestep {timestep} is far shorter than these atoms need"
        example = ", such as 5 * md.units.fs" if evidence.units == ASE else ""
        cause = f"{is_short}: with {shown(usual)} the fastest motion has 20 steps per period"
        yield "short step", Verdict(cause, f"check the unit of the time step{example}")


def _no_pair_in_reach(evidence: Evidence) -> Verdicts:
    """No pair interacts, as when lengths of the potential and of the positions have different units."""
    interactions = evidence.engine.interactions
    unit = evidence.units.length
    laws = [law for law in interactions.potentials if isinstance(law, Nonbonded)]
    cutoff = max((law.cutoff for law in laws if law.cutoff < np.inf), default=np.inf)
    has_forces = interactions.potential_energy != 0.0 or evidence.engine.forces.any()
    closest = evidence.closest
    if closest is not None and closest.distance > cutoff and not has_forces:
        i, j, distance = closest
        apart = f"the closest atoms, {i} and {j}, are {distance:.3g} {unit} apart"
        cause = f"no two atoms are within the cutoff, {cutoff:g} {unit}: {apart}"
        yield "reach", Verdict(cause, f"check that the lengths of the potential are in {unit}")


def _settings_of_barostat(evidence: Evidence) -> Verdicts:
    """A barostat that acts too seldom for its relaxation time; a pressure in eV/Å³ that is a number in bar or so."""
    barostat = evidence.engine.barostat
    units = evidence.units
    shown = units.shown
    if barostat is None:
        return
    interval = barostat.every * evidence.engine.method.timestep
    relaxation_time = barostat.relaxation_time
    if interval > QUICK * relaxation_time:
        acts = f"the barostat acts every {barostat.every} steps, {shown(interval)}"
        too_long = f"which is too long for its relaxation_time {shown(relaxation_time)}"
        cause = f"{acts}, {too_long}: the volume fluctuates too much"
        advice = f"take a relaxation_time of at least {shown(interval / QUICK)}, or a smaller every"
        yield "barostat", Verdict(cause, advice)
    p = barostat.pressure
    if units == ASE and abs(p) > CRUSHING:
        advice = (
            f"if {p:g} bar is meant, give {p:g} * md.units.BAR, and the compressibility per BAR"
        )
        yield "pressure", Verdict(f"pressure {p:g} {units.pressure} is {p / BAR:.2g} bar", advice)


def _moving_center(evidence: Evidence) -> Verdicts:
    """A center of mass that moves, although its motion is no degree of freedom."""
    system = evidence.system
    units = evidence.units
    speed = float(np.linalg.norm(evidence.engine.drift))
    momenta = absolute_momentum(system.velocities, system.masses)
    if speed * system.masses.sum() > MOVING * momenta:
        pace = f"{speed / units.to_picosecond:.3g} {units.length}/{units.shown_time}"
        left_out = "temperature, pressure, diffusion and viscosity leave this motion out"
        cause = f"the center of mass moves at {pace}: {left_out}"
        yield "center", Verdict(cause, "stop it with sim.velocities -= sim.drift")


def _flat_motion(evidence: Evidence) -> Verdicts:
    """Atoms that lie and move in one plane, or on one line: fewer degrees of freedom move than are counted."""
    engine = evidence.engine
    dt = evidence.timestep
    inverse_masses = engine.constraint_set.inverse_masses
    accelerations = engine.forces * inverse_masses[:, None]
    moves = np.array([engine.positions, dt * engine.velocities, dt * dt * accelerations])
    moves = moves[:, inverse_masses > 0.0]
    n_atoms = moves.shape[1]
    if n_atoms < 3 or not moves[1].any() or not np.isfinite(moves).all():
        return
    moves[0] -= moves[0, 0].copy()
    moves /= largest_component(moves)  # squares of forces of any size are finite
    n_flat = 3 - int(np.linalg.matrix_rank(moves.reshape(-1, 3), FLAT * np.linalg.norm(moves)))
    n_dof = engine.n_dof
    n_moving = n_dof - n_flat * (n_atoms - leaves_out_center(n_atoms, engine.conserves_momentum))
    if 0 < n_moving < n_dof:
        where = ("in one plane", "on one line")[n_flat - 1]
        moving = f"{n_moving} of the {n_dof} degrees of freedom that are counted move"
        hotter = f"their temperature is {n_dof / n_moving:.4g} times the one shown"
        advice = f"{hotter}; velocities in all directions have all of them"
        yield "plane", Verdict(f"all atoms lie and move {where}: {moving}", advice)


def _polar_slab(evidence: Evidence) -> Verdicts:
    """A slab with a dipole, whose periodic images make a field in it: E = 4π k_e |Σ q z| / V (tin-foil)."""
    engine = evidence.engine
    system = evidence.system
    units = evidence.units
    cell = system.cell
    sums = (
        isinstance(law, Coulomb) and law.method in SUMS for law in engine.interactions.potentials
    )
    if cell.volume is None or system.net_charge or not any(sums):
        return
    inverse = np.linalg.inv(cell.vectors)
    fractions = np.sort(system.positions @ inverse % 1.0, axis=0)
    gaps = np.diff(fractions, axis=0, append=fractions[:1] + 1.0)
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
        slab = f"the atoms are a slab with a dipole of {dipole:.3g} e {units.length}"
        along = f"along the normal of the slab, across {'abc'[axis]}"
        of_images = f"its periodic images make a field of {field:.3g} {units.energy}/(e {units.length}) in it"
        advice = "give the slab two like faces, or a second slab, turned over, in the same cell"
        yield "slab", Verdict(f"{slab} {along}: {of_images}", advice)


def at_start(evidence: Evidence) -> Verdicts:
    """Accelerations that are not finite or throw atoms across the scene in the first step."""
    engine = evidence.engine
    interactions = engine.interactions
    sizes = np.sqrt(np.einsum("ij,ij->i", engine.forces, engine.forces))
    # |F|/m, without a warning of an overflow
    accelerations = np.einsum("i,i->i", engine.constraint_set.inverse_masses, sizes)
    atom = int(np.argmax(accelerations))
    distance = float(accelerations[atom]) * evidence.timestep**2
    if not np.isfinite([distance, interactions.potential_energy]).all():
        yield "start", Verdict("forces or energies are not finite")
    elif distance > interactions.largest_cutoff:
        way = f"{distance:.3g} {evidence.units.length}"
        yield "start", Verdict(f"the force on atom {atom} would move it by {way} in one step")


def during(evidence: Evidence) -> Verdicts:
    """Positions or velocities that are not finite; an atom that has passed its neighbors unseen."""
    system = evidence.system
    atom, speed = longest(system.velocities)
    _, farthest = longest(system.positions)
    for name, array, length in (
        ("positions", system.positions, farthest),
        ("velocities", system.velocities, speed),
    ):
        if not length <= LARGEST:
            bad = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
            if bad.size:
                more = " ..." if bad.size > 1 else ""
                are = f"{name} of {bad.size} atoms are not finite, or larger than {LARGEST:g}"
                yield "number", Verdict(f"{are} (atom {bad[0]}{more})")
    # farther than the largest cutoff in one step
    distance = speed * evidence.timestep
    cutoff = evidence.engine.interactions.largest_cutoff
    if distance > cutoff:
        moves = f"atom {atom} moves {distance:.3g} {evidence.units.length} in one step"
        yield "neighbors", Verdict(f"{moves}, past every neighbor (cutoff {cutoff:g})")


def after(evidence: Evidence) -> Verdicts:
    """Causes of a failure."""
    yield from _laws_without_number(evidence)
    yield from _overlap_at_start(evidence)
    yield from _one_place(evidence)
    yield from _barostat(evidence)
    yield from _constraints_and_bonds(evidence)
    yield from _too_hot(evidence)
    yield from _collision_in_a_step(evidence)
    pair = evidence.strongest
    if pair is None:
        yield from _other_forces(evidence)
    else:  # what is left: the pair with the largest force
        dt = evidence.timestep
        units = evidence.units
        what = "bond" if pair.is_bond else "pair"
        where = f"{pair.atoms}, {pair.apart(units.length)}{pair.stiffness(dt)}"
        cause = f"timestep {units.shown(dt)} too large for the {what} of {where}"
        yield "pair", Verdict(cause, evidence.shorter, pair)


def _laws_without_number(evidence: Evidence) -> Verdicts:
    """A law of the user's, or a table, that is not finite at some distance."""
    for pair in evidence.contacts:
        is_of_law = pair.is_users or pair.is_bond
        if is_of_law and not pair.is_finite and not is_overlap(pair):
            yield "law", Verdict(pair.without_number(evidence.units.length), pair.cure, pair)


def _overlap_at_start(evidence: Evidence) -> Verdicts:
    """The closest pair of a state to which no step led, if its atoms are on top of each other."""
    failure = evidence.failure
    start = evidence.moved(failure.start.positions)
    closest = closest_pair(start) if failure.is_first else None
    if closest is None:
        return
    atoms = list(closest[:2])
    held = [law.pairs for law in start.constraints if isinstance(law, DistanceConstraints)]
    is_joined = among(
        np.array([atoms]), np.concatenate([start.bonds, *held])
    ).any()  # close by right
    near = [] if is_joined else evidence.contacts_in(start, atoms)
    over = [pair for pair in near if not pair.is_bond and evidence.overlap(pair)]
    if over:
        pair = min(over, key=lambda pair: pair.distance)
        at = f"step {failure.start.step}" if failure.start.step else "the start"
        cause = f"{pair.atoms} overlap at {at}, {pair.apart(evidence.units.length)}"
        advice = "move the atoms apart with minimize, or start from a state with less energy"
        yield "overlap", Verdict(cause, advice, pair)


def _one_place(evidence: Evidence) -> Verdicts:
    """Two atoms, bonded ones among them, at the same place: no law gives a direction there."""
    closest = evidence.closest
    if closest is None or closest.distance > 0.0:
        return
    i, j, _ = closest
    if not np.isfinite(evidence.engine.forces[[i, j]]).all():
        place = f"atoms {i} and {j} are at the same place"
        cause = f"{place}, where the force between them is not defined"
        yield "overlap", Verdict(cause, "move them apart with minimize, or remove one of them")


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
        grown = f"the cell has grown from {first:.4g} to {volume:.4g} {unit}"
        cause = f"{grown} {at}: the atoms have evaporated"
        yield "barostat", Verdict(cause, "take a higher pressure, or a lower temperature")
    elif evidence.failure.is_of_barostat:
        was = f"was {first:.4g} {unit} when the simulation was made"
        strains = f"{at} the barostat strains the cell too fast"
        cause = f"{strains}: its volume is {volume:.4g} {unit}, and {was}"
        advice = "equilibrate at constant volume first, take a longer relaxation_time, or check the unit of the pressure"
        yield "barostat", Verdict(cause, advice)


def _constraints_and_bonds(evidence: Evidence) -> Verdicts:
    """Constraints, bonds beyond the limit of the method, and laws that attract ever more strongly at short distances."""
    engine = evidence.engine
    units = evidence.units
    dt = evidence.timestep
    timestep = units.shown(dt)
    pair = evidence.strongest
    bonds = engine.constraint_set.bonds
    if pair is not None and bonds is not None and not pair.is_bond and evidence.overlap(pair):
        if among(np.array([[pair.first, pair.second]]), bonds.pairs).any():
            acts = f"{pair.law} acts between {pair.atoms}"
            cause = (
                f"{acts}, although a constraint holds their distance, {pair.apart(units.length)}"
            )
            advice = "give bonds=... to the system and bonded_scale=(0, 1, 1) to the potential, or exclusions"
            yield "law", Verdict(cause, advice, pair)
    if evidence.failure.constraint is not None:
        i, j = evidence.failure.constraint
        far = f"atoms {i} and {j} move too far for the constraint between them"
        advice = "reduce the timestep, or check whether the constraints contradict each other"
        yield "constraint", Verdict(f"in one step of {timestep} {far}", advice, pair)
    known = [contact for contact in evidence.contacts if contact.is_bond]
    stiffest = max(known, key=evidence.phase, default=None)
    if stiffest is not None and evidence.phase(stiffest) > evidence.limit:
        beyond = f"Δt·ω = {evidence.phase(stiffest):.3g} (stable up to {evidence.limit:.3g})"
        cause = f"timestep {timestep} too large for the bond of {stiffest.atoms}: {beyond}"
        yield "bond", Verdict(cause, f"{evidence.recommended}; or hold the bond rigid", stiffest)
    if pair is not None and pair.sinks:
        attracts = f"the law of {pair.law} attracts {pair.atoms}, {pair.apart(units.length)}"
        depth = f"u = {pair.energy:.3g} {units.energy}, and less at shorter distances"
        advice = "give the law a repulsive core; a shorter timestep does not help"
        yield "law", Verdict(f"{attracts}; {depth}: the atoms fall into each other", advice, pair)


def _too_hot(evidence: Evidence) -> Verdicts:
    """Atoms, all or one of them, that were too fast before anything had gone wrong."""
    engine = evidence.engine
    constraint_set = engine.constraint_set
    dt = evidence.timestep
    units = evidence.units
    velocities = evidence.failure.start.velocities
    pairs = [pair for pair in evidence.contacts if pair.ratio and not pair.is_bond]
    if not pairs:
        return
    sigma = min(pair.distance / pair.ratio for pair in pairs if pair.ratio)
    own = max(pair.rest_frequency or 0.0 for pair in pairs)
    fast = sigma * max(HOT_STEP / dt, FAST * own)
    squares = np.einsum("ij,ij->i", velocities, velocities)
    atom = int(np.argmax(squares))
    n_moving = len(squares) - constraint_set.n_fixed
    total = squares.sum()
    rest = (total - squares[atom]) / max(1, n_moving - 1)
    speed, mean, others = np.sqrt([squares[atom], total / n_moving, rest])
    passes = f"atom {atom} moves {speed * dt / sigma:.2g} σ in a step"
    if mean > fast and speed <= HOT_SPOT * others:
        heat = constraint_set.temperature(velocities, evidence.system, engine.conserves_momentum)
        passes = f"at {heat:.3g} {units.temperature} {passes}"
    elif not speed > max(fast, HOT_SPOT * others):
        return
    elif others > 0.0:
        passes = f"{passes}, {speed / others:.2g} times as fast as the others"
    else:
        passes = f"{passes}, the only one in motion"
    cause = f"atoms too hot, or timestep {units.shown(dt)} too large: {passes}"
    advice = "start at a lower temperature, or reduce the timestep in proportion to the speed"
    yield "hot", Verdict(cause, advice, evidence.strongest)


def _collision_in_a_step(evidence: Evidence) -> Verdicts:
    """Two atoms that the step that failed has brought together, where before it no pair was stiff."""
    dt = evidence.timestep
    units = evidence.units
    failed = evidence.failed
    stiffest = max(map(evidence.phase, evidence.contacts), default=0.0)
    if failed is None or stiffest > NEAR_LIMIT * evidence.limit:
        return
    closest = closest_pair(failed)
    atoms = list(closest[:2]) if closest is not None else []
    pair = strongest(evidence.contacts_in(failed, atoms))
    if pair is not None and evidence.phase(pair) > evidence.limit:
        apart = f"{pair.apart(units.length)}{pair.stiffness(dt)}"
        drives = f"step {evidence.failure.step} drives {pair.atoms} into each other, {apart}"
        cause = f"timestep {units.shown(dt)} too large: {drives}"
        yield "pair", Verdict(cause, evidence.shorter, pair)


def _other_forces(evidence: Evidence) -> Verdicts:
    """No pair is known: a time step near the limit of the stiffest mode, or forces of another potential."""
    shown = evidence.units.shown
    dt = evidence.timestep
    advice = evidence.advice
    if advice is not None and advice.frequency and dt > NEAR_LIMIT * advice.limit:
        able = f"{advice.method} is stable up to {shown(advice.limit)}"
        closer = (
            "; if atoms come closer, only shorter steps are stable" if dt <= advice.limit else ""
        )
        cause = f"{able} for the stiffest mode of the last good state{closer}"
        yield "step", Verdict(f"timestep {shown(dt)} too large: {cause}", evidence.recommended)
    cause = "atoms fly apart although no pair with a known law pushes them: the forces come from another potential"
    yield "law", Verdict(cause, "examine the forces of each potential in the last good state")
