"""The report on a run that has failed: the likely cause, and the last good state."""

from dataclasses import dataclass

from minimd.core.diagnosis.contacts import Contact
from minimd.core.diagnosis.evidence import Evidence, Failure
from minimd.core.diagnosis.rules import after
from minimd.core.engine.engine import Engine
from minimd.core.neighbors.queries import ClosestPair
from minimd.core.structure.observables import longest
from minimd.core.structure.units import LJ, SYSTEMS


@dataclass(frozen=True)
class CrashReport:
    """The findings about a failed run. str() puts them into lines.
    fault : what went wrong.
    step : in which step.
    last_good_step : of the state described.
    first_step : from which it can be replayed.
    kind, pair, cause, advice : as Verdict.
    closest : two atoms and their distance [length], or None.
    pushed, largest_force : the atom on which the largest force acts, and its size [energy/length].
    fastest, displacement : the fastest atom, and its way in a step [length].
    timestep : [time].
    units : name."""

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
        units = SYSTEMS.get(self.units, LJ)
        force = f"{units.energy}/{units.length}"
        length = units.length
        lines = [f"fault          {self.fault}, at step {self.step}"]
        lines.append(f"cause          {self.cause}")
        lines.append(f"what to do     {self.advice}")
        pair = self.pair
        if pair:
            what = "bond" if pair.is_bond else "pair"
            where = f"{what} of {pair.atoms} ({pair.law}), {pair.apart(length)}"
            push = f"−u′ {pair.force:.3g} {force}{pair.stiffness(self.timestep)}"
            lines.append(f"pair           {where}, {push}")
        closest = self.closest.told(length) if self.closest else "none"
        lines.append(f"last good      step {self.last_good_step}; closest {closest}")
        largest = f"largest force {self.largest_force:.3g} {force} on atom {self.pushed}"
        moves = f"atom {self.fastest} moves {self.displacement:.3g} {length} in a step"
        lines.append(f"               {largest}; {moves}")
        return "\n".join(lines)


def examine(engine: Engine, failure: Failure) -> CrashReport:
    """Find the likely cause of a failure.
    engine : in the last good state, with energies of single atoms."""
    evidence = Evidence(engine, failure)
    pushed, force = longest(engine.forces)
    fastest, speed = longest(engine.velocities)
    kind, cause, advice, pair = next(after(evidence))
    depth = evidence.strange_depth
    if depth:
        cause = f"{depth} (a consequence: {cause})"
        advice = "correct epsilon before anything else"
    return CrashReport(
        fault=failure.fault,
        step=failure.step,
        last_good_step=engine.step,
        first_step=failure.start.step,
        kind=kind,
        pair=pair,
        cause=cause,
        advice=advice,
        closest=evidence.closest,
        pushed=pushed,
        largest_force=force,
        fastest=fastest,
        displacement=speed * evidence.stride,
        timestep=engine.method.stride,
        units=engine.system.units.name,
    )
