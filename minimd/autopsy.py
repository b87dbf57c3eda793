"""What a failed run died of: the last good state looked at closely, the likely cause in one sentence, and what to do."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.contacts import Contact, contacts
from minimd.integrators.rows import Drift, Kick, Row
from minimd.integrators.splitting import Splitting
from minimd.neighbors.closest import ClosestPair, closest_pair
from minimd.observables import kinetic_energy
from minimd.system import System

OVERLAP = 0.8  # of σ; thermal collisions of a liquid at k_B T = ε end at 0.85 σ
THROWN = 0.1  # of the distance by which a force moves a pair in one step: the same, of laws without a length of their own
HOT_STRIDE = 0.05  # of σ that the atoms move in a step, root mean square; a liquid at its usual step moves a fifth of this
HOT_SPOT = 6.0  # times the root mean square speed; in 10⁹ atoms of a thermal ensemble none is as fast
FAST = 0.3  # of ωσ at the minimum of a pair: speeds above are those of heat, k_B T > 3 ε, below it is the step that is too long
BOND_STEP = 0.2  # ωΔt of a bond that conserves energy well


class Moment(NamedTuple):
    """A state to go back to.  positions, velocities : (N, 3).  heat : [energy]."""

    step: int
    time: float
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    heat: float


@dataclass(frozen=True)
class Autopsy:
    """The findings. str() is the text for people.

    Attributes
    ----------
    fault : what went wrong.  step : in which step.  last_good_step : of the state described.  first_step : from which it can be replayed.
    cause : one sentence.  kind : "overlap", "bond", "pair", "hot", "constraint" or "law".  advice : what to do.
    pair : the contact that is to blame, or None.  closest : two atoms and their distance [length], or None.
    pushed, largest_force : the atom on which the largest force acts, and its size [energy/length]; fastest, stride : the fastest, and its way in a step [length].
    timestep : [time].  units : name.
    """

    fault: str
    step: int
    last_good_step: int
    first_step: int
    kind: str
    cause: str
    advice: str
    pair: Contact | None
    closest: ClosestPair | None
    pushed: int
    largest_force: float
    fastest: int
    stride: float
    timestep: float
    units: str

    def asdict(self) -> dict[str, Any]:
        """All of it in plain numbers and words."""
        found = asdict(self)
        return {**found, "closest": None if self.closest is None else [int(self.closest[0]), int(self.closest[1]), float(self.closest[2])]}

    @classmethod
    def of(cls, found: dict[str, Any]) -> "Autopsy":
        """The reverse of asdict."""
        pair = None if found["pair"] is None else Contact(**found["pair"])
        return cls(**{**found, "pair": pair, "closest": None if found["closest"] is None else ClosestPair(*found["closest"])})

    def __str__(self) -> str:
        lines = [f"fault          {self.fault}, at step {self.step}", f"cause          {self.cause}", f"what to do     {self.advice}"]
        if self.pair is not None:
            lines.append(f"pair           {_told(self.pair, self.timestep)}")
        lines.append(f"last good      step {self.last_good_step}: closest {self.closest}; largest force {self.largest_force:.3g} on atom {self.pushed};")
        lines.append(f"               fastest atom {self.fastest}, {self.stride:.3g} in a step")
        return "\n".join(lines)


class Acting(NamedTuple):
    """What acts on the atoms of the last good state.  forces : (N, 3).  energies : (N,).  inverse_masses : (N,), 0 of fixed atoms."""

    potentials: Sequence[Any]
    forces: NDArray[np.float64]
    energies: NDArray[np.float64]
    inverse_masses: NDArray[np.float64]


class Scene(NamedTuple):
    """What an examination looks at."""

    system: System
    potentials: Sequence[Any]
    forces: NDArray[np.float64]
    energies: NDArray[np.float64]
    inverse_masses: NDArray[np.float64]
    timestep: float
    row: Row


class Failure(NamedTuple):
    """How it failed.  fault : in words.  step : in which.  constraint : atoms of one that could not be kept.  at : positions in that moment, if finite.

    start : the earlier state that is known.  is_first : whether that is the start of the run.
    """

    fault: str
    step: int
    last_good_step: int
    constraint: tuple[int, int] | None
    at: NDArray[np.float64] | None
    start: Moment
    is_first: bool


def examine(system: System, acting: Acting, method: Splitting, failure: Failure) -> Autopsy:
    """Find the likely cause of a failure.  system : in the last good state."""
    scene = Scene(system, *acting, method.timestep, method.row())
    force = _lengths(scene.forces)
    speeds, closest = _lengths(system.velocities), closest_pair(system)
    pushed, fastest = int(np.argmax(np.where(np.isfinite(force), force, np.inf))), int(np.argmax(speeds))
    found = contacts(system, scene.potentials, scene.inverse_masses, _suspects(scene, failure, closest, (pushed, fastest)))
    found += _contacts_at(failure.at, scene, (pushed, fastest))
    kind, pair, cause, advice = _verdict(scene, failure, found)
    return Autopsy(
        fault=failure.fault,
        step=failure.step,
        last_good_step=failure.last_good_step,
        first_step=failure.start.step,
        kind=kind,
        cause=cause,
        advice=advice,
        pair=pair,
        closest=closest,
        pushed=pushed,
        largest_force=float(force[pushed]),
        fastest=fastest,
        stride=float(speeds[fastest] * abs(scene.timestep)),
        timestep=scene.timestep,
        units=system.units.name,
    )


def _suspects(scene: Scene, failure: Failure, closest: ClosestPair | None, atoms: tuple[int, ...]) -> list[int]:
    bad = np.flatnonzero(~(np.isfinite(scene.forces).all(axis=1) & np.isfinite(scene.energies)))[:2]
    near = () if closest is None else (int(closest.first), int(closest.second))
    return [*atoms, *near, *(failure.constraint or ()), *map(int, bad)]


def _contacts_at(positions: NDArray[np.float64] | None, scene: Scene, atoms: tuple[int, ...]) -> list[Contact]:
    """Contacts without a finite force in the very moment of the failure, of which the last good state knows nothing."""
    if positions is None or not np.isfinite(positions).all():
        return []
    system = scene.system
    moved = System(positions, masses=system.masses, cell=system.cell, species=system.species, bonds=system.bonds, units=system.units)
    return [one for one in contacts(moved, scene.potentials, scene.inverse_masses, atoms) if not one.is_finite]


def _verdict(scene: Scene, failure: Failure, found: list[Contact]) -> tuple[str, Contact | None, str, str]:
    """Kind, pair, cause and advice; the first that fits."""
    dt = abs(scene.timestep)
    shown = f"{dt * scene.system.units.to_picosecond * scene.system.units.shown_small_time:g} {scene.system.units.small_time}"
    strongest = max((one for one in found if one.is_finite), key=lambda one: abs(one.force), default=None)
    stiffest = max((one for one in found if one.is_bond and one.frequency), key=lambda one: one.frequency or 0.0, default=None)
    limitless = next((one for one in found if not one.is_finite and not _is_overlap(one)), None)
    if limitless is not None and (limitless.is_users or limitless.is_bond):
        words = f"the law of {limitless.law} gives no finite number for atoms {limitless.first} and {limitless.second}, {limitless.distance:.3g} apart"
        return "law", limitless, words, "mend the law at that distance, or keep the atoms from coming there"
    overlap = _overlap_at_start(scene, failure)
    if overlap is not None:
        words = f"atoms {overlap.first} and {overlap.second} overlap at the start: {_apart(overlap)}"
        return "overlap", overlap, words, "move them apart, or lower the energy of the start first"
    if failure.constraint is not None:
        i, j = failure.constraint
        words = f"the constraint between atoms {i} and {j} cannot be kept: its atoms move too far for it in one step of {shown}"
        return "constraint", strongest, words, "reduce the time step, or look whether the constraints contradict each other"
    if stiffest is not None and stiffest.frequency is not None and not _is_stable(scene.row, stiffest.frequency * dt):
        words = f"the time step {shown} is too long for the bond of atoms {stiffest.first} and {stiffest.second}: Δt·ω = {stiffest.frequency * dt:.3g}"
        good = BOND_STEP / stiffest.frequency / dt
        return "bond", stiffest, f"{words} (stable to {stability_limit(scene.row):.3g})", f"take a time step {good:.2g} times as long, or hold the bond rigid"
    hot = _heat_of(scene, failure.start, found)
    if hot is not None:
        return "hot", strongest, hot, "cool the start, or reduce the time step in proportion to the speed"
    if strongest is None:
        return "law", None, "the forces come from a potential whose law is not known here", "look at the forces of that potential in the last good state"
    words = f"the time step {shown} is too long for the pair of atoms {strongest.first} and {strongest.second}, {_apart(strongest)}"
    return "pair", strongest, words + _stiffness(strongest, dt), "reduce the time step to a half or less, until the energy is conserved"


def _overlap_at_start(scene: Scene, failure: Failure) -> Contact | None:
    """The worst overlap in the first state of the run, if that is known."""
    if not failure.is_first:
        return None
    now = scene.system
    system = System(failure.start.positions, masses=now.masses, cell=now.cell, species=now.species, bonds=now.bonds, units=now.units)
    closest = closest_pair(system)
    if closest is None:
        return None
    pair = {int(closest.first), int(closest.second)}
    found = [one for one in contacts(system, scene.potentials, scene.inverse_masses, pair) if not one.is_bond]
    over = [one for one in found if _is_overlap(one) or _is_thrown(one, scene)]
    return min(over, key=lambda one: one.distance, default=None)


def _is_overlap(contact: Contact) -> bool:
    return contact.distance == 0.0 or (contact.ratio is not None and not contact.is_bond and contact.ratio < OVERLAP)


def _is_thrown(contact: Contact, scene: Scene) -> bool:
    """Whether a law without a length of its own throws a pair apart within one step."""
    inverse_mass = scene.inverse_masses[contact.first] + scene.inverse_masses[contact.second]
    return contact.ratio is None and contact.force * inverse_mass * scene.timestep**2 > THROWN * contact.distance


def _heat_of(scene: Scene, start: Moment, found: list[Contact]) -> str | None:
    """A sentence if the atoms were too fast before anything had gone wrong."""
    speeds, dt = _lengths(start.velocities), abs(scene.timestep)
    mean, atom = float(np.sqrt(np.mean(speeds**2))), int(np.argmax(speeds))
    pairs = [one for one in found if one.ratio and not one.is_bond]
    size = min((one.distance / one.ratio for one in pairs if one.ratio), default=None)
    fast = FAST * max((one.rest_frequency for one in pairs if one.rest_frequency), default=0.0) * (size or 0.0)
    others = float(np.sqrt((np.sum(speeds**2) - speeds[atom] ** 2) / max(1, len(speeds) - 1)))
    if size is None:
        return None
    if speeds[atom] > max(fast, HOT_SPOT * others) and speeds[atom] * dt > HOT_STRIDE * size:
        return f"too hot: atom {atom} is {_times(speeds[atom], others)} and moves {speeds[atom] * dt / size:.2g} σ in a step, past its neighbors"
    if mean > fast and mean * dt > HOT_STRIDE * size:
        temperature = 2.0 * kinetic_energy(start.velocities, scene.system.masses) / (3 * len(speeds) * scene.system.units.k_B)
        unit = scene.system.units.temperature
        return f"too hot: at {temperature:.3g} {unit} the fastest atom, {atom}, moves {speeds[atom] * dt / size:.2g} σ in a step, past its neighbors"
    return None


def _times(speed: float, others: float) -> str:
    return f"{speed / others:.2g} times as fast as the others" if others > 0.0 else "the only one that moves"


def stability_limit(row: Row) -> float:
    """The largest ωΔt up to which a row is stable on the harmonic oscillator, to a percent: 2 for velocity Verlet."""
    steps = np.arange(0.01, 10.0, 0.01)
    return float(next((x - 0.01 for x in steps if not _is_stable(row, x)), np.inf))


def _is_stable(row: Row, x: float) -> bool:
    """Whether |tr M| ≤ 2 of one step with ωΔt = x, M the product of its drifts and kicks."""
    step = np.eye(2)
    for letter in row:
        if isinstance(letter, (Drift, Kick)):
            shear = [[1.0, letter.coefficient * x], [0.0, 1.0]] if isinstance(letter, Drift) else [[1.0, 0.0], [-letter.coefficient * x, 1.0]]
            step = np.array(shear) @ step
    return bool(abs(np.trace(step)) <= 2.0 + 1e-9)


def _apart(contact: Contact) -> str:
    ratio = "" if contact.ratio is None else f" (r/{'r₀' if contact.is_bond else 'σ'} = {contact.ratio:.3g})"
    return f"{contact.distance:.3g} apart{ratio}"


def _stiffness(contact: Contact, timestep: float) -> str:
    return "" if contact.frequency is None else f", Δt·ω = {contact.frequency * timestep:.3g}"


def _told(contact: Contact, timestep: float) -> str:
    what = f"{'bond' if contact.is_bond else 'pair'} of atoms {contact.first} and {contact.second} ({contact.law})"
    return f"{what}, {_apart(contact)}, −u′ {contact.force:.3g}{_stiffness(contact, abs(timestep))}"


def beside(trajectories: str | Path | Sequence[str | Path]) -> Path | None:
    """Where the findings about a run go: beside its first trajectory; None without one."""
    several = [trajectories] if isinstance(trajectories, (str, Path)) else list(trajectories)
    return Path(several[0]).with_suffix(".autopsy.h5md") if several else None


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
