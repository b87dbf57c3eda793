"""The likely cause of a failed run: rules, each of which knows one, tried in turn."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.diagnosis.contacts import Contact, contacts
from minimd.integrators.splitting.linear_stability import stability_limit
from minimd.integrators.splitting.substeps import Substeps
from minimd.neighbors.queries import closest_pair
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.observables import kinetic_energy
from minimd.structure.system import System

OVERLAP = 0.8  # of σ; thermal collisions of a liquid at k_B T = ε end at 0.85 σ
THROWN = 0.1  # of the distance by which a force moves a pair in one step: the same, of laws without a length of their own
HOT_STRIDE = 0.05  # of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
HOT_SPOT = 6.0  # times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
FAST = 0.3  # of ωσ at the minimum of a pair: speeds above are those of heat, k_B T > 3 ε, below it is the step that is too long
BOND_STEP = 0.2  # Δt·ω of a bond that conserves energy well


class Moment(NamedTuple):
    """A state to go back to.  positions, velocities : (N, 3).  heat : [energy]."""

    step: int
    time: float
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    heat: float


class Evidence(NamedTuple):
    """What is known about a failure.

    system : in its last good state.  start : an earlier one.  is_first : whether that is the start of the run.
    found : contacts of the atoms under suspicion.  constraint : atoms of one that could not be kept.
    """

    system: System
    potentials: Sequence[Any]
    inverse_masses: NDArray[np.float64]
    timestep: float
    row: Substeps
    start: Moment
    is_first: bool
    constraint: tuple[int, int] | None
    found: list[Contact]

    @property
    def shown_timestep(self) -> str:
        """For people."""
        units = self.system.units
        return f"{abs(self.timestep) * units.to_picosecond * units.shown_small_time:g} {units.small_time}"

    @property
    def strongest(self) -> Contact | None:
        """The contact with the largest force."""
        return max((one for one in self.found if one.is_finite), key=lambda one: abs(one.force), default=None)


class Verdict(NamedTuple):
    """kind : "law", "overlap", "constraint", "bond", "hot" or "pair".  pair : to blame, or None.  cause, advice : one sentence each."""

    kind: str
    pair: Contact | None
    cause: str
    advice: str


def verdict(evidence: Evidence) -> Verdict:
    """What the first rule says that knows the cause."""
    return next(answer for answer in (rule(evidence) for rule in RULES) if answer is not None)


def law_without_number(evidence: Evidence) -> Verdict | None:
    """A law of the user's that is not finite at some distance."""
    bad = [one for one in evidence.found if not one.is_finite and not is_overlap(one) and (one.is_users or one.is_bond)]
    if not bad:
        return None
    cause = f"the law of {bad[0].law} gives no finite number for {atoms_of(bad[0])}, {apart(bad[0])}"
    return Verdict("law", bad[0], cause, "mend the law at that distance, or keep the atoms from coming there")


def overlap_at_start(evidence: Evidence) -> Verdict | None:
    """The closest pair of the first state, if it is on top of each other."""
    if not evidence.is_first:
        return None
    now = evidence.system
    system = System(evidence.start.positions, masses=now.masses, cell=now.cell, species=now.species, bonds=now.bonds, units=now.units)
    closest = closest_pair(system)
    if closest is None or _are_joined(now, int(closest.first), int(closest.second)):
        return None
    found = contacts(system, evidence.potentials, evidence.inverse_masses, {int(closest.first), int(closest.second)})
    over = [one for one in found if not one.is_bond and (is_overlap(one) or _is_thrown(one, evidence))]
    if not over:
        return None
    worst = min(over, key=lambda one: one.distance)
    return Verdict(
        "overlap", worst, f"{atoms_of(worst)} overlap at the start, {apart(worst)}", "move them apart, or lower the energy of the start first"
    )


def broken_constraint(evidence: Evidence) -> Verdict | None:
    """A constraint that the solver gave up."""
    if evidence.constraint is None:
        return None
    i, j = evidence.constraint
    cause = f"the constraint between atoms {i} and {j} cannot be kept: its atoms move too far for it in one step of {evidence.shown_timestep}"
    return Verdict("constraint", evidence.strongest, cause, "reduce the time step, or look whether the constraints contradict each other")


