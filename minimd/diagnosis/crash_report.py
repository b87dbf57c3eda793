"""Why a run failed: rules that are tried in turn, each for one cause, and the report on the last good state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from minimd.diagnosis.timestep import StepAdvice, advice_at, strange_depth
from minimd.engine.cell_rescaling import EVAPORATED
from minimd.engine.engine import Engine, Snapshot
from minimd.forces.contacts import Contact, contacts
from minimd.integrators.splitting.order_conditions import stability_limit
from minimd.neighbors.queries import ClosestPair, closest_pair
from minimd.structure.bond_graph import among
from minimd.structure.checks import LARGEST
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.observables import Array, kinetic_energy, longest, temperature
from minimd.structure.system import System
from minimd.structure.units import LJ, SYSTEMS

OVERLAP = 0.8  # of σ; thermal collisions of a liquid at k_B T = ε end at 0.85 σ
# of its distance: a pair that a force moves farther in one step overlaps; for laws without a length of their own
THROWN = 0.1
HOT_STEP = (
    0.05  # of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
)
HOT_SPOT = 6.0  # times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
# of ωσ at the minimum of a pair: higher speeds are due to heat, k_B T > 3 ε; at lower ones the step is too long
FAST = 0.3
NEAR_LIMIT = 0.5  # of the longest stable step: collisions are that much stiffer than the state itself
ADVICE_SECONDS = 10.0  # at most, for the search of the stiffest mode


class Failure(NamedTuple):
    """How a run failed.  fault : in words.  step : in which.  constraint : atoms of one that could not be kept,
    or None.

    at : (N, 3), positions at that moment, or None.  start : the earlier state that is known.  is_first :
        whether no step led to it.
    first_volume : when the simulation was made [length³], or None.  is_of_barostat :
        whether the barostat has refused to go on.
    """

    fault: str
    step: int
    constraint: tuple[int, int] | None
    at: Array | None
    start: Snapshot
    is_first: bool
    first_volume: float | None = None
    is_of_barostat: bool = False


class Verdict(NamedTuple):
    """kind : "law", "overlap", "barostat", "constraint", "bond", "hot", "step" or "pair".  pair : to blame, or None.

    cause, advice : one sentence each.
    """

    kind: str
    pair: Contact | None
    cause: str
    advice: str


@dataclass(frozen=True)
class CrashReport:
    """The findings about a failed run. str() puts them into lines.

    fault : what went wrong.  step : in which step.  last_good_step : of the state described.  first_step :
        from which it can be replayed.
    kind, pair, cause, advice : as Verdict.  closest : two atoms and their distance [length], or None.
    pushed, largest_force : the atom on which the largest force acts, and its size [energy/length].
    fastest, displacement : the fastest atom, and how far it moves in a step [length].  timestep : [time].  units :
        name.
    """

    fault: str
    step: int
    last_good_step: int
    first_step: int
    kind: str
    pair: Contact | None
    cause: str
    advice: str
    closest: ClosestPair | None
    pushed: int
    largest_force: float
    fastest: int
    displacement: float
    timestep: float
    units: str

    def __str__(self) -> str:
        pair, units = self.pair, SYSTEMS.get(self.units, LJ)
        force, length = f"{units.energy}/{units.length}", units.length
        lines = [
            f"fault          {self.fault}, at step {self.step}",
            f"cause          {self.cause}",
            f"what to do     {self.advice}",
        ]
        if pair is not None:
            what = f"{'bond' if pair.is_bond else 'pair'} of {pair.atoms} ({pair.law})"
            lines.append(
                f"pair           {what}, {pair.apart(length)}, −u′ {pair.force:.3g} "
                f"{force}{pair.stiffness(self.timestep)}"
            )
        closest = self.closest.told(length) if self.closest else "none"
        largest = f"largest force {self.largest_force:.3g} {force} on atom {self.pushed}"
        lines.append(f"last good      step {self.last_good_step}; closest {closest}")
        return "\n".join(
            [*lines, f"               {largest}; atom {self.fastest} moves {self.displacement:.3g} {length} in a step"]
        )


def examine(engine: Engine, failure: Failure) -> CrashReport:
    """Find the likely cause of a failure.  engine : in the last good state,
    with energies of single atoms (PER_ATOM)."""
    (pushed, force), (fastest, speed) = longest(engine.forces), longest(engine.velocities)
    bad = np.flatnonzero(~(np.isfinite(engine.forces).all(axis=1) & np.isfinite(engine.interactions.energies)))[:2]
    closest = closest_pair(engine.system)
    evidence = Evidence(
        engine,
        failure,
        [pushed, fastest, *(closest[:2] if closest else ()), *(failure.constraint or ()), *bad.tolist()],
    )
    verdict = next(verdict for rule in RULES if (verdict := rule(evidence)) is not None)
    if depth := strange_depth(engine.system, engine.interactions.potentials):
        verdict = verdict._replace(
            cause=f"{depth} (with it, {verdict.cause})", advice="correct epsilon before anything else"
        )
    judged: tuple[Any, ...] = verdict
    timestep, units = engine.method.timestep, engine.system.units.name
    seen: tuple[Any, ...] = (closest, pushed, force, fastest, speed * abs(timestep), timestep, units)
    return CrashReport(failure.fault, failure.step, engine.step, failure.start.step, *judged, *seen)


class Evidence:
    """What is known about a failure.

    suspects : atoms whose contacts are examined.  found : their contacts in the last good state,
        and those without a finite force at the
    moment of the failure.  strongest : the contact with the largest force, or None.  met :
    the same of the closest pair at that moment.
    """

    def __init__(self, engine: Engine, failure: Failure, suspects: list[int]) -> None:
        self.engine, self.failure, self.system = engine, failure, engine.system
        self.timestep = abs(engine.method.timestep)
        self.shown_timestep = engine.system.units.shown(self.timestep)
        self.found, self.met = self.contacts(self.system, suspects), None
        self.longest_stable = stability_limit(engine.method.sequence())
        if failure.at is not None and (np.abs(failure.at) <= LARGEST).all():
            failed = self.moved(failure.at)
            self.found += [one for one in self.contacts(failed, suspects) if not one.is_finite]
            self.met = _strongest(self.contacts(failed, list((closest_pair(failed) or ())[:2])))
        self._advice: list[StepAdvice | None] = []
        self.strongest = _strongest(self.found)

    @property
    def advice(self) -> StepAdvice | None:
        """Advice on the time step for the last good state; None if it takes too long or fails."""
        if not self._advice:
            try:
                self._advice.append(advice_at(self.engine, ADVICE_SECONDS))
            except Exception:  # whatever a term of the user's own raises: the failure itself must be told
                self._advice.append(None)
        return self._advice[0]

    @property
    def recommended(self) -> str:
        """What advise_timestep recommends for the last good state, as advice."""
        advice = self.advice
        if advice is None or not advice.frequency:
            return "ask advise_timestep for a shorter one"
        return (
            f"take {self.system.units.shown(advice.recommended)}, as advise_timestep recommends for the last good state"
        )

    def contacts(self, system: System, atoms: list[int]) -> list[Contact]:
        """The contacts of some atoms in some state."""
        return contacts(system, self.engine.interactions.potentials, self.engine.constraint_set.inverse_masses, atoms)

    def moved(self, positions: Array) -> System:
        """A system at rest with its atoms elsewhere: the velocities of a failed run may be infinite."""
        names = ("masses", "cell", "species", "bonds", "units", "constraints")
        return System(positions, **{name: getattr(self.system, name) for name in names})


def law_without_number(evidence: Evidence) -> Verdict | None:
    """A law of the user's, or a table, that is not finite at some distance."""
    for one in evidence.found:
        if not one.is_finite and not _is_overlap(one) and (one.is_users or one.is_bond):
            cause = one.without_number(evidence.system.units.length)
            return Verdict("law", one, cause, "correct the law at that distance, or keep atoms away from it")
    return None


