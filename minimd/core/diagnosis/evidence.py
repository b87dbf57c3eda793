"""What is known about a scene, and about its failure if it has failed: what the rules of the judge look at."""

from collections.abc import Sequence
from functools import cached_property
from math import inf
from typing import Any, NamedTuple

import numpy as np

from minimd.core.console.quiet import quiet
from minimd.core.diagnosis.contacts import Contact, contacts
from minimd.core.diagnosis.stiffness import Stiffness
from minimd.core.diagnosis.timestep import OSCILLATION, StepAdvice, advice_at
from minimd.core.engine.engine import Engine
from minimd.core.engine.snapshot import Snapshot
from minimd.core.integrators.order_conditions import stability_limit
from minimd.core.neighbors.queries import ClosestPair, closest_pair
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import LARGEST
from minimd.core.structure.observables import longest
from minimd.core.structure.system import System, changed

# Δt·ω of 20 steps a period: velocity Verlet's energy oscillates by (Δt·ω)²/8
USUAL = (8.0 * OSCILLATION) ** 0.5
OVERLAP = 0.8  # of σ; thermal collisions of a liquid at k_B T = ε end at 0.85 σ
# of its distance: a pair that a force moves farther in one step overlaps; for laws without a length of their own
THROWN = 0.1
# at most, for the search of the stiffest mode: before a run and in its report; after a failure
HINT_SECONDS = 1.0
ADVICE_SECONDS = 10.0
HALVE = "halve the timestep until the energy is conserved"