def unstable_bond(evidence: Evidence) -> Verdict | None:
    """A bond whose Δt·ω is beyond the limit of the method."""
    bonds = [(one.frequency * abs(evidence.timestep), one) for one in evidence.found if one.is_bond and one.frequency]
    if not bonds:
        return None
    x, stiffest = max(bonds, key=lambda bond: bond[0])
    limit = stability_limit(evidence.row)
    if x <= limit:
        return None
    cause = f"the time step {evidence.shown_timestep} is too long for the bond of {atoms_of(stiffest)}: Δt·ω = {x:.3g}"
    return Verdict(
        "bond", stiffest, f"{cause} (stable to {limit:.3g})", f"take a time step {BOND_STEP / x:.2g} times as long, or hold the bond rigid"
    )


def too_hot(evidence: Evidence) -> Verdict | None:
    """Atoms that were too fast before anything had gone wrong, all or one of them."""
    pairs = [one for one in evidence.found if one.ratio and not one.is_bond]
    if not pairs:
        return None
    size = min(one.distance / one.ratio for one in pairs if one.ratio)
    fast = FAST * size * max((one.rest_frequency for one in pairs if one.rest_frequency), default=0.0)
    squares, dt = np.einsum("ij,ij->i", evidence.start.velocities, evidence.start.velocities), abs(evidence.timestep)
    atom, all_of_them = int(np.argmax(squares)), float(np.sqrt(squares.mean()))
    speed, others = float(np.sqrt(squares[atom])), float(np.sqrt((squares.sum() - squares[atom]) / max(1, len(squares) - 1)))
    passes = f"atom {atom} moves {speed * dt / size:.2g} σ in a step, past its neighbors"
    advice = "cool the start, or reduce the time step in proportion to the speed"
    if all_of_them > fast and all_of_them * dt > HOT_STRIDE * size and speed <= HOT_SPOT * others:
        units = evidence.system.units
        hot = 2.0 * kinetic_energy(evidence.start.velocities, evidence.system.masses) / (3 * len(squares) * units.k_B)
        return Verdict("hot", evidence.strongest, f"too hot: at {hot:.3g} {units.temperature} {passes}", advice)
    if speed > max(fast, HOT_SPOT * others) and speed * dt > HOT_STRIDE * size:
        than = f", {speed / others:.2g} times as fast as the others" if others > 0.0 else ", the only one in motion"
        return Verdict("hot", evidence.strongest, f"too hot: {passes}{than}", advice)
    return None


def long_step(evidence: Evidence) -> Verdict:
    """What is left: the pair with the largest force, if there is one."""
    pair = evidence.strongest
    if pair is None:
        advice = "look at the forces in the last good state"
        return Verdict("law", None, "atoms fly apart, and no pair of a known law pushes them: the forces come from elsewhere", advice)
    words = f"the time step {evidence.shown_timestep} is too long for the {'bond' if pair.is_bond else 'pair'} of {atoms_of(pair)}, {apart(pair)}"
    return Verdict("pair", pair, words + stiffness(pair, evidence.timestep), "reduce the time step to a half or less, until the energy is conserved")


RULES: tuple[Callable[[Evidence], Verdict | None], ...] = (
    law_without_number,
    overlap_at_start,
    broken_constraint,
    unstable_bond,
    too_hot,
    long_step,
)


def _are_joined(system: System, i: int, j: int) -> bool:
    """Whether a bond or a rigid length holds two atoms together, so that they are close by right."""
    known = [system.bonds, *(one.pairs for one in system.constraints if isinstance(one, DistanceConstraints))]
    return any(bool(((pairs == (i, j)) | (pairs == (j, i))).all(axis=1).any()) for pairs in known if len(pairs))


def is_overlap(contact: Contact) -> bool:
    """Whether two atoms are where no collision takes them."""
    return contact.distance == 0.0 or (contact.ratio is not None and not contact.is_bond and contact.ratio < OVERLAP)


def _is_thrown(contact: Contact, evidence: Evidence) -> bool:
    """Whether a law without a length of its own throws a pair apart within one step."""
    inverse_mass = evidence.inverse_masses[contact.first] + evidence.inverse_masses[contact.second]
    return contact.ratio is None and bool(contact.force * inverse_mass * evidence.timestep**2 > THROWN * contact.distance)


def atoms_of(contact: Contact) -> str:
    """For people."""
    return f"atoms {contact.first} and {contact.second}"


def apart(contact: Contact) -> str:
    """For people."""
    ratio = "" if contact.ratio is None else f" (r/{'r₀' if contact.is_bond else 'σ'} = {contact.ratio:.3g})"
    return f"{contact.distance:.3g} apart{ratio}"


def stiffness(contact: Contact, timestep: float) -> str:
    """For people."""
    return "" if contact.frequency is None else f", Δt·ω = {contact.frequency * abs(timestep):.3g}"