def overlap_at_start(evidence: Evidence) -> Verdict | None:
    """The closest pair of a state to which no step led, if its atoms are on top of each other."""
    step, start = evidence.failure.start.step, evidence.moved(evidence.failure.start.positions)
    closest = closest_pair(start) if evidence.failure.is_first else None
    joined = [
        start.bonds,
        *(one.pairs for one in start.constraints if isinstance(one, DistanceConstraints)),
    ]  # these are close by right
    if closest is None or among(np.array([closest[:2]]), np.concatenate(joined)).any():
        return None
    found = evidence.contacts(start, list(closest[:2]))
    over = [one for one in found if not one.is_bond and (_is_overlap(one) or _is_thrown(one, evidence))]
    if not over:
        return None
    worst = min(over, key=lambda one: one.distance)
    cause = (
        f"{worst.atoms} overlap at {f'step {step}' if step else 'the start'}, "
        f"{worst.apart(evidence.system.units.length)}"
    )
    return Verdict("overlap", worst, cause, "minimize moves atoms apart; or start from another state with less energy")


def one_place(evidence: Evidence) -> Verdict | None:
    """Two atoms, bonded ones among them, at the same place: no law gives a direction there."""
    closest = closest_pair(evidence.system)
    if closest is None or closest.distance > 0.0 or np.isfinite(evidence.engine.forces[list(closest[:2])]).all():
        return None
    cause = (
        f"atoms {closest.first} and {closest.second} are at the same place, where the force between them is not defined"
    )
    return Verdict("overlap", None, cause, "minimize moves them apart; or remove one")