class Failure(NamedTuple):
    """How a run failed.
    fault : in words.
    step : in which.
    constraint : atoms of one that could not be kept.
    at : (N, 3), positions at that moment, or None.
    start : the earlier state that is known.
    is_first : whether no step led to it.
    first_volume : when the simulation was made [length³], or None.
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
    """kind : for programs.
    cause, advice : in words.
    pair : to blame, or None."""

    kind: str
    cause: str
    advice: str = ""
    pair: Contact | None = None

    def __str__(self) -> str:
        return f"{self.cause}; {self.advice}"


class Evidence:
    """What is known about a scene, and about its failure if it has failed; computed when it is first asked for.
    engine : in its present state, after a failure the last good one, with energies of single atoms (PER_ATOM)."""

    def __init__(self, engine: Engine, failure: Failure | None = None) -> None:
        self.engine = engine
        self.system = engine.system
        self.units = engine.system.units
        self.potentials = engine.interactions.potentials
        self.inverse_masses = engine.constraint_set.inverse_masses
        self.failure: Any = failure  # None if nothing has failed
        self.timestep = abs(engine.method.timestep)
        self.stride = abs(engine.method.stride)  # the time between two states of an oscillator
        self.step = self.units.shown(self.timestep)  # as text

    @cached_property
    def limit(self) -> float:
        """The largest stable Δt·ω of the method."""
        return stability_limit(self.engine.method.sequence())

    @cached_property
    def stiffness(self) -> Stiffness:
        """Of the scene."""
        return Stiffness(self.system, self.potentials, self.engine.constraint_set)

    @property
    def strange_depth(self) -> Verdict | None:
        """An ε in another unit."""
        depth = self.stiffness.strange_depth
        return None if depth is None else Verdict("long step", *depth)

    @cached_property
    def closest(self) -> ClosestPair | None:
        """The closest two atoms and their distance; None if there are no two."""
        return closest_pair(self.system)

    @property
    def suspects(self) -> list[int]:
        """The atoms on which the largest force acts, the fastest one, the closest two, those without finite numbers."""
        engine = self.engine
        has_energy = np.isfinite(engine.sums.energies)
        is_finite = np.isfinite(engine.forces).all(axis=1) & has_energy
        atoms = [longest(engine.forces)[0], longest(engine.velocities)[0]]
        atoms += self.closest[:2] if self.closest else ()
        atoms += self.failure.constraint or ()
        return atoms + np.flatnonzero(~is_finite)[:2].tolist()

    @cached_property
    def failed(self) -> System | None:
        """The system at the moment of the failure, if its positions are numbers."""
        positions = self.failure.at
        if positions is None or not (np.abs(positions) <= LARGEST).all():
            return None
        return self.moved(positions)

    @cached_property
    def contacts(self) -> list[Contact]:
        """Those of the suspects in the last good state, and those without a finite force when it failed."""
        suspects = self.suspects
        later = [] if self.failed is None else self.contacts_in(self.failed, suspects)
        broken = [contact for contact in later if not contact.is_finite]
        return self.contacts_in(self.system, suspects) + broken

    @cached_property
    def strongest(self) -> Contact | None:
        """The contact with the largest force."""
        return strongest(self.contacts)

    @cached_property
    def advice(self) -> StepAdvice | None:
        """Advice on the time step for the present state, after a failure the last good one; None if it takes too long
        or fails."""
        seconds = ADVICE_SECONDS if self.failure else HINT_SECONDS
        return self._advice(self.potentials, seconds)

    @cached_property
    def network(self) -> StepAdvice | None:
        """The same for the harmonic bonds and angles alone, rough for many atoms; None without any that can move."""
        bonds = self.stiffness.harmonic
        if not self.stiffness.bound:
            return None
        return self._advice(bonds, HINT_SECONDS) or self._advice(bonds, ADVICE_SECONDS, True)

    def _advice(
        self, potentials: Sequence[Any], seconds: float, is_rough: bool = False
    ) -> StepAdvice | None:
        at_rest = self.failure is not None
        try:
            with quiet():  # their warnings have been given
                return advice_at(self.engine, potentials, seconds, at_rest, is_rough)
        except Exception:  # whatever a term of the user's own raises
            return None  # the failure itself must be told

    @property
    def recommended(self) -> str:
        """What advise_timestep recommends for this state; if that takes too long, about as much."""
        if not self.advice or self.advice.recommended == inf:
            usual = self.usual_step(at_rest=self.failure is not None)
            return f"take some {self.units.shown(usual)}, or ask advise_timestep"
        step = self.units.shown(self.advice.recommended)
        state = "last good" if self.failure else "present"
        return f"take {step}, as advise_timestep recommends for the {state} state"

    @property
    def phase_of_bonds(self) -> float:
        """Δt·ω of all harmonic bonds and angles together; 0 without any that can move."""
        return self.network.frequency * self.stride if self.network else 0.0

    @property
    def stability_of_bonds(self) -> str:
        """This Δt·ω beside the limit of the method, as text, if there are harmonic bonds."""
        network: Any = self.network
        place = ""
        if network.bond:
            place = ", most of all the bond of atoms {} and {}".format(*network.bond)
        return (
            f"Δt·ω = {self.phase_of_bonds:.4g} for the harmonic bonds and angles together{place}; "
            f"{network.method} is stable up to {self.limit:.4g}, which is {self.units.shown(network.limit)}"
        )

    def usual_step(self, at_rest: bool = False) -> float:
        """A time step with 20 steps in a period of the harmonic bonds and angles together, and of collisions of
        Lennard-Jones atoms, see Stiffness.collisions; ∞ without both [time]."""
        fastest = self.stiffness.collisions(at_rest)
        collision = self.engine.method.timestep_of(USUAL / fastest) if fastest else inf
        return min(collision, self.network.harmonic) if self.network else collision

    @property
    def shorter(self) -> str:
        """Advice for a time step that is too long for two atoms that meet."""
        usual = self.usual_step(at_rest=True)
        if usual < 0.5 * self.timestep:
            return f"take {self.units.shown(usual)} or less, and {HALVE}"
        return HALVE

    def contacts_in(self, system: System, atoms: list[int]) -> list[Contact]:
        """The contacts of some atoms in some state."""
        return contacts(system, self.potentials, self.inverse_masses, atoms)

    def moved(self, positions: Array) -> System:
        """A system at rest with its atoms elsewhere: the velocities of a failed run may be infinite."""
        return changed(self.system, positions=positions, velocities=None)

    def overlap(self, contact: Contact) -> bool:
        """Whether two atoms overlap, or a law without a length of its own throws them apart within one step."""
        inverse_mass = float(self.inverse_masses[[contact.first, contact.second]].sum())
        way = contact.force * inverse_mass * self.stride**2
        is_thrown = contact.ratio is None and way > THROWN * contact.distance
        return is_overlap(contact) or is_thrown

    def apart(self, contact: Contact) -> str:
        """The distance of a pair as text."""
        return contact.apart(self.units.length)

    def phase(self, contact: Contact) -> float:
        """Δt·ω of a contact; 0 if it does not oscillate."""
        return (contact.frequency or 0.0) * self.stride


def strongest(pairs: list[Contact]) -> Contact | None:
    """The contact with the largest finite force, or None."""
    finite = [pair for pair in pairs if pair.is_finite]
    return max(finite, key=lambda pair: abs(pair.force), default=None)


def is_overlap(contact: Contact) -> bool:
    """Whether two atoms are closer than any collision takes them."""
    is_near = contact.ratio is not None and contact.ratio < OVERLAP
    return contact.distance == 0.0 or (is_near and not contact.is_bond)
