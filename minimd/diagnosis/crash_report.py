"""What a failed run died of: the last good state looked at closely, the likely cause in one sentence, and what to do."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.diagnosis.causes import Evidence, Moment, apart, atoms_of, stiffness, verdict
from minimd.diagnosis.contacts import Contact, contacts
from minimd.integrators.splitting.splitting import Splitting
from minimd.neighbors.queries import ClosestPair, closest_pair
from minimd.structure.errors import ConstraintError, NonFiniteError
from minimd.structure.system import System

if TYPE_CHECKING:
    from minimd.simulation.simulation import Simulation

SUFFIX = ".crash.h5md"


@dataclass(frozen=True)
class CrashReport:
    """The findings. str() is the text for people.

    Attributes
    ----------
    fault : what went wrong.  step : in which step.  last_good_step : of the state described.  first_step : from which it can be replayed.
    cause : one sentence.  kind : "overlap", "bond", "pair", "hot", "constraint" or "law".  advice : what to do.
    pair : the contact that is to blame, or None.  closest : two atoms and their distance [length], or None.
    pushed, largest_force : the atom on which the largest force acts, and its size [energy/length].
    fastest, stride : the fastest atom, and its way in a step [length].
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
    def of(cls, found: dict[str, Any]) -> "CrashReport":
        """The reverse of asdict."""
        pair = None if found["pair"] is None else Contact(**found["pair"])
        return cls(**{**found, "pair": pair, "closest": None if found["closest"] is None else ClosestPair(*found["closest"])})

    def __str__(self) -> str:
        lines = [f"fault          {self.fault}, at step {self.step}", f"cause          {self.cause}", f"what to do     {self.advice}"]
        if self.pair is not None:
            what = f"{'bond' if self.pair.is_bond else 'pair'} of {atoms_of(self.pair)} ({self.pair.law})"
            lines.append(f"pair           {what}, {apart(self.pair)}, −u′ {self.pair.force:.3g}{stiffness(self.pair, self.timestep)}")
        lines.append(f"last good      step {self.last_good_step}; closest {self.closest}")
        lines.append(
            f"               largest force {self.largest_force:.3g} on atom {self.pushed}; atom {self.fastest} moves {self.stride:.3g} in a step"
        )
        return "\n".join(lines)


class Acting(NamedTuple):
    """What acts on the atoms of the last good state.  forces : (N, 3).  energies : (N,).  inverse_masses : (N,), 0 of fixed atoms."""

    potentials: Sequence[Any]
    forces: NDArray[np.float64]
    energies: NDArray[np.float64]
    inverse_masses: NDArray[np.float64]


class Failure(NamedTuple):
    """How it failed.  fault : in words.  step : in which.  constraint : atoms of one that could not be kept.

    at : (N, 3), positions in that moment, or None.  start : the earlier state that is known.  is_first : whether that is the start of the run.
    """

    fault: str
    step: int
    last_good_step: int
    constraint: tuple[int, int] | None
    at: NDArray[np.float64] | None
    start: Moment
    is_first: bool


def examine(system: System, acting: Acting, method: Splitting, failure: Failure) -> CrashReport:
    """Find the likely cause of a failure.  system : in the last good state."""
    force, speeds, closest = _lengths(acting.forces), _lengths(system.velocities), closest_pair(system)
    pushed, fastest = int(np.argmax(np.where(np.isfinite(force), force, np.inf))), int(np.argmax(speeds))
    bad = np.flatnonzero(~(np.isfinite(force) & np.isfinite(acting.energies)))[:2]
    near = () if closest is None else (int(closest.first), int(closest.second))
    suspects = [pushed, fastest, *near, *(failure.constraint or ()), *map(int, bad)]
    found = contacts(system, acting.potentials, acting.inverse_masses, suspects) + _limitless(failure.at, system, acting, suspects)
    known = (system, acting.potentials, acting.inverse_masses, method.timestep, method.sequence(), failure.start, failure.is_first)
    judged = verdict(Evidence(*known, failure.constraint, found))
    return CrashReport(
        fault=failure.fault,
        step=failure.step,
        last_good_step=failure.last_good_step,
        first_step=failure.start.step,
        kind=judged.kind,
        cause=judged.cause,
        advice=judged.advice,
        pair=judged.pair,
        closest=closest,
        pushed=pushed,
        largest_force=float(force[pushed]),
        fastest=fastest,
        stride=float(speeds[fastest] * abs(method.timestep)),
        timestep=method.timestep,
        units=system.units.name,
    )


def _limitless(positions: NDArray[np.float64] | None, system: System, acting: Acting, atoms: Sequence[int]) -> list[Contact]:
    """Contacts without a finite force in the very moment of the failure, of which the last good state knows nothing."""
    if positions is None or not np.isfinite(positions).all():
        return []
    moved = System(positions, masses=system.masses, cell=system.cell, species=system.species, bonds=system.bonds, units=system.units)
    return [one for one in contacts(moved, acting.potentials, acting.inverse_masses, atoms) if not one.is_finite]


def place_of(crash_report: str | Path | bool, trajectories: str | Path | Sequence[str | Path]) -> Path | None:
    """Where the findings about a run go: where they were asked to, beside its first trajectory if True, nowhere if there is none.

    Raises ValueError for one of the trajectories, which it would replace.
    """
    several = [trajectories] if isinstance(trajectories, (str, Path)) else list(trajectories)
    if isinstance(crash_report, bool):
        return Path(several[0]).with_suffix(SUFFIX) if crash_report and several else None
    if Path(crash_report).resolve() in [Path(file).resolve() for file in several]:
        raise ValueError(f"crash_report must be a file of its own; {str(crash_report)!r} is a trajectory of the run: choose another name")
    return Path(crash_report)


@contextmanager
def left_at(path: Path | None, simulation: "Simulation", overwrite: bool) -> Iterator[None]:
    """If a simulation fails, leave the file of its crash report, and name it in the error."""
    try:
        yield
    except (NonFiniteError, ConstraintError) as error:
        if path is not None and error.crash_report is not None:
            error.args = (f"{error}. {_left(error, path, simulation, overwrite)}",)
        raise


def _left(error: NonFiniteError | ConstraintError, path: Path, simulation: "Simulation", overwrite: bool) -> str:
    """Write the file; returns what can be said of it."""
    from minimd.files.crash_file import free_name, write_crash_report

    file = free_name(path, overwrite)
    try:
        write_crash_report(file, simulation, error.crash_report)
    except Exception as reason:  # whatever it is: the failure itself must be heard
        return f"No crash report was written: {reason}"
    error.file = file
    return f"Crash report in {file}; look again with: minimd replay {file}, or, in a script, minimd.replay(file, potentials)"


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