def barostat(evidence: Evidence) -> Verdict | None:
    """A barostat that cannot go on, or that has made a gas of what was dense."""
    bath, volume, before = evidence.engine.barostat, evidence.system.volume, evidence.failure.first_volume
    if (
        bath is None
        or not volume
        or not before
        or not (evidence.failure.is_of_barostat or volume > EVAPORATED * before)
    ):
        return None
    units = evidence.system.units
    at = f"at pressure {bath.pressure:.3g} {units.pressure}"
    if volume > EVAPORATED * before:
        cause = f"the cell has grown from {before:.4g} to {volume:.4g} {units.volume} {at}, where no dense state exists"
        return Verdict("barostat", None, cause, "take a higher pressure, or a lower temperature")
    cause = (
        f"the barostat strains a cell of {volume:.4g} {units.volume}, {before:.4g} when the simulation was made, "
        f"too fast {at}"
    )
    return Verdict(
        "barostat",
        None,
        cause,
        "equilibrate at constant volume first, take a longer relaxation_time, or look at the unit of the pressure",
    )


def broken_constraint(evidence: Evidence) -> Verdict | None:
    """A constraint that the solver could not keep."""
    if evidence.failure.constraint is None:
        return None
    i, j = evidence.failure.constraint
    cause = f"in one step of {evidence.shown_timestep} atoms {i} and {j} move too far for the constraint between them"
    return Verdict(
        "constraint",
        evidence.strongest,
        cause,
        "reduce the timestep, or check whether the constraints contradict each other",
    )


def unstable_bond(evidence: Evidence) -> Verdict | None:
    """A bond whose Δt·ω is beyond the limit of the method."""
    bonds = [(one.frequency * evidence.timestep, one) for one in evidence.found if one.is_bond and one.frequency]
    x, stiffest = max(bonds, key=lambda bond: bond[0], default=(0.0, None))
    if stiffest is None or x <= evidence.longest_stable:
        return None
    stable = f"(stable to {evidence.longest_stable:.3g})"
    cause = f"timestep {evidence.shown_timestep} too large for the bond of {stiffest.atoms}: Δt·ω = {x:.3g} {stable}"
    return Verdict("bond", stiffest, cause, f"{evidence.recommended}; or hold the bond rigid")


def bottomless_law(evidence: Evidence) -> Verdict | None:
    """A law that attracts ever more strongly the closer two atoms come."""
    pair = evidence.strongest
    if pair is None or not pair.sinks:
        return None
    units = evidence.system.units
    fall = f"u = {pair.energy:.3g} {units.energy} there, and less at shorter distances: they fall into each other"
    cause = f"the law of {pair.law} attracts {pair.atoms}, {pair.apart(units.length)}; {fall}"
    return Verdict("law", pair, cause, "give the law a repulsive core; a shorter timestep does not help")


def too_hot(evidence: Evidence) -> Verdict | None:
    """Atoms, all or one of them, that were too fast before anything had gone wrong."""
    pairs = [one for one in evidence.found if one.ratio and not one.is_bond]
    if not pairs:
        return None
    velocities, dt, units = evidence.failure.start.velocities, evidence.timestep, evidence.system.units
    sigma = min(one.distance / one.ratio for one in pairs if one.ratio)
    fast = sigma * max(HOT_STEP / dt, FAST * max(one.rest_frequency or 0.0 for one in pairs))
    squares = np.einsum("ij,ij->i", velocities, velocities)
    atom, n_others = int(np.argmax(squares)), max(1, len(squares) - 1)
    speed, mean, others = np.sqrt([squares[atom], squares.mean(), (squares.sum() - squares[atom]) / n_others])
    passes = f"atom {atom} moves {speed * dt / sigma:.2g} σ in a step"
    if mean > fast and speed <= HOT_SPOT * others:
        hot = temperature(kinetic_energy(velocities, evidence.system.masses), velocities.size, units.k_B)
        passes = f"at {hot:.3g} {units.temperature} {passes}"
    elif speed > max(fast, HOT_SPOT * others):
        passes += f", {speed / others:.2g} times as fast as the others" if others > 0.0 else ", the only one in motion"
    else:
        return None
    cause = f"too hot, timestep {evidence.shown_timestep} too large: {passes}"
    return Verdict(
        "hot",
        evidence.strongest,
        cause,
        "start at a lower temperature, or reduce the timestep in proportion to the speed",
    )


def collision_in_a_step(evidence: Evidence) -> Verdict | None:
    """Two atoms that the step that failed has brought together, where before it no pair was stiff."""
    met, limit = evidence.met, evidence.longest_stable
    before = max((one.frequency or 0.0 for one in evidence.found), default=0.0)
    if (
        met is None
        or before * evidence.timestep > NEAR_LIMIT * limit
        or not (met.frequency or 0.0) * evidence.timestep > limit
    ):
        return None
    there = f"{met.apart(evidence.system.units.length)}{met.stiffness(evidence.timestep)}"
    cause = (
        f"timestep {evidence.shown_timestep} too large: step {evidence.failure.step} drives {met.atoms} into each "
        f"other, {there}"
    )
    return Verdict("pair", met, cause, "halve the timestep until the energy is conserved")


def long_step(evidence: Evidence) -> Verdict:
    """What is left: the pair with the largest force, if there is one."""
    pair = evidence.strongest
    if pair is None:
        advice, shown = evidence.advice, evidence.system.units.shown
        if advice is not None and advice.frequency and evidence.timestep > NEAR_LIMIT * advice.limit:
            where = f"{advice.method} is stable up to {shown(advice.limit)} on the stiffest mode of the last good state"
            if evidence.timestep <= advice.limit:
                where += ", and up to less where atoms come closer"
            cause = f"timestep {evidence.shown_timestep} too large: {where}"
            return Verdict("step", None, cause, evidence.recommended)
        cause = "atoms fly apart although no pair with a known law pushes them: the forces come from elsewhere"
        return Verdict("law", None, cause, "examine the forces in the last good state")
    what = (
        f"{'bond' if pair.is_bond else 'pair'} of {pair.atoms}, "
        f"{pair.apart(evidence.system.units.length)}{pair.stiffness(evidence.timestep)}"
    )
    return Verdict(
        "pair",
        pair,
        f"timestep {evidence.shown_timestep} too large for the {what}",
        "halve the timestep until the energy is conserved",
    )


RULES: tuple[Callable[[Evidence], Verdict | None], ...] = (
    law_without_number,
    overlap_at_start,
    one_place,
    barostat,
    broken_constraint,
    unstable_bond,
    bottomless_law,
    too_hot,
    collision_in_a_step,
    long_step,
)


def _strongest(found: list[Contact]) -> Contact | None:
    """The contact with the largest finite force, or None."""
    return max((one for one in found if one.is_finite), key=lambda one: abs(one.force), default=None)


def _is_overlap(contact: Contact) -> bool:
    """Whether two atoms are closer than any collision takes them."""
    return contact.distance == 0.0 or (contact.ratio is not None and not contact.is_bond and contact.ratio < OVERLAP)


def _is_thrown(contact: Contact, evidence: Evidence) -> bool:
    """Whether a law without a length of its own throws a pair apart within one step."""
    inverse_mass = float(evidence.engine.constraint_set.inverse_masses[[contact.first, contact.second]].sum())
    return contact.ratio is None and contact.force * inverse_mass * evidence.timestep**2 > THROWN * contact.distance
